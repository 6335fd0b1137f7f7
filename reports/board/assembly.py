"""Assembles the board of a folder of records and archives, with the pictures of runs at hand.

A file of *records* (`*.jsonl`) holds the published results of one run, a line a job. An *archive* (`*.zip`) is a run
that somebody handed in with its codec files; its results are *claimed*, because nobody else has scored them.
"""

import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from bench.inputs.errors import InputError
from bench.records import FILE, Run, load_run
from reports.board import write_site
from reports.board.sources import Codec, Publication


def write_board(
    records: Path,
    runs: Sequence[Path],
    codecs: Mapping[str, Codec],
    unpack: Callable[[Path, Path], Run],
    site: Path,
) -> list[Path]:
    """Write the board of the files of records (`*.jsonl`) and archives (`*.zip`) in a folder; returns its pages.

    `runs` are folders of runs, or folders that hold some; their pictures are shown where that is allowed. `codecs` has
    by name what installed codecs say of themselves. `unpack` unpacks an archive into a folder and reads its run. Raises
    `InputError` if `records` has no file of records.
    """
    files = sorted(records.glob("*.jsonl"))
    if not files:
        remedy = "`neubtf-bench results add RUN FOLDER/NAME.jsonl` makes such a file of a run, and docs/results of the "
        remedy += "suite's repository has the published ones: give --records FOLDER"
        raise InputError(f"--records {records}: no file of records (*.jsonl) is there: {remedy}")
    # Pages read the files of an unpacked run, so it is kept until they are written.
    with tempfile.TemporaryDirectory(prefix="neubtf-site-") as scratch:
        publications = [Publication(path.stem, load_run(path)) for path in files]
        for path in sorted(records.glob("*.zip")):
            run = unpack(path, Path(scratch) / path.stem)
            publications.append(Publication(path.name, run, claimed=True))
        at_hand = [Publication(folder.name, load_run(folder)) for folder in _folders_of_runs(runs)]
        return write_site(publications, at_hand, codecs, site)


def _folders_of_runs(folders: Sequence[Path]) -> list[Path]:
    """The folders that hold records: for each of some folders itself, or else those inside it."""
    folders_of_runs: list[Path] = []
    for folder in folders:
        inside = sorted(path.parent for path in folder.glob(f"*/{FILE}"))
        if inside and not (folder / FILE).exists():
            folders_of_runs += inside
        else:  # it has records itself, or there are none at all: then reading it raises the error that says so
            folders_of_runs.append(folder)
    return folders_of_runs
