"""The columns of the summary over materials: each finds its number in the record of a job, and writes a mean of them.

A *row* is a `Row`, one job; `seeds` are the rows of one codec with its settings, one a seed. A metric may have variants
(`ssim`, `ssim_periodic`), which are one *family*. Times are × *floor*: multiples of the time of one bilinear fetch of a
colour. An *exact* slice has no error, so its PSNR has no number. The columns of tables by material are in
`reports.by_material`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from statistics import fmean

from bench.metrics import PERIODIC, in_decibels, is_relative, label_of
from bench.records import PSNR, MetricFacts
from reports.numbers import EXACT, NOT_COMPARABLE, fixed, integer, significant, stated
from reports.rows import MaterialRows, Row, unit_and_arrow

Value = float | str | None  # a number, a word, or nothing


@dataclass(frozen=True)
class Column:
    """A column: its name, its unit with an arrow to the better end, and its number for a measured row."""

    name: str
    unit: str
    value: Callable[[Row], Value]  # finds the number
    write: Callable[[float], str]  # formats it
    # Whether its number was measured apart from those of other rows: it gets a star, and is never the best.
    starred: Callable[[Row], bool] = lambda row: False
    # Of a row that reads “exact”: what it counts as in means, such as 48.13 dB; None leaves it out of them.
    counted: Callable[[Row], Value] = lambda row: None

    def star(self, seeds: Sequence[Row]) -> str:
        """A star if a number of these seeds is starred."""
        return "*" if any(self.starred(row) and self.value(row) is not None for row in seeds) else ""

    @property
    def sign(self) -> int:
        """1 if more is better, −1 if less is."""
        return 1 if "↑" in self.unit else -1

    def mean(self, seeds: Sequence[Row]) -> float | None:
        """The mean over seeds of the number; None if there is none."""
        values = [self.value(row) for row in seeds]
        counted = [self.counted(row) if value == EXACT else value for value, row in zip(values, seeds, strict=True)]
        numbers = [value for value in counted if isinstance(value, int | float)]
        return fmean(numbers) if numbers else None

    def is_exact(self, seeds: Sequence[Row]) -> bool:
        """Whether all of these rows read “exact”."""
        return all(self.value(row) == EXACT for row in seeds)


def _mean(name: str, unit: str, family: str, digits: int) -> Column:
    """A column of a metric: its mean over the slices that decide."""

    def value(row: Row) -> Value:
        found: Value = stated(row.stats(row.deciding_group, family), "mean")
        return found

    def counted(row: Row) -> Value:
        """The stored number of exact slices: 48.13 dB of PSNR, 1 of SSIM."""
        return row.stats(row.deciding_group, family).get("mean")

    return Column(name, unit, value, partial(fixed, digits=digits), counted=counted)


def _time(row: Row) -> Value:
    """The time of a query, × floor; `n/c` if it must not be compared, None without a timing.

    One that was timed in another start of the run than the other rows is shown, with a star: the machine may have been
    faster or slower then.
    """
    if row.timing is None:
        return None
    if row.timing_obstacle and not row.timed_apart:
        return NOT_COMPARABLE
    return row.timing["ratio_to_floor"]


def _fused(row: Row) -> Value:
    """The time of a query as one fused kernel, × floor; None where it was not measured."""
    return row.fused["ratio_to_floor"] if row.fused else None


def _whole(value: float) -> str:
    """A number rounded to an integer, because a mean over seeds may have decimals: 15,375,476."""
    return integer(round(value))


def summary(materials: Sequence[MaterialRows]) -> list[Column]:
    """Columns of a summary over materials besides PSNR: every other metric, size, time."""
    # By label: the full name of a metric, and what records say of it. Its variants share one label, so one column.
    metrics: dict[str, tuple[str, MetricFacts]] = {}  # facts: unit, direction, version
    for material in materials:
        for name, facts in material.metrics.items():
            metrics[label_of(name)] = name, facts
    columns = []
    for label, (name, facts) in metrics.items():
        if name != PSNR and not is_relative(name):  # errors of radiance have a table of their own
            family = name.removesuffix(PERIODIC)
            columns.append(_mean(label, unit_and_arrow(facts), family, 2 if in_decibels(name) else 3))
    columns.append(Column("total", "bytes ↓", lambda row: row.job["bytes"].get("total"), _whole))
    columns.append(Column("time", "× floor ↓", _time, significant, starred=lambda row: row.timed_apart))
    if any(row.fused for material in materials for row in material.measured):
        columns.append(Column("fused", "× floor ↓", _fused, significant))
    return columns
