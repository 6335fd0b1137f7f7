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
    if len(ours) < len(jobs):
        with processes(1, threads) as workers:
            try:
                return workers.executor.submit(measured, folder, jobs, device, threads).result()
            except BrokenExecutor:
                others = ", ".join(job["job"] for job in jobs if job not in ours)
                log.warning("not timed, because one of them ended the timing process: %s", others)
    return measured(folder, ours, device, threads, show)


def measured(folder: Path, jobs: list[Record], device: str, threads: int, show: Progress = silent) -> list[Record]:
    """The timing of each job's decoder, measured in this process; also at one texel a query if it can."""
    materials = {}
    for job in jobs:
        material = unreported(recorded(folder, job, device))
        if not material.opaque:
            materials[job["job"]] = material
    ones = {name + ONE_TEXEL: one for name, each in materials.items() if (one := each.at_one_texel())}
    found = timing.time_materials(materials | ones, threads, show=show) if materials else {}
    records = []
    for name in materials:
        record: Record = {"kind": "timing", "job": name} | timing.conditions(threads, device) | found[name].summary()
        if name + ONE_TEXEL in found:
            record["ratio_at_one_texel"] = found[name + ONE_TEXEL].summary()["ratio_to_floor"]
        samples = {"samples_ns": found[name].samples.tolist(), "floor_ratios": found[name].ratios.tolist()}
        records.append(record | samples)
    return records
