"""draw one kind of figure of a run for a paper

The kind `pairs` shows the truth and the decoded slices of chosen pairs, with a magnified inset and FLIP maps; the
others are those of a report. The ending of the file chooses PNG, SVG or PDF. With several materials, the name of each
follows that of the file.

examples:
  neubtf-bench figure fronts runs/budgets -o fronts.pdf
  neubtf-bench figure rate runs/quick --material satin --codec neumip --codec pca --width 8.5 -o rate.pdf
  neubtf-bench figure pairs runs/quick --material satin --codec pca --name pca="PCA, 16" -o satin.png
  neubtf-bench figure pairs runs/quick --material satin --pair 635 --pair 707 --inset 20,12,16 -o satin.svg
"""

import argparse
import re
import sys
from pathlib import Path

from bench.cli.commands import several
from bench.files import atomic
from bench.inputs.errors import FINE, NOTHING, InputError, visible, writable
from reports.choice import Choice, new_names
from reports.drawn import KINDS, PAIRS, WHY_EMPTY, Wanted, drawn

ENDINGS = (".png", ".svg", ".pdf")


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    parser.add_argument("kind", metavar="KIND", help=", ".join(KINDS))
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN", help="folders of runs, or files of records")
    parser.add_argument("-o", "--out", type=Path, required=True, help="the file to write: .png, .svg or .pdf")
    several(parser, "--codec", "only this codec, or this row; repeatable")
    several(parser, "--material", "only this material; repeatable")
    several(parser, "--name", "rename a codec, row or material in every text; repeatable", "WORD=NAME")
    parser.add_argument("--width", type=float, metavar="CM", help="the width on paper (default: as in a report)")
    pair = "pairs: a pair by its index; one that is not stored is refused with a list of those that are; repeatable"
    parser.add_argument("--pair", type=int, action="append", default=[], help=pair)
    square = "pairs: the texels to magnify (default: where the codecs differ most from the truth)"
    parser.add_argument("--inset", metavar="ROW,COL,SIDE", help=square)


def run(options: argparse.Namespace) -> int:
    """Draw the figures and write one file for each material; returns `FINE`, or `NOTHING` if there is none to draw."""
    ending = options.out.suffix.lower()
    if ending not in ENDINGS:
        raise InputError(f"{options.out}: give a name that ends in {', '.join(ENDINGS[:-1])} or {ENDINGS[-1]}")
    if options.kind != PAIRS and (options.pair or options.inset):
        raise InputError(f"--pair, --inset: only for figure {PAIRS}")
    if options.width is not None and not 1 <= options.width <= 200:
        raise InputError(f"--width {options.width:g}: must be from 1 to 200 cm")
    choice = Choice(codecs=options.codec, names=new_names(options.name), materials=options.material)
    # One figure for each material; of several, each file is named after its material.
    figures = drawn(options.runs, Wanted(options.kind, choice, options.width, options.pair, _inset(options.inset)))
    if not figures:
        names = ", ".join(map(str, options.runs))
        why = WHY_EMPTY[options.kind]
        print(f"neubtf-bench: {visible(names)}: no figure {options.kind}: {why}", file=sys.stderr)
        return NOTHING
    for figure in figures:
        place = options.out
        if len(figures) > 1:
            material = Path(figure.name).stem.removeprefix(f"{figure.kind}-")
            place = place.with_name(f"{place.stem}-{material}{place.suffix}")
        content = figure.png if ending == ".png" else figure.vector(ending.removeprefix("."))
        with writable(place):
            atomic.write(place, content)
        print(f"wrote {visible(str(place))}: {visible(figure.title)}")
    return FINE


def _inset(words: str | None) -> tuple[int, int, int] | None:
    """Row, column and side of `--inset`, in texels; None if it is not given."""
    if words is None:
        return None
    if not re.fullmatch(r"\d{1,6},\d{1,6},\d{1,6}", words):
        raise InputError(f"--inset {words}: write ROW,COL,SIDE in texels, such as 20,12,16")
    row, col, side = map(int, words.split(","))
    return row, col, side
