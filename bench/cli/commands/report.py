"""write a run's tables and pictures again from its records, or one site of many

`report RUN` writes tables, figures and a page into the folder of a run.

With `--site DIR` it makes the board: a folder of pages that needs no server, of all that you name: folders of runs,
whose pictures are shown where their licence allows it; files of records (`*.jsonl`, which `results add` makes of a
run); archives (`*.zip`, whose results are only claimed); and folders of any of these.

examples:
  neubtf-bench report runs/quick
  neubtf-bench report runs/quick --vector
  neubtf-bench report docs/results runs/quick --site site
"""

import argparse
from pathlib import Path

from bench.cli.commands import say_line
from bench.inputs.errors import FINE, InputError, writable
from reports import write_report


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    what = "the folder of a run; with --site also files of records, archives, and folders of these"
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN", help=what)
    form = parser.add_mutually_exclusive_group()
    form.add_argument(
        "--vector", action="store_true", help="write every figure as SVG and PDF too; later reports draw them again"
    )
    form.add_argument("--site", type=Path, metavar="DIR", help="the folder to write the pages of the board to")


def run(options: argparse.Namespace) -> int:
    """Write the report of a run, or the board of several; returns the exit code."""
    if options.site:
        return _write_site(options.runs, options.site)
    if len(options.runs) > 1 or options.runs[0].is_file():
        raise InputError(
            "report: only a run alone has its report in its folder: of several, or of files, give --site DIR"
        )
    written = write_report(options.runs[0], options.vector)
    print(written.text)
    for path in written.files:
        say_line(f"wrote {path}")
    return FINE


def _write_site(places: list[Path], site: Path) -> int:
    """Write the board of what lies at some places; returns the exit code."""
    # Only a board says what codecs are, and unpacks archives: the report of a run imports neither.
    from bench.codecs.described import described_codecs
    from bench.runs.archive import unpack
    from reports.board import Codec, write_board

    codecs = {name: Codec(**about) for name, about in described_codecs().items()}
    with writable(site, "choose another --site"):
        written = write_board(places, codecs, unpack, site)
    size = sum(path.stat().st_size for path in written)
    say_line(f"wrote {written[0]}: {len(written)} pages, {size / 1e6:.1f} MB")
    return FINE
