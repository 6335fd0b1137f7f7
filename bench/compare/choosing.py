"""Chooses the best measured settings within limits, by validation pairs only, never by test pairs.

The score of a rung is the mean over validation slices of display PSNR. A choice of a trade is a codec file with an
execution and a precision. `budgets` chooses among the jobs of a run; the choices of a trade, which `bench.runs.trade`
measures, are rungs here. Imports nothing heavy, so an answer from stored measurements comes at once.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from bench.metrics import all_exact, stats_of
from bench.records import (
    PSNR,
    VALIDATION,
    Job,
    Statistics,
    Timing,
    counted,
    deciding_group,
    variant_of,
)

NEAR_DB = 0.5  # within this many dB of the best counts as equally good
UNCOMPRESSED = "table"  # the codec whose file is the BTF itself: a bound for others, and no choice
DOUBLE_DB = 10.0  # a score that misses its limit by so many dB counts as a cost of twice its limit
TIE_DB = 0.02  # what rounding changes between executions of one file, and more: nobody sees it


@dataclass(frozen=True)
class Rung:
    """A codec at some settings: its cost, and its score."""

    size: float  # size of the whole file, in the unit of the limit
    score: float  # mean display PSNR in dB over validation slices
    time: float | None = None  # the longest time of a query, in the unit of the limit; None: not measured
    of: Any = None  # the jobs, one a seed, or the choice of a trade
    gpu: float | None = None  # bytes of the exported shader's textures; None: not counted, or there is no shader


@dataclass(frozen=True)
class Limits:
    """The largest cost of a rung, and the score that it must reach; None: no limit."""

    size: float | None = None
    time: float | None = None
    score: float | None = None
    gpu: float | None = None

    def misses(self, rung: Rung) -> dict[str, float]:
        """By field of a limit, how much a rung misses it; at most 0 if it meets it.

        A cost misses by a share of its limit, see `_excess`, and a score by its distance in units of `DOUBLE_DB`.
        """
        misses = {}
        if self.size is not None:
            misses["size"] = _excess(rung.size, self.size)
        if self.time is not None:
            misses["time"] = _excess(rung.time, self.time)
        if self.gpu is not None:
            misses["gpu"] = _excess(rung.gpu, self.gpu)
        if self.score is not None:
            misses["score"] = (self.score - rung.score) / DOUBLE_DB
        return misses

    def missed(self, rung: Rung) -> list[str]:
        """The fields of the limits that a rung does not meet."""
        return [field for field, miss in self.misses(rung).items() if miss > 0]


def _excess(cost: float | None, limit: float) -> float:
    """How much a cost is above its limit, as a share of the limit; infinite if it was not measured."""
    return math.inf if cost is None else cost / limit - 1


def best_rung(rungs: Sequence[Rung], limits: Limits, tie: float = 0.0) -> Rung | None:
    """The rung that meets the limits with the highest score or, if they ask for a score, with the smallest file.

    Ties go to the smaller file, then to the faster query, then to the first. With a `tie`, scores at most so many dB
    below the highest count as equal, and the fastest of these is chosen. None if no rung meets the limits.
    """
    within_limits = [rung for rung in rungs if not limits.missed(rung)]
    if limits.score is not None:
        return min(within_limits, key=lambda rung: (rung.size, _time(rung)), default=None)
    if not tie:
        return min(within_limits, key=lambda rung: (-rung.score, rung.size, _time(rung)), default=None)
    highest = max((rung.score for rung in within_limits), default=0.0)
    equal = [rung for rung in within_limits if rung.score >= highest - tie]
    return min(equal, key=lambda rung: (_time(rung), rung.size), default=None)


def nearest(rungs: Sequence[Rung], limits: Limits) -> Rung:
    """The rung that misses the limits least, for a message where none meets them."""

    def distance(rung: Rung) -> float:
        """The sum of the shares by which a rung misses the limits that it does not meet."""
        return sum(max(0.0, miss) for miss in limits.misses(rung).values())

    return min(rungs, key=distance)


def _time(rung: Rung) -> float:
    """The time of a rung to sort by; infinite where it was not measured."""
    return math.inf if rung.time is None else rung.time


def validation_of(job: Job) -> Statistics:
    """The statistics of a job's display PSNR over validation pairs; empty if it was not scored at any."""
    if "scores" not in job:  # it has no result
        return {}
    return stats_of(job, PSNR, VALIDATION)


def has_validation(job: Job) -> bool:
    """Whether a job may be chosen: it has a score of validation pairs, and a score of test pairs to show."""
    validation = validation_of(job)
    if not validation or not validation.get("slices", 1):  # published records have no count where there are some
        return False
    return deciding_group(job["scores"]) == "heldout"


def usable_rungs(choices: list[Timing], material: str) -> list[Rung]:
    """The choices of a material that have scores of validation pairs, as rungs: sizes are in bytes, and times those of
    `longest_ns`. The uncompressed table is left out."""
    rungs = []
    for row in choices:
        if row["material"] != material or "error" in row:  # one with an error was not measured
            continue
        if row.get("codec") == UNCOMPRESSED:
            continue
        validation = row.get("validation", {})
        mean = validation.get("mean")  # None if no slice has an error, so that PSNR is infinite
        if validation.get("slices") and mean is not None:
            rungs.append(Rung(row["bytes"], mean, longest_ns(row), row))
    return rungs


def longest_ns(row: Timing) -> float:
    """The upper end of the 95 % interval of a choice's time, in ns a sample: a choice fits a limit if this does.

    The stored interval is of the ratio of this time to that of a floor, which was timed beside it. So its upper end
    over the ratio itself says how far above the time the interval reaches.
    """
    upper_share: float = row["ratio_interval95"][1] / row["ratio_to_floor"]
    return row["ns_per_sample"] * upper_share


def on_front(rows: Sequence[Timing], cost: Literal["ns_per_sample", "bytes"]) -> set[str]:
    """The names of the choices on the Pareto front: no other has at least the PSNR for at most the cost, and is better
    in one. All rows have times and scores; `cost` is the field of the cost."""
    places = {row["job"]: (round(counted(row["psnr"]), 2), row[cost]) for row in rows}  # executions differ by rounding

    def beaten(place: tuple[float, float]) -> bool:
        """Whether another place has at least the PSNR for at most the cost."""
        psnr, price = place
        as_good = {other for other in places.values() if other[0] >= psnr and other[1] <= price}
        return len(as_good) > 1  # the place itself is among them

    return {name for name, place in places.items() if not beaten(place)}


def best_choices_in_words(choices: list[Timing], material: str) -> Iterator[str]:
    """Sentences that name the best choice by validation pairs, and the fastest and the smallest one within `NEAR_DB` of
    it, with their figures."""
    rungs = usable_rungs(choices, material)
    if not rungs:
        return
    best = max(rungs, key=lambda rung: rung.score)
    near = [rung for rung in rungs if rung.score >= best.score - NEAR_DB]
    yield f"{material}: the best is {choice_in_words(best.of)}."
    for most, more, key in (("fastest", "faster", "ns_per_sample"), ("smallest", "smaller", "bytes")):
        # Of the choices that are near, the one with the least time, or the fewest bytes.
        least = min(near, key=lambda rung: (rung.of[key], rung.of["ns_per_sample"]))
        is_other = least.of[key] != best.of[key]
        found = f"the {most} is {choice_in_words(least.of)}" if is_other else f"no other is {more}"
        yield f"{material}: within {NEAR_DB} dB of it, {found}."


def is_plain(row: Timing) -> bool:
    """Whether a choice is of the default execution and precision."""
    return (row["execution"], row["dtype"]) == ("eager", "float32")


def name_of_choice(row: Timing) -> str:
    """The name of a choice: the codec's label, and its execution and precision if they are not the default."""
    if is_plain(row):
        return str(row["label"])
    variant = variant_of(row)
    if row.get("emulated"):
        variant += ", emulated"
    return f"{row['label']} [{variant}]"


def choice_in_words(row: Timing) -> str:
    """A choice with its figures, in words: first the PSNR that decides, then that of test pairs."""
    of_validation = _decibels(row["validation"]["mean"], is_exact=all_exact(row["validation"]))
    of_test = _decibels(row["psnr"], is_exact="worst" in row and row["worst"] is None)
    quality = f"{of_validation} on validation pairs, {of_test} on test pairs"
    return f"{name_of_choice(row)}: {quality}, {row['bytes']:,} bytes, {row['ns_per_sample']:,.0f} ns a sample"


def _decibels(value: float | None, is_exact: bool) -> str:
    """A PSNR in words: "exact" if no slice has an error, "no number" for None."""
    if is_exact:
        return "exact"
    return "no number" if value is None else f"{value:.2f} dB"
