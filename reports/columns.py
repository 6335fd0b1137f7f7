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

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from statistics import fmean, stdev
from typing import Any, NamedTuple, cast

from bench.metrics import PERIODIC, in_decibels, is_relative, label_of, metric_of
from bench.records import (
    LOW_LIGHT,
    OUTSIDE,
    PSNR,
    RMSE,
    SCENE_HELDOUT,
    Job,
    MetricFacts,
    deciding_group,
    metrics_of,
    shown_columns,
)
from reports.numbers import EXACT, NONE, NOT_COMPARABLE, fixed, integer, plus_minus, significant, stated
from reports.rows import MaterialRows, Row, facts_of

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
_PARAMETERS = Column("decoder", "param.", lambda row: row.job["parameters"], _whole)
_CHANNELS = Column("tex.", "chan.", lambda row: row.job["cost"]["texture_channels"], _whole, lambda own: own["rank"])
TOTAL = Column("total", "bytes ↓", lambda row: row.job["bytes"].get("total"), _whole, lambda own: own["bytes"])
_SHARED = Column("shared", "bytes", lambda row: row.job["bytes"].get("shared"), _whole, sparse=True)
BITS = Column(
    "bits per",
    "texel ↓",
    lambda row: bits(row.job, row.job["bytes"]["total"]),
    partial(significant, digits=4),
    lambda own: own["bits"],
)
_TRAIN = _mean("PSNR train", "dB ↑", PSNR, "train")
HELDOUT = _mean("PSNR", "dB ↑", PSNR)
PER_SLICE = _spread("PSNR", "dB ↑", PSNR)


def _worst(row: Row) -> Value:
    """The mean PSNR of the worst tenth of the slices that decide; None where a record lacks it."""
    stats = row.stats(row.deciding_group, PSNR)
    # `stated` would say "not applicable", but an older record just lacks it.
    return stated(stats, "worst") if "worst" in stats else None


def _relative_error(row: Row) -> Value:
    """The RMSE of radiance over the pairs that decide, in per cent of its mean."""
    share = row.stats(row.deciding_group, RMSE).get("relative")
    return None if share is None else 100 * share


def _fused(row: Row) -> Value:
    """The time of a query as one fused kernel, × floor; None where it was not measured."""
    return row.fused["ratio_to_floor"] if row.fused else None


def _from_to(interval: tuple[float, float]) -> str:
    """An interval as a cell: "120 to 125"."""
    low, high = interval
    return f"{significant(low)} to {significant(high)}"


_WORST = Column("worst tenth", "dB ↑", _worst, partial(fixed, digits=2))
_POOLED = _mean("PSNR pooled", "dB ↑", PSNR, statistic="pooled")
RELATIVE_ERROR = Column("RMSE", "% mean ↓", _relative_error, partial(fixed, digits=1))
_BETWEEN = Column(
    "between texels",
    "dB ↑",
    lambda row: row.job["between"]["mean"] if "between" in row.job else None,
    partial(fixed, digits=2),
    sparse=True,
)
_NS = _timed("time", "ns ↓", "ns_per_sample")
_FLOOR = _timed("time", "× floor", "ratio_to_floor")
_FUSED = Column("fused", "× floor", _fused, significant, sparse=True)
_INTERVAL = _timed("95 % interval", "ns", "interval95_ns", _from_to)

_NAMED = {"decoder", "texture", "total", "shared"}  # parts of the bytes that have columns of their own


def _other_bytes(job: Job) -> int:
    """The bytes of a file that no other column counts."""
    return sum(cast(int, size) for part, size in job["bytes"].items() if part not in _NAMED)


SIZE = (
    _PARAMETERS,
    _CHANNELS,
    Column("decoder", "bytes", lambda row: row.job["bytes"].get("decoder"), _whole),
    Column("texture", "bytes", lambda row: row.job["bytes"].get("texture"), _whole),
    Column("other", "bytes", lambda row: _other_bytes(row.job), _whole),
    TOTAL,
    _SHARED,
    Column("resident", "bytes", lambda row: row.job.get("resident"), _whole, sparse=True),
    BITS,
)


def _declared_columns() -> list[Column]:
    """The columns that fields of a record declare; see `bench.records.shown_columns`."""
    declared = []
    # `digits` are significant ones; 0 for an integer.
    for field, (name, unit, digits) in shown_columns().items():
        write = partial(significant, digits=digits) if digits else _whole
        declared.append(Column(name, unit, partial(_value_of_field, field), write))
    return declared


def _value_of_field(name: str, row: Row) -> Value:
    """The value of a field of a row's record, by the field's name; None where the record lacks it."""
    return cast(Value, dict(row.job).get(name))


def time() -> list[Column]:
    """The columns that fields declare, such as the seconds of a fit, and those of the time of a query."""
    return [*_declared_columns(), _NS, _INTERVAL, _FLOOR, _FUSED]


def scored(material: MaterialRows) -> list[Column]:
    """Columns of a file that was scored alone, without a record of its fit."""
    sizes = []
    if all(row.job["bytes"] for row in material.measured):  # slices that another program computed come without a file
        sizes = [_PARAMETERS, _CHANNELS, TOTAL, BITS]
    train = replace(_TRAIN, name="train")  # a shorter name, because a terminal is narrow
    return [*sizes, train, HELDOUT, *_others(material, _mean)]


def short(material: MaterialRows) -> list[Column]:
    """Columns that fit into the width of a terminal."""
    return means([*scored(material), *_declared_columns(), _NS, _FLOOR, _FUSED], HELDOUT)


def means(chosen: Sequence[Column], *with_deviation: Column) -> list[Column]:
    """The same columns, of which only those in `with_deviation` show a deviation over seeds: a terminal is narrow."""
    narrowed = []
    for column in chosen:
        narrowed.append(column if column in with_deviation else replace(column, deviation=False))
    return narrowed


def quality(material: MaterialRows) -> list[Column]:
    """Columns of PSNR of training and of held-out pairs, and of every other metric."""
    # All cells of a row show one kind of deviation: that over seeds, if there are several seeds, else that over slices.
    if len(material.seeds) > 1:
        return [_TRAIN, HELDOUT, _WORST, _POOLED, *_others(material, _mean)]
    return [_TRAIN, PER_SLICE, _WORST, _POOLED, *_others(material, _spread)]


def main(material: MaterialRows) -> list[Column]:
    """Columns of cost, quality and time of a codec."""
    return [*SIZE, *quality(material), *time()]


def papers(material: MaterialRows) -> list[Column]:
    """Every metric as papers report it: mean ± std over slices."""
    return [PER_SLICE, *_others(material)]


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


def _others(material: MaterialRows, make: Callable[..., Column] = _spread) -> Iterator[Column]:
    """A column for each metric other than PSNR, made by `make`: `_mean` or, with the std over slices, `_spread`.

    Errors of radiance are left out: they have a table of their own.
    """
    for name, metric in material.metrics.items():
        if name != PSNR and not is_relative(name):
            yield make(label_of(name), _unit_and_arrow(metric), family=name, digits=_digits(name))


def bands(job: Job) -> list[Column]:
    """Columns of PSNR over each band of the pairs that decide, such as grazing views, and how many slices it has.

    `job` is any comparable one of the material: all have the same bands.
    """
    return [_mean(name, f"dB ↑ ({count:,})", PSNR, group) for name, group, count in _bands(job)]


def radiance_bands(job: Job) -> list[Column]:
    """Columns of the error of linear radiance over each band, absolute and relative; for `job` see `bands`."""

    def value(group: str, row: Row) -> Value:
        """The RMSE over a group and, if known, the same in per cent of the mean radiance; None if not measured."""
        stats = row.stats(group, RMSE)
        absolute = stats.get("pooled")
        relative = stats.get("relative")
        if absolute is None:
            return None
        if relative is None:
            return (absolute,)
        return absolute, 100 * relative

    def write(numbers: tuple[float, ...]) -> str:
        """Such a value as text: "0.0123 (4.5 %)"."""
        relative = fixed(numbers[1], 1) if len(numbers) > 1 else NONE
        return f"{significant(numbers[0])} ({relative} %)"

    made = []
    for name, group, count in _bands(job):
        made.append(Column(name, f"radiance ↓ ({count:,})", partial(value, group), write))
    return made


def footprints(job: Job) -> list[Column]:
    """Columns of PSNR at each footprint: the side in texels of the square over which an answer is averaged; then that
    of answers between texels, if there are some.

    `job` is any comparable one of the material; its record names footprints as text, "1", "2".
    """

    def value(side: str, row: Row) -> Value:
        return stated(row.job["footprints"].get(side, {}), "mean")

    made = []
    for side in job["footprints"]:
        name = "1 texel" if side == "1" else f"{side} texels"
        made.append(Column(name, "dB ↑", partial(value, side), partial(fixed, digits=2)))
    return [*made, _BETWEEN]


class _Band(NamedTuple):
    """A group of pairs as a column: the name in the header, the group in a record, and the number of its slices."""

    name: str
    group: str
    slices: int


def _bands(job: Job) -> list[_Band]:
    """All pairs that decide, then the subsets of them, without subsets of subsets, which would be too many columns;
    last the pairs of low light, where there are some, which decide nothing.

    A record names a group after what it is part of: "heldout", then "heldout, grazing view".
    """
    scores = job["scores"]
    deciding = deciding_group(scores)
    subsets = []
    for group in scores:
        parent, _, subset = group.partition(", ")
        is_subset_of_subset = ", " in subset
        if parent == deciding and subset and not is_subset_of_subset:
            subsets.append(_Band(_BAND_NAMES.get(subset, subset), group, scores[group].get("slices", 0)))
    subsets.sort(key=lambda band: _band_place(band.name))
    if LOW_LIGHT in scores:
        subsets.append(_Band("θ_i>75°", LOW_LIGHT, scores[LOW_LIGHT].get("slices", 0)))
    all_name = "held out" if deciding == "heldout" else "all"
    return [_Band(all_name, deciding, scores[deciding].get("slices", 0)), *subsets]


def _band_place(name: str) -> int:
    """Where the column of a band stands, in the order of `_BAND_NAMES`; bands with other names are last."""
    order = list(_BAND_NAMES.values())
    return order.index(name) if name in order else len(order)


def scene(job: Job) -> list[Column]:
    """Columns of quality in the frames of a scene, over the pairs that the scene uses, and over the others.

    A *frame* is a rendered picture of the scene. *Weighted* metrics are over the queries that the scene makes. `job` is
    any comparable one of the material; no column if it was not scored in a scene.
    """
    if "scene" not in job:
        return []

    def value(family: str, row: Row) -> Value:
        """A metric of the frames; “exact” where it has no number, None where it was not measured."""
        values = row.job.get("scene", {}).get("metrics", {})
        name = metric_of(values, family)  # the variant of the metric that scored this job; "" for none
        if not name:
            return None
        return EXACT if values[name] is None else values[name]

    chosen = [TOTAL]
    # Pairs that are held out and that the scene uses; a scene may use none.
    if SCENE_HELDOUT in job["scores"]:
        chosen.append(_mean("held out in the scene", "dB ↑", PSNR, SCENE_HELDOUT))
    for name, metric in _not_of_radiance(job, job["scene"]["metrics"]):
        write = partial(fixed, digits=_digits(name))
        chosen.append(Column(f"frames {label_of(name)}", _unit_and_arrow(metric), partial(value, name), write))
    for name, metric in _not_of_radiance(job, metrics_of(job, "scene")):  # the group of the pairs that the scene uses
        label = f"weighted {label_of(name)}"
        weighted = _mean(label, _unit_and_arrow(metric), name, group="scene", digits=_digits(name), statistic="pooled")
        chosen.append(weighted)
    outside = _mean("outside PSNR", "dB ↑", PSNR, OUTSIDE)  # over the pairs that the scene does not use
    chosen += [replace(outside, whole_only=True), replace(HELDOUT, whole_only=True)]
    return chosen


def _not_of_radiance(job: Job, names: Iterable[str]) -> Iterator[tuple[str, MetricFacts]]:
    """The names of metrics, each with what the record says of it, without errors of radiance.

    Those are stated relative to the mean radiance, in a table of their own.
    """
    for name in names:
        if not is_relative(name):  # it is not an error of radiance
            yield name, facts_of(job, name)


# By the last part of a group's name: the name in the header, in the order of columns.
_BAND_NAMES = {"grazing view": "θ_o>60°", "grazing light": "θ_i>60°"}
_BAND_NAMES |= {name: name for name in ("inside hull", "outside hull", "new view", "new light", "both new")}
