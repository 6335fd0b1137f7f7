"""Keeps the records of a run: everything that tables show, in a file small enough to commit beside a document.

Removed are: host names, raw timing samples, tracebacks, pictures, and numbers of groups that no table shows. The scores
of slices stay, packed, so that paired intervals can be computed. Numbers have seven digits.
"""

import json
from pathlib import Path

from bench.compare.reference import rounded
from bench.compare.slices import decibels, packed
from bench.inputs.errors import InputError
from bench.records import PSNR, RESULTS, VALIDATION, Record, Run, gate, kept


def published(run: Run) -> str:
    """A line for each start that produced something, each job and each timing. `InputError` if there is no result."""
    if not any(job["status"] == "ok" for job in run.jobs):
        raise InputError(f"{run.folder}: the run has no results")
    jobs = [published_job(job, run.folder) for job in run.jobs]
    timings = [kept(timing, RESULTS) for timing in run.timings]
    used = {line["run"] for line in (*jobs, *timings)}
    # Keep each start once: a file to which the same run is added again already has its earlier starts.
    starts = {start["run"]: kept(start, RESULTS) for start in run.starts if start["run"] in used}
    lines = [*starts.values(), *jobs, *timings]
    return "".join(json.dumps(rounded(line), allow_nan=False) + "\n" for line in lines)


def published_job(job: Record, folder: Path) -> Record:
    """The record of a job of a run's folder as it is published: without host, paths, tracebacks and home folders."""
    line = kept(job, RESULTS)
    if "error" in line:
        # The name of a home folder is often a person's name; 500 characters of an error are enough.
        home, error = Path.home(), str(line["error"])
        line["error"] = (error.replace(str(home), "~") if len(home.parts) > 1 else error)[:500]
    if job["status"] != "ok":
        return line
    if "file" in job:
        line["file"] = f"files/{Path(job['file']).name}"
    decides = gate(job["scores"])
    line["scores"] = {
        name: group
        for name, group in job["scores"].items()
        if name in (decides, "all", "train", VALIDATION, "scene") or name.startswith(f"{decides}, ")
    }
    if (slices := decibels(folder, job)) is not None:
        line["slices"] = {PSNR: packed(slices)}
    return line
