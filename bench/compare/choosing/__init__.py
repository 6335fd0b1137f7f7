"""Chooses the best measured settings within limits, by validation pairs only, never by test pairs.

A *rung* is a codec at some settings, with its cost and its score: the mean over validation slices of display PSNR.
`budgets` chooses among the jobs of a run, `trades` among the choices of a trade. Imports nothing heavy.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bench.records import PSNR, VALIDATION, Record, gate, stats_of

NEAR_DB = 0.5  # within this many dB of the best counts as equally good


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
    return bool(validation_of(job).get("slices")) and gate(job["scores"]) == "heldout"
