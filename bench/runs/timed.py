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
    materials = {job["job"]: unreported(recorded(folder, job, device)) for job in jobs}
    decoded = {name: material for name, material in materials.items() if not material.opaque}
    if not decoded:
        return []
    ones = {name + ONE_TEXEL: one for name, material in decoded.items() if (one := material.at_one_texel())}
    conditions = timing.conditions(threads, device)
    found = timing.time_materials(decoded | ones, threads, show=show)
    at_one = {name: found[name + ONE_TEXEL].summary() for name in decoded if name + ONE_TEXEL in ones}
    return [
        {"kind": "timing", "job": name}
        | conditions
        | times.summary()
        | ({"ratio_at_one_texel": at_one[name]["ratio_to_floor"]} if name in at_one else {})
        | {"samples_ns": times.samples.tolist(), "floor_ratios": times.ratios.tolist()}
        for name, times in found.items()
        if name in decoded
    ]
