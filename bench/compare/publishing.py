"""Writes the records of a run as results: a file small enough to stand beside a document, with all that tables show.

It has nothing of host names, timing samples, tracebacks and pictures. What a job would say twice, or repeat from other
jobs of its start, is said once; `load_run` puts it back. The scores of slices are packed, so that paired intervals can
be computed, and numbers have seven digits.
"""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any, cast

from bench import records
from bench.compare.paired import packed_slices
from bench.inputs.errors import InputError
from bench.metrics import read_scores
from bench.records import OUTSIDE, RMSE, SCENE_HELDOUT, Group, Job, Run, RunStart, Statistics, kept, rounded
from bench.records.schema import Use


def published(run: Run, once: bool = True) -> str:
    """The text of a run's results: a line for each start that produced something, each job and each timing.

    With `once`, what several lines would repeat is said once, as `_once` describes. Without, each line is whole by
    itself, as an archive needs it, whose lines may be altered. `InputError` if there is no result, if a job does not
    name its run, as in a reference, or if its slices cannot be read.
    """
    _refuse_unpublishable(run)
    jobs = [published_job(job, run.folder) for job in run.jobs]
    timings = [kept(timing, records.RESULTS) for timing in run.timings]
    used = {line["run"] for line in (*jobs, *timings)}
    # Keep each start once: a file to which the same run is added again already has its earlier starts.
    starts = {start["run"]: kept(start, records.RESULTS) for start in run.starts if start["run"] in used}
    if once:
        starts = {name: _with_common_metrics(start, jobs) for name, start in starts.items()}
        jobs = [_once(job, starts.get(job["run"], RunStart())) for job in jobs]
    lines = [*starts.values(), *jobs, *timings]
    return "".join(json.dumps(rounded(line), allow_nan=False, separators=(",", ":")) + "\n" for line in lines)


def _refuse_unpublishable(run: Run) -> None:
    """Raise `InputError` for a run without a result, or with a job that does not name its run."""
    if not any(job["status"] == "ok" for job in run.jobs) and not len(run.timings):
        raise InputError(f"{run.folder}: the run has no results")
    for job in run.jobs:
        if "run" not in job:
            remedy = "give the folder that `neubtf-bench run` wrote"
            raise InputError(f"{run.folder}: {job['job']} has no 'run', as in a reference: {remedy}")


def _with_common_metrics(start: RunStart, jobs: Iterable[Job]) -> RunStart:
    """A start with the facts of metrics, if all its jobs have the same: each of them would repeat these."""
    facts = [job["metrics"] for job in jobs if job["run"] == start["run"] and "metrics" in job]
    if facts and all(each == facts[0] for each in facts):
        return {**start, "metrics": facts[0]}
    return start


def _once(job: Job, start: RunStart) -> Job:
    """A published job without what `load_run` puts back: the settings in the key of its fit, the facts and versions of
    metrics that its start has, and the names in each point of the curve of its fit, which becomes a list a name."""
    line: dict[str, Any] = dict(job)
    if "metrics" in start and start["metrics"] == job.get("metrics"):
        del line["metrics"]
        key = dict(job["score_key"])
        if key.get("metrics") == {name: facts["version"] for name, facts in job["metrics"].items()}:
            del key["metrics"]
        line["score_key"] = key
    if "settings" in job and job.get("fit_key", {}).get("settings") == job["settings"]:
        line["fit_key"] = {name: value for name, value in job["fit_key"].items() if name != "settings"}
    points = cast(list[dict[str, Any]], job.get("history"))
    if points and all(point.keys() == points[0].keys() for point in points):
        line["history"] = {name: [point[name] for point in points] for name in points[0]}
    return cast(Job, line)


def published_job(job: Job, folder: Path, use: Use = records.RESULTS) -> Job:
    """The record of a job of a run's folder as it is published: with fields of this `use`, and without what names this
    machine or a person, and what no table or page reads; the PSNR of its slices is packed into it."""
    line = kept(job, use)
    if "error" in line:
        line["error"] = _without_home(str(line["error"]))[:500]
    if job["status"] != "ok":
        return line
    if "file" in line:
        line["file"] = f"files/{Path(job['file']).name}"
    if "fitted" in line:  # the day is that of the scores
        line["fitted"] = {"git": line["fitted"].get("git")}
    line["scores"] = _published_scores(job)
    if "footprints" in line:
        line["footprints"] = {side: _without_counts(stats) for side, stats in line["footprints"].items()}
    if "pairs" in line:  # of parts of a group the scores have counts
        line["pairs"] = {name: count for name, count in line["pairs"].items() if ", " not in name}
    if "history" in line:
        line["history"] = rounded(line["history"], 4)  # of a curve that is drawn
    return line | packed_slices(job, folder)


def _without_home(text: str) -> str:
    """A text with ~ for the home folder, whose name is often a person's; one of / has no name, but is in every path."""
    home = Path.home()
    return text.replace(str(home), "~") if len(home.parts) > 1 else text


def _published_scores(job: Job) -> dict[str, Group]:
    """The scores of a job that tables show, by group of pairs."""
    scores = read_scores(job["scores"])
    shown = {name: group for name, group in scores.items() if name not in (SCENE_HELDOUT, OUTSIDE)}
    for group in shown.values():
        group["metrics"] = {name: _without_counts(stats) for name, stats in group["metrics"].items()}
        if RMSE in group["metrics"]:  # an error of radiance is shown pooled, and relative to the mean radiance
            stats = group["metrics"][RMSE]
            group["metrics"][RMSE] = {name: stats[name] for name in ("pooled", "relative") if name in stats}
    return shown


def _without_counts(stats: Statistics) -> Statistics:
    """A copy of the statistics. Counts of slices, which say why a number is missing or which share of slices is exact,
    stay only where one is."""
    counts = () if stats.get("exact") or None in stats.values() else ("exact", "slices")
    return {name: number for name, number in stats.items() if name not in counts}
