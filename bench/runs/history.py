"""Loads the records of many runs as one pandas frame: one row for each job, failed ones included.

A job is one codec with its settings on one material; its record holds what was measured. Columns are named after the
fields of a record, as in a run's `tables/results.csv`: `bytes/total`,
`scores/heldout/metrics/psnr_display/mean`, `timing/ns_per_sample`. The columns that identify the run come first.
Nothing is rounded. Only rows whose `codec_version`, `training`, `btf` and `metric_version/…` agree are comparable.
"""

import warnings
from collections.abc import Iterable, Iterator
from os import PathLike
from typing import Any

import pandas as pd

from bench.records import FitKey, Job, Run, RunStart, flattened, load_run

_START_TIME = "%Y%m%dT%H%M%S.%f"


def load_runs(paths: str | PathLike[str] | Iterable[str | PathLike[str]]) -> pd.DataFrame:
    """The jobs of one or several runs, given their folders or files of records (`.jsonl`). `InputError` if a path holds
    no run; warns of lines that cannot be read."""
    if isinstance(paths, str | PathLike):
        paths = [paths]
    runs = {str(path): load_run(str(path)) for path in paths}
    for path, run in runs.items():
        if run.unreadable:
            lines = ", ".join(map(str, run.unreadable))
            warnings.warn(f"{path}: {len(run.unreadable)} line(s) could not be read: {lines}", stacklevel=2)
    rows = []
    for path, run in runs.items():
        rows += [dict(_fields(path, run, job)) for job in run.jobs]
    frame = pd.DataFrame(rows)
    if "started" in frame:  # a frame without jobs has no columns
        frame["started"] = pd.to_datetime(frame["started"], format=_START_TIME, utc=True, errors="coerce")
    return frame


def _fields(path: str, run: Run, job: Job) -> Iterator[tuple[str, Any]]:
    """The columns of a job by name: the run (in the folder or file `path`), the machine, its record and timing, its
    fit."""
    start = RunStart()  # the start of the job's run; files of published records may lack it
    for each in run.starts:
        if each.get("run") == job.get("run"):
            start = each
            break
    packages = start.get("packages", {})
    fit = job.get("fit_key", FitKey())
    yield "folder", path
    yield "started", job.get("run")
    yield "suite", start.get("suite")
    yield "git", start.get("git")
    yield "processor", start.get("machine", {}).get("processor")
    for name, version in packages.items():
        yield f"package/{name}", version
    yield from flattened(job, run.timing(job))
    yield "codec_version", fit.get("version")
    yield "training", fit.get("training")
    yield "device", fit.get("device")
    yield "threads", fit.get("threads")
