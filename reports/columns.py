"""The columns of tables by material: each finds its number in a record, and writes one seed or several as a cell.

A table has one row a codec with its settings; a cell is over the jobs of that row, one a seed. A *row* in this module
is a `Row`, one such job. Quality is measured slice by slice: a *slice* is one picture of the material, all texels at
one pair of view and light directions. The pairs that *decide* are the held-out ones, which no codec sees in its fit, or
all pairs where none are held out. A record has statistics of each *group* of pairs (`train`, `heldout`, `heldout,
grazing view`): `mean` and `std` over its slices, `pooled` (of the mean error of all slices together), `worst` (the mean
of the worst tenth). A metric may have variants (`ssim`, `ssim_periodic`), which are one *family*.

Times are × *floor*: multiples of the time of one bilinear fetch of a colour. An *exact* slice has no error, so its PSNR
has no number.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from statistics import fmean, stdev
from typing import Any, cast

from bench.metrics import PERIODIC, in_decibels, is_relative, label_of
from bench.records import (
    PSNR,
    Job,
    MetricFacts,
)
from reports.numbers import EXACT, NONE, NOT_COMPARABLE, fixed, integer, plus_minus, significant, stated
from reports.rows import MaterialRows, Row

Value = float | tuple[float, ...] | str | None  # a number, several numbers of one cell, a word, or nothing


def elementwise(several: Sequence[tuple[float, ...]]) -> tuple[float, ...]:
    """The tuple of the means of the first elements, of the second ones, and so on, such as of (mean, deviation)."""
    return tuple(map(fmean, zip(*several, strict=True)))


def hull(several: Sequence[tuple[float, ...]]) -> tuple[float, ...]:
    """The smallest interval (low, high) that contains all of these intervals."""
    return min(low for low, _ in several), max(high for _, high in several)


@dataclass(frozen=True)
class Column:
    """A column: its name, its unit with an arrow to the better end, and its number for a measured row.

    In the methods, `seeds` are the rows of one codec with its settings on one material, one a seed.
    """

    name: str
    unit: str
    value: Callable[[Row], Value]  # finds the number
    write: Callable[[Any], str]  # formats a number, or a tuple of numbers
    # Finds the number for the file in which the measured data came, given its `rank`, `bytes` and `bits` a texel.
    native: Callable[[Mapping[str, Any]], Value] | None = None
    sparse: bool = False  # whether to leave the column out if no row has a number for it
    pool: Callable[[Sequence[tuple[float, ...]]], tuple[float, ...]] = elementwise  # makes one tuple of those of seeds
    # Whether its number was measured apart from those of other rows: it gets a star, and is never the best.
    starred: Callable[[Row], bool] = lambda row: False
    deviation: bool = True  # whether to show the deviation over seeds beside their mean
    whole_only: bool = False  # whether it says nothing about a scene, so that models of a scene are not marked in it
    over: str = "seeds"  # what the deviation of a cell is over, which its header says
    # Of a row that reads “exact”: what it counts as in means, such as 48.13 dB; None leaves it out of them.
    counted: Callable[[Row], Value] = lambda row: None

    def cell(self, seeds: Sequence[Row]) -> str:
        """The text of one codec's cell: the number if all seeds read the same, else mean ± std over them."""
        return f"{self._text(seeds)}{self.star(seeds)}"

    def star(self, seeds: Sequence[Row]) -> str:
        """A star if a number of these seeds is starred."""
        return "*" if any(self.starred(row) and self.value(row) is not None for row in seeds) else ""

    def _text(self, seeds: Sequence[Row]) -> str:
        """The text of a cell without its star: the number, the `pool` of tuples, or mean ± std over seeds; a dash
        without seeds."""
        if not seeds:
            return NONE
        texts = [self._one_text(self.value(row)) for row in seeds]
        if len(set(texts)) == 1:  # all seeds read the same
            return texts[0]
        values = [self._number(row) for row in seeds]
        tuples = [value for value in values if isinstance(value, tuple)]
        if tuples:  # an interval, or mean and std over slices: no deviation over seeds stands beside them
            return self.write(self.pool(tuples))
        numbers = [value for value in values if isinstance(value, int | float)]
        if not numbers:  # only words, such as "exact" and a dash: that of the first seed
            return texts[0]
        mean = self.write(fmean(numbers))
        # A single number has no deviation: the other seeds were not measured.
        if len(numbers) == 1 or not self.deviation:
            return mean
        return f"{mean} ± {self.write(stdev(numbers))}"

    def _number(self, row: Row) -> Value:
        """The value of a row; of one that reads “exact” what it counts as, if that is known."""
        value = self.value(row)
        if value == EXACT:
            counted = self.counted(row)
            return value if counted is None else counted
        return value

    def _one_text(self, value: Value) -> str:
        """One seed's value as text: a word as it is, and a dash for None."""
        if value is None:
            return NONE
        if isinstance(value, str):
            return value
        return self.write(value)

    @property
    def sign(self) -> int:
        """1 if more is better, −1 if less is, 0 if neither."""
        if "↑" in self.unit:
            return 1
        if "↓" in self.unit:
            return -1
        return 0

    def mean(self, seeds: Sequence[Row]) -> float | None:
        """The mean over seeds of the number, or of the first number of a tuple; None if there is none."""
        numbers = []
        for row in seeds:
            value = self._number(row)
            if isinstance(value, tuple):
                value = value[0]  # the mean of (mean, std), or the lower end of an interval
            if isinstance(value, int | float):
                numbers.append(value)
        return fmean(numbers) if numbers else None

    def score(self, seeds: Sequence[Row]) -> float | None:
        """How good the cell is, more is better, infinite if it is exact. By it the best of a column is marked.

        None if it is not a number or has a star, or if neither end of the scale is better.
        """
        if not self.sign or not seeds or self.star(seeds):
            return None
        if self.is_exact(seeds):
            return float("inf")
        mean = self.mean(seeds)
        return None if mean is None else self.sign * mean

    def is_exact(self, seeds: Sequence[Row]) -> bool:
        """Whether all of these rows read “exact”."""
        return all(self.value(row) == EXACT for row in seeds)


def _digits(metric: str) -> int:
    """The decimals of a metric in cells."""
    return 2 if in_decibels(metric) else 3


def _unit_and_arrow(metric: MetricFacts) -> str:
    """The unit of a metric with an arrow to the better end: "dB ↑"; without a unit the arrow alone."""
    unit = "" if metric["unit"] == "1" else metric["unit"]  # "1": it has no unit
    arrow = "↑" if metric["direction"] == "higher" else "↓"
    return f"{unit} {arrow}".strip()


def _mean(name: str, unit: str, family: str, group: str = "", digits: int = 2, statistic: str = "mean") -> Column:
    """A column of a metric: its mean over the slices of a group of pairs, or another `statistic` (`pooled`).

    Without a group, it is over the pairs that decide.
    """

    def value(row: Row) -> Value:
        return stated(row.stats(group or row.deciding_group, family), statistic)

    def counted(row: Row) -> Value:
        """The stored number of exact slices: 48.13 dB of PSNR, 1 of SSIM."""
        return row.stats(group or row.deciding_group, family).get(statistic)

    return Column(name, unit, value, partial(fixed, digits=digits), counted=counted)


def _spread(name: str, unit: str, family: str, digits: int = 2) -> Column:
    """A column of a metric: its mean ± std over the slices that decide."""

    def value(row: Row) -> Value:
        return stated(row.stats(row.deciding_group, family), "mean", "std")

    def counted(row: Row) -> Value:
        """The stored mean of exact slices, 48.13 dB of PSNR or 1 of SSIM, and its deviation, 0."""
        mean = row.stats(row.deciding_group, family).get("mean")
        return None if mean is None else (mean, 0.0)

    return Column(name, unit, value, partial(plus_minus, digits=digits), over="slices", counted=counted)


def bits(job: Job, size: int) -> float:
    """The bits a texel of a file of `size` bytes; the texels are those of the job's material."""
    height, width = job["shape"]
    return 8 * size / (height * width)


def _timed(name: str, unit: str, field: str, write: Callable[..., str] = significant) -> Column:
    """A column of a field of the timing: a number, or an interval (low, high).

    A number is starred if it was timed in another start of the run than the other rows: the machine may have been
    faster or slower then.
    """

    def value(row: Row) -> Value:
        """The number or the interval in a timing; `n/c` if it must not be compared, None without a timing."""
        if row.timing is None:
            return None
        # A time of another start is shown, with a star; one under other conditions is not.
        if row.timing_obstacle and not row.timed_apart:
            return NOT_COMPARABLE
        measured = dict(row.timing)[field]  # a dict, because the type of a record allows no variable as a key
        return tuple(measured) if isinstance(measured, list) else cast(float, measured)

    return Column(name, unit, value, write, pool=hull, starred=lambda row: row.timed_apart)


def _whole(value: float) -> str:
    """A number rounded to an integer, because a mean over seeds may have decimals: 15,375,476."""
    return integer(round(value))


# Of a native file `own` are the facts: see `Column.native`.
TOTAL = Column("total", "bytes ↓", lambda row: row.job["bytes"].get("total"), _whole, lambda own: own["bytes"])


def _fused(row: Row) -> Value:
    """The time of a query as one fused kernel, × floor; None where it was not measured."""
    return row.fused["ratio_to_floor"] if row.fused else None


_FLOOR = _timed("time", "× floor", "ratio_to_floor")
_FUSED = Column("fused", "× floor", _fused, significant, sparse=True)


def summary(materials: Sequence[MaterialRows]) -> list[Column]:
    """Columns of a summary over materials besides PSNR: every other metric, size, time."""
    # By label: the full name of a metric, and what records say of it. Its variants share one label, so one column.
    metrics: dict[str, tuple[str, MetricFacts]] = {}  # facts: unit, direction, version
    for material in materials:
        for name, facts in material.metrics.items():
            metrics[label_of(name)] = name, facts
    quality = []
    for label, (name, facts) in metrics.items():
        if name != PSNR and not is_relative(name):  # errors of radiance have a table of their own
            family = name.removesuffix(PERIODIC)
            quality.append(_mean(label, _unit_and_arrow(facts), family, digits=_digits(name)))
    times = [_FLOOR]
    if any(row.fused for material in materials for row in material.measured):
        times.append(_FUSED)
    # In a summary times are ranked, which an arrow in the unit asks for.
    ranked_times = [replace(time, unit="× floor ↓") for time in times]
    return [*quality, TOTAL, *ranked_times]
