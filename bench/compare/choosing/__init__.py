"""Chooses the best measured settings within limits, by validation pairs only, never by test pairs.

A *rung* is a codec at some settings, with its cost and its score: the mean over validation slices of display PSNR.
`budgets` chooses among the jobs of a run; the choices of a trade, which `bench.runs.trade` measures, are rungs here.
Imports nothing heavy, so an answer from stored measurements comes at once.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from bench.machine.devices import is_gpu
from bench.records import MOST_DB, PSNR, VALIDATION, Record, Run, deciding_group, load_run, load_trade, stats_of

NEAR_DB = 0.5  # within this many dB of the best counts as equally good
FLOAT_BYTES = 4


@dataclass(frozen=True)
class Rung:
    """A codec at some settings: its cost, and its score."""

    size: float  # size of the whole file, in the unit of the limit
    score: float  # mean display PSNR in dB over validation slices
    time: float | None = None  # time of a query, in the unit of the limit; None: not measured
    of: Any = None  # the jobs, one a seed, or the choice of a trade


@dataclass(frozen=True)
class Limits:
    """The largest cost of a rung, and the score that it must reach; None: no limit."""

    size: float | None = None
    time: float | None = None
    score: float | None = None

    def misses(self, rung: Rung) -> list[float]:
        """By how much a rung misses each limit, as a share of the limit (for a score: dB / 10); ≤ 0 if it meets it."""
        misses = [] if self.size is None else [rung.size / self.size - 1]
        misses += [] if self.time is None else [_time(rung) / self.time - 1]
        return misses + ([] if self.score is None else [(self.score - rung.score) / 10])


def chosen(rungs: Sequence[Rung], limits: Limits) -> Rung | None:
    """The rung that meets the limits with the highest score or, if they ask for a score, with the smallest file.

    Ties go to the smaller file, then to the faster query, then to the first. None if no rung meets the limits.
    """
    met = [rung for rung in rungs if max(limits.misses(rung)) <= 0]
    enough = limits.score is not None
    return min(met, key=lambda rung: (0.0 if enough else -rung.score, rung.size, _time(rung)), default=None)


def nearest(rungs: Sequence[Rung], limits: Limits) -> Rung:
    """The rung that misses the limits least."""
    return min(rungs, key=lambda rung: sum(max(0.0, miss) for miss in limits.misses(rung)))


def _time(rung: Rung) -> float:
    return math.inf if rung.time is None else rung.time


def validation_of(job: Record) -> Mapping[str, Any]:
    """The statistics of a job's display PSNR over validation pairs; empty if it was not scored at any."""
    return stats_of(job, PSNR, VALIDATION) if "scores" in job else {}


def has_validation(job: Record) -> bool:
    """Whether a job may be chosen: it has a score of validation pairs, and a score of test pairs to show."""
    return bool(validation_of(job).get("slices")) and deciding_group(job["scores"]) == "heldout"


def usable(choices: list[Record], material: str) -> list[Rung]:
    """The choices of a material that have scores of validation pairs, as rungs with bytes and ns a sample."""
    return [
        Rung(row["bytes"], float(row["validation"]["mean"]), row["ns_per_sample"], row)
        for row in choices
        if row["material"] == material and "error" not in row and row.get("validation", {}).get("slices")
    ]


@lru_cache(maxsize=1)
def fused_times(run: Run) -> dict[str, Record]:
    """The time of each job as one fused kernel in float32."""
    choices = (load_trade(run.folder) or {"choices": []})["choices"]
    fused = (row for row in choices if (row["execution"], row["precision"]) == ("fused", "float32"))
    return {row["job"]: row for row in fused if "job" in row and "ratio_to_floor" in row}


def answers(material: str, choices: list[Record]) -> Iterator[str]:
    """Sentences that name the best choice by validation pairs, and the fastest and the smallest one within `NEAR_DB` of
    it, with their figures of test pairs."""
    rungs = usable(choices, material)
    if not rungs:
        return
    best = max(rungs, key=lambda rung: rung.score)
    near = [rung for rung in rungs if rung.score >= best.score - NEAR_DB]
    yield f"{material}: the best is {described(best.of)}."
    for word, key in (("fast", "time"), ("small", "size")):
        least = min(near, key=lambda rung: (getattr(rung, key), rung.time))
        better = getattr(least, key) != getattr(best, key)
        answer = f"the {word}est is {described(least.of)}" if better else f"no other is {word}er"
        yield f"{material}: within {NEAR_DB} dB of it, {answer}."


def named(row: Record) -> str:
    """The name of a choice: the codec's label, and its execution and precision if they are not the default."""
    how = f"{row['execution']} {row['precision']}" + (", emulated" if row.get("emulated") else "")
    return str(row["label"]) + ("" if how == "eager float32" else f" [{how}]")


def described(row: Record) -> str:
    """A choice with its figures, in words."""
    quality = "exact" if row["psnr"] >= MOST_DB else f"{row['psnr']:.2f} dB"
    return f"{named(row)}: {quality}, {row['bytes']:,} bytes, {row['ns_per_sample']:,.0f} ns a sample"


def held(folder: Path, row: Record) -> str:
    """Which device a choice was timed on, and the size of its textures on a GPU, by the record of its job."""
    threads = row.get("threads", 1)
    whose = "the GPU's" if is_gpu(row["device"]) else f"the CPU's, {threads} thread{'s' * (threads != 1)}"
    job = load_run(folder).job(row.get("job", "")) or {}
    floats = job.get("cost", {}).get("texture_floats", 0)
    textures = f"{FLOAT_BYTES * floats:,} bytes of textures at {FLOAT_BYTES} bytes a float" if floats else "no textures"
    whole = f", {job['resident']:,} with tables and networks" if job.get("resident") else ""
    return f"time: {whose}; on a GPU: {textures}{whole}, of a file of {row['bytes']:,}"
