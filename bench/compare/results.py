"""Keeps the records of a run: everything that tables show, in a file small enough to commit beside a document.

Gone are host names, raw samples of the clock, tracebacks, pictures, and numbers of groups that no table shows. The
scores of slices stay, packed, so that paired intervals can be computed. Numbers have seven digits.
"""

import json
from collections.abc import Iterable, Iterator
from pathlib import Path

from bench.compare.reference import rounded
from bench.compare.slices import decibels, packed
from bench.errors import InputError
from bench.records import PSNR, Record, Run, gate

_START = ("kind", "run", "suite", "text", "device", "threads", "seeds", "data", "materials", "jobs", "git", "packages")
_JOB = (
    *("kind", "job", "run", "material", "codec", "label", "curve", "seed", "split", "status", "error", "shape"),
    *("pairs", "settings", "bytes", "parameters", "cost", "metrics", "footprints", "scene", "fit_seconds", "history"),
    *("fitted", "scored", "program"),
)
_FIT = ("codec", "version", "settings", "training", "torch", "code", "libraries", "shared")
_SCORE = ("sha256", "btf", "exposure", "metrics", "footprints", "demand", "deciding")
_PROVENANCE = ("source", "material", "parameters", "renderer_version", "native", "split")
_TOLD = 500  # characters of an error


def kept(run: Run) -> str:
    """The text of the file: a line for each start that made something, each job and timing.

    `InputError` if nothing was measured.
    """
    if not any(job["status"] == "ok" for job in run.jobs):
        raise InputError(f"{run.folder}: nothing was measured there")
    jobs, timings = [_job(job, run.folder) for job in run.jobs], [_timing(timing) for timing in run.timings]
    made = {line["run"] for line in (*jobs, *timings)}
    starts = [_start(start) for start in run.starts if start["run"] in made]
    lines = [*_latest(starts), *jobs, *timings]
    return "".join(json.dumps(rounded(line), allow_nan=False) + "\n" for line in lines)


def _latest(starts: Iterable[Record]) -> Iterable[Record]:
    """Each start once: a file that is added to again holds the starts of before."""
    return {start["run"]: start for start in starts}.values()


def _start(start: Record) -> Record:
    machine = {key: start.get("machine", {}).get(key) for key in ("processor", "capability", "cores")}
    return {key: start[key] for key in _START if key in start} | {"machine": machine}


def _job(job: Record, folder: Path) -> Record:
    line = {key: job[key] for key in _JOB if key in job}
    if "error" in line:
        line["error"] = _public(str(line["error"]))[:_TOLD]
    if job["status"] != "ok":
        return line
    line["machine"] = {"processor": job.get("machine", {}).get("processor")}
    parts = (("fit_key", _FIT), ("score_key", _SCORE), ("provenance", _PROVENANCE))
    line |= {part: {key: job[part][key] for key in names if key in job[part]} for part, names in parts}
    line["file"] = f"files/{Path(job['file']).name}"
    line["scores"] = dict(_shown(job["scores"]))
    if (slices := decibels(folder, job)) is not None:
        line["slices"] = {PSNR: packed(slices)}
    return line


def _public(error: str) -> str:
    """An error without the name of a home folder, which often is a person's."""
    home = str(Path.home())
    return error.replace(home, "~") if len(Path(home).parts) > 1 else error


def _shown(scores: Record) -> Iterator[tuple[str, Record]]:
    decides = gate(scores)
    for name, group in scores.items():
        if name in (decides, "train", "scene") or name.startswith(f"{decides}, "):
            yield name, group


def _timing(timing: Record) -> Record:
    return {key: value for key, value in timing.items() if key not in ("crc32", "samples_ns", "floor_ratios")}
