"""Two actions of `results`: pack a run into an archive that others can verify, and verify such an archive."""

import argparse
import hashlib
import os
import shlex
import tempfile
import zipfile
from collections import Counter
from pathlib import Path

from tabulate import tabulate

from bench.cli.commands import assignments, say_line, several
from bench.cli.console import Console
from bench.compare.publishing import published
from bench.files.atomic import make_folder, refuse_other_kind
from bench.inputs.errors import FINE, NO, NOTHING, InputError, did_you_mean, visible
from bench.records import FILE, Run, load_run
from bench.runs.archive import AGREES, DIFFERS, jobs_with_results, pack, unpack, verify


def pack_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `results pack` to its parser."""
    parser.add_argument("run", type=Path, help="the folder of a run")
    several(parser, "--codec", "only this codec; repeatable")
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="FILE", help="the .zip file to write")


def pack_run(options: argparse.Namespace) -> int:
    """Pack the archive, and print the text to send with it; returns the exit code."""
    if options.out.suffix != ".zip":
        raise InputError(f"--out {options.out}: the name must end in .zip")
    refuse_other_kind(options.out, "", _is_archive)  # a measurement may be a zip, too
    run = jobs_with_results(load_run(options.run), options.codec)
    pack(run, published(run, once=False), options.out)
    say_line(f"wrote {options.out}: {len(run.jobs)} jobs, {options.out.stat().st_size:,} bytes")
    for line in ("", "To hand it in, send it with this text:", "", *_covering_text(run, options.out)):
        say_line(line)
    return FINE


def _is_archive(path: Path) -> bool:
    """Whether a file is an archive of results."""
    if not zipfile.is_zipfile(path):
        return False
    with zipfile.ZipFile(path) as archive:
        return FILE in archive.namelist()


def _covering_text(run: Run, archive: Path) -> list[str]:
    """The lines to send with the archive of a run: what it holds, how to check it, and what is left to fill in."""
    with open(archive, "rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    keys = {(job["codec"], job["fit_key"]["version"], job["fit_key"]["code"][:12]) for job in run.jobs}
    materials = ", ".join(dict.fromkeys(job["material"] for job in run.jobs))
    suites = ", ".join(dict.fromkeys(str(start.get("suite")) for start in run.starts))
    return [
        f"Results for the board: {archive.name}, {len(run.jobs)} jobs of the suite {suites}",
        f"sha256 {digest}",
        "",
        "Codecs:",
        *(f"- {name} version {version}, code {code}" for name, version, code in sorted(keys)),
        f"Materials: {materials}",
        "",
        "Install the codec with: (command, or “comes with the suite”)",
        f"Verify with: neubtf-bench results verify {shlex.quote(archive.name)}",
        "Paper and code of the codec: (links)",
    ]


def verify_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `results verify` to its parser."""
    parser.add_argument("archive", type=Path, help="an archive of `results pack`")
    several(parser, "--material", "where the data of this material are here; repeatable", "NAME=PATH")
    parser.add_argument("--out", type=Path, help="the folder of the run to write (default: runs/NAME)")


def verify_archive(options: argparse.Namespace) -> int:
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
        unknown = sorted(places.keys() - materials)
        if unknown:
            hint = did_you_mean(unknown[0], materials)
            raise InputError(f"--material {unknown[0]}: the archive has no such material{hint}")
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
