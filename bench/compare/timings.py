"""Compares decoding times, as multiples of `mean-colour` timed in the same run. They are shown and decide nothing."""

from collections.abc import Sequence
from dataclasses import dataclass

from bench.records import CONDITIONS, Record, by_row

UNIT = "mean-colour"
FACTOR = 1.25  # a smaller change of a ratio is not mentioned


@dataclass(frozen=True)
class Advice:
    """Decoding time over that of `mean-colour`, with the 95 % interval that contains the intervals of all seeds."""

    base: float
    new: float
    base_interval: tuple[float, float]
    new_interval: tuple[float, float]

    @property
    def factor(self) -> float:
        return self.new / self.base

    @property
    def words(self) -> str:
        """ "slower" or "faster" if the intervals do not overlap and the factor is large enough to matter."""
        if self.factor > FACTOR and self.new_interval[0] > self.base_interval[1]:
            return "slower"
        if 1 / self.factor > FACTOR and self.new_interval[1] < self.base_interval[0]:
            return "faster"
        return ""


@dataclass(frozen=True)
class Multiple:
    """Mean time over that of `mean-colour`, the interval that contains those of all seeds, and the conditions."""

    mean: float
    interval: tuple[float, float]
    conditions: list[object]


def advice(base: Multiple | None, new: Multiple | None) -> Advice | None:
    """The times of one row in two runs; None if one lacks them or was timed under other conditions."""
    if not base or not new or base.conditions != new.conditions:
        return None
    return Advice(base.mean, new.mean, base.interval, new.interval)


def multiples(jobs: Sequence[Record], timings: Sequence[Record]) -> dict[tuple[str, str], Multiple]:
    """Times by row, (material, label). A time is divided by those of `mean-colour` taken in the same start of the run,
    because the speed of the machine may change between two starts; rows without such a time are left out.
    """
    by_job = {timing["job"]: timing for timing in timings}
    timed = by_row(job for job in jobs if job["job"] in by_job)
    rows = {row: [by_job[job["job"]] for job in ours] for row, ours in timed.items()}
    multiples = {row: _multiple(ours, rows.get((row[0], UNIT), [])) for row, ours in rows.items()}
    return {row: multiple for row, multiple in multiples.items() if multiple}


def _multiple(ours: list[Record], floors: list[Record]) -> Multiple | None:
    by_start: dict[str, list[float]] = {}
    for timing in floors:
        by_start.setdefault(timing["run"], []).append(timing["ns_per_sample"])
    floor = {start: sum(times) / len(times) for start, times in by_start.items()}
    ours = [timing for timing in ours if timing["run"] in floor]
    if not ours:
        return None
    bounds = [bound / floor[timing["run"]] for timing in ours for bound in timing["interval95_ns"]]
    mean = sum(timing["ns_per_sample"] / floor[timing["run"]] for timing in ours) / len(ours)
    return Multiple(mean, (min(bounds), max(bounds)), [ours[0].get(name) for name in CONDITIONS])
