"""Compares decoding times, as multiples of `mean-colour` timed in the same run. They are shown and decide nothing."""

from collections.abc import Sequence
from dataclasses import dataclass

from bench.records import CONDITIONS, Record, by_row, grouped

UNIT = "mean-colour"
FACTOR = 1.25  # a smaller change of a ratio is not mentioned


@dataclass(frozen=True)
class Multiple:
    """Mean time over that of `mean-colour`, the 95 % interval that contains those of all seeds, and the conditions."""

    mean: float
    interval: tuple[float, float]
    conditions: list[object]


@dataclass(frozen=True)
class Advice:
    """The times of one row in two runs, under the same conditions."""

    base: Multiple
    new: Multiple

    @property
    def words(self) -> str:
        """ "slower" or "faster" if the intervals do not overlap and the factor is large enough to matter."""
        if self.new.mean > FACTOR * self.base.mean and self.new.interval[0] > self.base.interval[1]:
            return "slower"
        if self.base.mean > FACTOR * self.new.mean and self.new.interval[1] < self.base.interval[0]:
            return "faster"
        return ""


def advice(base: Multiple | None, new: Multiple | None) -> Advice | None:
    """The times of one row in two runs; None if one lacks them or was timed under other conditions."""
    return Advice(base, new) if base and new and base.conditions == new.conditions else None


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
    by_start = grouped(floors, lambda timing: timing["run"])
    floor = {start: sum(each["ns_per_sample"] for each in many) / len(many) for start, many in by_start.items()}
    ours = [timing for timing in ours if timing["run"] in floor]
    if not ours:
        return None
    bounds = [bound / floor[timing["run"]] for timing in ours for bound in timing["interval95_ns"]]
    mean = sum(timing["ns_per_sample"] / floor[timing["run"]] for timing in ours) / len(ours)
    return Multiple(mean, (min(bounds), max(bounds)), [ours[0].get(name) for name in CONDITIONS])
