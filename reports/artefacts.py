"""The arrays and maps that a run stores beside its records."""

import json
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np

from bench.files.archive import MAX_FILE, read_arrays
from bench.inputs.errors import InputError
from bench.program import Program
from bench.records import Job, Run
from reports.rows import MaterialRows, Row

Arrays = Mapping[str, np.ndarray]


def arrays(folder: Path, job: Job, name: str, names: Collection[str] | None = None) -> Arrays | None:
    """The arrays of a job's artefact `name` (`slices`, `pictures`), all or only those of `names`.

    None if the file is missing or unreadable.
    """
    try:
        path_in_run = cast(str, dict(job)[name])  # a dict, because the type of a record allows no variable as a key
        return read_arrays(folder / path_in_run, MAX_FILE, names)
    except (OSError, KeyError, ValueError, TypeError):
        return None  # the records of a run are useful without its large files


def of_shown(run: Run, material: MaterialRows, name: str, needed: Collection[str] = ()) -> list[tuple[Row, Arrays]]:
    """The shown rows of a material whose artefact `name` has all `needed` arrays, each row with these arrays.

    Without `needed`, every row that has the artefact, with all its arrays.
    """
    rows_with_arrays: list[tuple[Row, Arrays]] = []
    for row in material.shown:
        stored = arrays(run.folder, row.job, name, needed or None)  # without those that the file lacks
        if stored and stored.keys() >= set(needed):
            rows_with_arrays.append((row, stored))
    return rows_with_arrays


def angular(folder: Path, job: Job) -> dict[str, Any] | None:
    """A job's scores by bin of direction, and its polar maps; None if the file is missing or unreadable."""
    try:
        scores: dict[str, Any] = json.loads((folder / job["angular"]).read_text(encoding="utf-8"))
    except (OSError, KeyError, ValueError, TypeError, RecursionError):
        return None
    return scores


def program(path: Path) -> Program:
    """The program of a decoded material. `InputError` if the file holds no program."""
    try:
        return Program.from_arrays(read_arrays(path, MAX_FILE))
    except (OSError, KeyError, ValueError, TypeError) as error:
        raise InputError(f"{path}: not the program of a material ({error}): run the job again with --fresh") from error
