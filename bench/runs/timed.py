"""Times the decoders of one material of a run in turns; in a worker process if a codec is from another distribution."""

import logging
from concurrent.futures import BrokenExecutor
from pathlib import Path

from bench import timing
from bench.codec import Progress, silent
from bench.codecs.registry import from_outside
from bench.codecs.scene_material import unreported
from bench.records import Record
from bench.runs.evaluation import recorded
from bench.runs.executors import processes

ONE_TEXEL = " at one texel"  # suffix of a job's name: a second contestant for this job

log = logging.getLogger(__name__)


def timings(folder: Path, jobs: list[Record], device: str, threads: int, show: Progress = silent) -> list[Record]:
    """The timing of each job's decoder. If a decoder from outside crashes its process, the others are timed again."""
    ours = [job for job in jobs if not from_outside(job["codec"])]
    if len(ours) == len(jobs):
        return measured(folder, jobs, device, threads, show)
    with processes(1, threads) as workers:
        try:
            return workers.executor.submit(measured, folder, jobs, device, threads).result()
        except BrokenExecutor:
            others = ", ".join(job["job"] for job in jobs if job not in ours)
            log.warning("not timed, because one of them ended the timing process: %s", others)
    return measured(folder, ours, device, threads, show) if ours else []


def measured(folder: Path, jobs: list[Record], device: str, threads: int, show: Progress = silent) -> list[Record]:
    """The timing of each job's decoder, measured in this process; also at one texel a query if it can."""
    decoded, ones = {}, {}
    for job in jobs:
        material = unreported(recorded(folder, job, device))
        if not material.opaque:
            decoded[job["job"]] = material
            if one := material.at_one_texel():
                ones[job["job"] + ONE_TEXEL] = one
    if not decoded:
        return []
    found = timing.time_materials(decoded | ones, threads, show=show)
    records = []
    for name in decoded:
        times = found[name]
        record: Record = {"kind": "timing", "job": name} | timing.conditions(threads, device) | times.summary()
        if at_one := found.get(name + ONE_TEXEL):
            record["ratio_at_one_texel"] = at_one.summary()["ratio_to_floor"]
        records.append(record | {"samples_ns": times.samples.tolist(), "floor_ratios": times.ratios.tolist()})
    return records
