"""The arrays and maps that a run stores beside its records.

An *artefact* of a job is such a file, too large for the record, which has its path in a field of the artefact's name:
`slices` (the numbers of every slice), `pictures` (a few slices as pictures), `angular` (scores by direction). Tables
and pages do without a file that is missing.
"""

import json
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

from bench.files.archive import MAX_FILE, read_arrays
from bench.inputs.errors import InputError
from bench.program import Program
from bench.records import Job, Run
from reports.rows import MaterialRows, Row

T = TypeVar("T")  # a row or a job

Arrays = Mapping[str, np.ndarray]


def arrays(folder: Path, job: Job, name: str, names: Collection[str] | None = None) -> Arrays | None:
    """The arrays of a job's artefact `name` (`slices`, `pictures`) by their names in the file.

    All of them, or only those of `names` that the file has. None if the file is missing or unreadable.
    """
    try:
        path_in_run = cast(str, dict(job)[name])  # a dict, because the type of a record allows no variable as a key
        return read_arrays(folder / path_in_run, MAX_FILE, names)
    except (OSError, KeyError, ValueError, TypeError):
        return None  # the records of a run are useful without its large files


def of_shown(run: Run, material: MaterialRows, name: str, needed: Collection[str] = ()) -> list[tuple[Row, Arrays]]:
    """The rows of a material that pictures show and whose artefact `name` has all `needed` arrays, with these arrays.

    `material.shown` has one row a codec, for its first seed. Without `needed`, every such row that has the artefact,
    with all its arrays.
    """
    rows_with_arrays: list[tuple[Row, Arrays]] = []
    for row in material.shown:
        stored = arrays(run.folder, row.job, name, needed or None)
        # The file may lack some of the needed arrays: FLIP maps, for example, are not made of very small slices.
        if stored and stored.keys() >= set(needed):
            rows_with_arrays.append((row, stored))
    return rows_with_arrays


def of_same_pairs(candidates: Sequence[tuple[T, Arrays]]) -> tuple[list[tuple[T, Arrays]], list[T]]:
    """The rows or jobs whose `pictures` are of the same pairs, and as large, as those of the first; and the others.

    Pictures of other pairs could not stand beside the same truth.
    """
    alike: list[tuple[T, Arrays]] = []
    left_out: list[T] = []
    for candidate, pictures in candidates:
        if _seen_alike(pictures, candidates[0][1]):
            alike.append((candidate, pictures))
        else:
            left_out.append(candidate)
    return alike, left_out


def _seen_alike(pictures: Arrays, first: Arrays) -> bool:
    """Whether pictures of a codec are of the same pairs as the first codec's, and as many and as large."""
    if ("pairs" in pictures) != ("pairs" in first):
        return False
    if "pairs" in first and not np.array_equal(pictures["pairs"], first["pairs"]):
        return False
    return pictures["decoded"].shape == first["decoded"].shape


def angular(folder: Path, job: Job) -> dict[str, Any] | None:
    """A job's scores by bin of direction (15° of θ), and its polar maps, as the JSON that the run stored.

    None if the file is missing or unreadable.
    """
    try:
        scores: dict[str, Any] = json.loads((folder / job["angular"]).read_text(encoding="utf-8"))
    except (OSError, KeyError, ValueError, TypeError, RecursionError):  # the last: JSON that is nested too deeply
        return None
    return scores


def program(path: Path) -> Program:
    """The program in a file. `InputError` if the file is missing or holds no program."""
    try:
        return Program.from_arrays(read_arrays(path, MAX_FILE))
    except (OSError, KeyError, ValueError, TypeError) as error:
        raise InputError(f"{path}: not the program of a material ({error}): run the job again with --fresh") from error
