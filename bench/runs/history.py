"""The records of many runs as one pandas frame: a row a job, whatever became of it.

    import bench
    frame = bench.load_runs(["runs/quick", "runs/rd"])
    frame.groupby(["material", "label", "started"])["scores/heldout/metrics/psnr_display/pooled"].mean()

Columns are named after the fields of a record, as in a run's `tables/results.csv`: `bytes/total`,
`scores/heldout/metrics/psnr_display/pooled`, `timing/ns_per_sample`. What tells runs apart stands first. Nothing is
rounded, and nothing says here whether two rows may be compared: `codec_version`, `training`, `btf` and
`metric_version/…` are for that.
"""

import json
import warnings
from collections.abc import Iterable, Iterator
from os import PathLike
from typing import Any

import pandas as pd

from bench.records import Record, Run, load_run

_STARTED = "%Y%m%dT%H%M%S.%f"
_ELSEWHERE = {"kind", "run", "fit_key", "score_key", "provenance", "traceback", "metrics", "settings", "shape"}
_RAW_TIMING = {"kind", "job", "run", "samples_ns", "floor_ratios"}
_FIRST = ("material", "label", "codec", "seed", "job", "status")


def load_runs(paths: str | PathLike[str] | Iterable[str | PathLike[str]]) -> pd.DataFrame:
    """The jobs of one run or of many, given their folders or files of records (`.jsonl`).

    `InputError` where a path holds no run. A line that could not be read is warned of.
    """
    several = [paths] if isinstance(paths, str | PathLike) else list(paths)
    runs = {str(path): load_run(str(path)) for path in several}
    for path, run in runs.items():
        if run.unreadable:
            lines = ", ".join(map(str, run.unreadable))
            warnings.warn(f"{path}: {len(run.unreadable)} line(s) could not be read: {lines}", stacklevel=2)
    frame = pd.DataFrame([dict(_fields(path, run, job)) for path, run in runs.items() for job in run.jobs])
    if "started" in frame:
        frame["started"] = pd.to_datetime(frame["started"], format=_STARTED, utc=True, errors="coerce")
    return frame


def _fields(path: str, run: Run, job: Record) -> Iterator[tuple[str, Any]]:
    start: Record = next((start for start in run.starts if start.get("run") == job.get("run")), {})
    packages, fit, score = start.get("packages", {}), job.get("fit_key", {}), job.get("score_key", {})
    yield "folder", path
    yield "started", job.get("run")
    yield from ((name, start.get(name)) for name in ("suite", "git"))
    yield "processor", start.get("machine", {}).get("processor")
    yield from ((f"package/{name}", version) for name, version in packages.items())
    yield from ((name, job.get(name)) for name in _FIRST)
    yield "codec_version", fit.get("version")
    yield "settings", json.dumps(fit["settings"], sort_keys=True) if "settings" in fit else None
    yield from ((name, fit.get(name)) for name in ("training", "device", "threads"))
    yield from ((name, score.get(name)) for name in ("btf", "exposure", "sha256"))
    yield from ((f"metric_version/{name}", metric["version"]) for name, metric in job.get("metrics", {}).items())
    yield from zip(("height", "width"), job.get("shape", ()), strict=False)
    yield from _flat("", {name: value for name, value in job.items() if name not in {*_FIRST, *_ELSEWHERE}})
    timing = run.timing(job) or {}
    yield from _flat("timing/", {name: value for name, value in timing.items() if name not in _RAW_TIMING})


def _flat(prefix: str, values: Record) -> Iterator[tuple[str, Any]]:
    """Nested records by path; short lists of numbers by index; anything longer is left to the record."""
    for name, value in values.items():
        if isinstance(value, dict):
            yield from _flat(f"{prefix}{name}/", value)
        elif isinstance(value, list):
            if name == "interval95_ns":
                yield from ((f"{prefix}{name}/{i}", item) for i, item in enumerate(value))
        else:
            yield prefix + name, value
