"""The records of a run: one JSON object a line, appended and synced the moment it is true.

`RUN/records.jsonl` holds four kinds of line: `run` (provenance, once a start), `job` (one cell of a suite: what was
encoded, its bytes, its errors, or why it failed), `timing` (one codec timed beside the others of its material) and
`rate` (one codec's ladder of rates against that of log PCA).
Paths in records are relative to the run's folder. Imports neither PyTorch nor pandas.
"""

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.errors import InputError

FILE = "records.jsonl"
Record = dict[str, Any]


def append(folder: Path, record: Record) -> None:
    """Add one record to a run and sync it to the disk."""
    line = json.dumps(record, sort_keys=True, allow_nan=False) + "\n"
    with open(folder / FILE, "ab") as file:
        if file.tell() and not _ends_in_newline(folder / FILE):
            line = "\n" + line  # the process that wrote before was killed in the middle of its line
        file.write(line.encode())
        file.flush()
        os.fsync(file.fileno())


def _ends_in_newline(path: Path) -> bool:
    with open(path, "rb") as file:
        file.seek(-1, os.SEEK_END)
        return file.read(1) == b"\n"


@dataclass(frozen=True)
class Run:
    """What a run's folder holds: the latest record of each job, timing and rate, in the order of first appearance."""

    folder: Path
    starts: list[Record] = field(default_factory=list)
    jobs: list[Record] = field(default_factory=list)
    timings: list[Record] = field(default_factory=list)
    rates: list[Record] = field(default_factory=list)
    unreadable: list[int] = field(default_factory=list)  # line numbers, from 1

    def timing(self, job: Record) -> Record | None:
        """The timing of a job's decoder, where it was timed."""
        found = (t for t in self.timings if t["job"] == job["job"])
        return next(found, None)


def load_run(folder: str | Path) -> Run:
    """Read the records of a run, given its folder or a file of records, `.jsonl`.

    `InputError` where there are none; a line that is no record is counted, not read.
    """
    path = Path(folder) if str(folder).endswith(".jsonl") else Path(folder) / FILE
    if not path.is_file():
        raise InputError(f"{folder}: no run here (no {FILE}): give the folder that `neubtf-bench run` wrote")
    run = Run(path.parent)
    latest: dict[str, dict[object, Record]] = {"job": {}, "timing": {}, "rate": {}}
    for number, record in _lines(path):
        kind = record.get("kind") if record else None
        if kind == "run":
            run.starts.append(record)
        elif kind in latest and ("job" in record or kind == "rate"):
            latest[kind][record.get("job") or (record.get("material"), record.get("curve"))] = record
        else:
            run.unreadable.append(number)
    run.jobs.extend(latest["job"].values())
    run.timings.extend(latest["timing"].values())
    run.rates.extend(latest["rate"].values())
    return run


def _lines(path: Path) -> Iterator[tuple[int, Record]]:
    with open(path, "rb") as file:
        for number, line in enumerate(file, 1):
            try:
                record = json.loads(line)
            except ValueError:
                record = {}
            if line.strip():
                yield number, record if isinstance(record, dict) else {}
