"""decode and score every codec file of an archive here, and say which numbers agree

Nothing in an archive is run or installed. A codec from elsewhere must be installed here first; otherwise its jobs are
listed with version and hash, but not verified. Numbers that were measured here become a run, which `table`, `compare`
and `results add` read; it has no numbers that are only claimed, such as the seconds of a fit. Measured data must be
under NEUBTF_DATA, or where --material says.

examples:
  neubtf-bench verify mine.zip
  neubtf-bench verify mine.zip --material carpet07.btf=data/carpet07.btf
  neubtf-bench results add runs/mine docs/results/quick.jsonl
"""

import argparse
import os
import tempfile
from collections import Counter
from pathlib import Path

from tabulate import tabulate

from bench.cli.commands import assignments, say_line, several
from bench.cli.console import Console
from bench.files.atomic import make_folder
from bench.inputs.errors import FINE, NO, NOTHING, InputError, did_you_mean, visible
from bench.records import FILE
from bench.runs.archive import AGREES, DIFFERS, unpack, verify


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("archive", type=Path, help="an archive of `neubtf-bench submit`")
    several(parser, "--material", "where the data of this material are here; repeatable", "NAME=PATH")
    parser.add_argument("--out", type=Path, help="the folder of the run to write (default: runs/NAME)")


def run(options: argparse.Namespace) -> int:
    """Score the files of an archive here and print the verdicts.

    Returns `FINE`, `NO` if a number differs, or `NOTHING` if no job could be verified.
    """
    folder = options.out or Path("runs") / options.archive.stem
    if (folder / FILE).exists():
        raise InputError(f"--out {folder}: it holds a run already: name another folder")
    places = assignments(options.material, "--material", "NAME=PATH")
    with tempfile.TemporaryDirectory(prefix="neubtf-verify-") as scratch, Console() as console:
        try:
            submitted = unpack(options.archive, Path(scratch))
        except InputError as error:
            raise InputError(_naming_archive(str(error), scratch, options.archive)) from error
        materials = {job["material"] for job in submitted.jobs}
        for name in sorted(places.keys() - materials):
            raise InputError(f"--material {name}: the archive has no such material{did_you_mean(name, materials)}")
        make_folder(folder)
        verdicts = list(verify(submitted, folder, console.show, places))
    rows = []
    for each in verdicts:
        why = _naming_archive(each.why, scratch, options.archive)
        rows.append([visible(str(cell)) for cell in (each.job, each.verdict, why)])
    print(tabulate(rows, ["job", "verdict", ""], "simple"))
    counts = Counter(each.verdict for each in verdicts)
    counted = ", ".join(f"{count} {word}" for word, count in counts.items())
    print()
    if not counts.keys() & {AGREES, DIFFERS}:
        (folder / FILE).unlink(missing_ok=True)  # it has no job, and would keep the corrected command from this folder
        say_line(f"{counted}; nothing was measured")
        return NOTHING
    say_line(f"{counted}; measured here: {folder}")
    return NO if DIFFERS in counts else FINE


def _naming_archive(message: str, scratch: str, archive: Path) -> str:
    """A message that names the archive instead of the temporary folder that it was unpacked to."""
    return message.replace(f"{scratch}{os.sep}", f"{archive}: ").replace(scratch, str(archive))
