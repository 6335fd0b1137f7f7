"""Assembles the board of a folder of records and archives, with the pictures of runs at hand."""

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

    `runs` are folders of runs, or folders that hold some, whose pictures are shown where that is allowed; `codecs` what
    installed ones say of themselves; `unpack` reads an archive into a folder. `InputError` if the folder has no file of
    records.
    """
    files = sorted(records.glob("*.jsonl"))
    if not files:
        remedy = "`neubtf-bench results add RUN FOLDER/NAME.jsonl` makes such a file of a run, and docs/results of the "
        remedy += "suite's repository has the published ones: give --records FOLDER"
        raise InputError(f"--records {records}: no file of records (*.jsonl) is there: {remedy}")
    with tempfile.TemporaryDirectory(prefix="neubtf-site-") as scratch:
        found = [Publication(path.stem, load_run(path)) for path in files]
        for path in sorted(records.glob("*.zip")):
            found.append(Publication(path.name, unpack(path, Path(scratch) / path.stem), claimed=True))
        at_hand = [Publication(folder.name, load_run(folder)) for folder in _folders(runs)]
        return write_site(found, at_hand, codecs, site)


def _folders(runs: Sequence[Path]) -> list[Path]:
    """The folders of runs: each given one, or those inside it."""
    folders: list[Path] = []
    for run in runs:
        if (run / FILE).exists():
            folders.append(run)
            continue
        inside = sorted(path.parent for path in run.glob(f"*/{FILE}"))
        folders += inside or [run]
    return folders
