"""The columns of tables by material: each finds its number in a record, and writes one seed or several."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from statistics import fmean, stdev
from typing import Any, cast

from bench.metrics import PERIODIC, in_decibels, is_relative, label_of, metric_of
from bench.records import (
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
    """The mean of each element of several tuples, such as (mean, deviation over slices)."""
    return tuple(map(fmean, zip(*several, strict=True)))


def hull(several: Sequence[tuple[float, ...]]) -> tuple[float, ...]:
    """The interval that contains all of them."""
    return min(low for low, _ in several), max(high for _, high in several)


@dataclass(frozen=True)
class Column:
    """A column: its name, its unit with an arrow to the better end, and its number for a measured row.

    `value` finds the number and `write` formats it. If it is a tuple, `pool` combines those of several seeds into one.
    `native` finds that of the measured data's own file, given its rank, bytes and bits. A `sparse` column is left out
    if no row has a number for it. A `starred` number has a star, and is never the best.
    """

    name: str
    unit: str
    value: Callable[[Row], Value]
    write: Callable[[Any], str]
    native: Callable[[Mapping[str, Any]], Value] | None = None
    sparse: bool = False
    pool: Callable[[Sequence[tuple[float, ...]]], tuple[float, ...]] = elementwise
    starred: Callable[[Row], bool] = lambda row: False  # whether its number was measured apart from those of other rows
    deviation: bool = True  # whether to show the deviation over seeds beside their mean
    whole_only: bool = False  # whether it says nothing about a scene, so that models of a scene are not marked in it
    over: str = "seeds"  # what the deviation of a cell is over, which its header says

    def cell(self, seeds: Sequence[Row]) -> str:
        """The text of one codec's cell: the number if its seeds agree, else mean ± std over them."""
        return f"{self._text(seeds)}{self.star(seeds)}"

    def star(self, seeds: Sequence[Row]) -> str:
        """A star if a number of these seeds is starred."""
        return "*" if any(self.starred(row) and self.value(row) is not None for row in seeds) else ""

    def _text(self, seeds: Sequence[Row]) -> str:
        values = [self.value(row) for row in seeds]
        texts = [NONE if value is None else value if isinstance(value, str) else self.write(value) for value in values]
        if len(set(texts)) < 2:
            return texts[0] if texts else NONE
        if together := [value for value in values if isinstance(value, tuple)]:
            return self.write(self.pool(together))
        numbers = [value for value in values if isinstance(value, int | float)]
        if not numbers:
            return texts[0]
        if len(numbers) == 1 or not self.deviation:  # a single number: other seeds are exact or were not measured
            return self.write(fmean(numbers))
        return f"{self.write(fmean(numbers))} ± {self.write(stdev(numbers))}"

    @property
    def sign(self) -> int:
        """1 if more is better, −1 if less is, 0 if neither."""
        return 1 if "↑" in self.unit else -1 if "↓" in self.unit else 0

    def mean(self, seeds: Sequence[Row]) -> float | None:
        """The mean over seeds of the number, or of the first number of a tuple; None if there is none."""
        firsts = [value[0] if isinstance(value := self.value(row), tuple) else value for row in seeds]
        numbers = [value for value in firsts if isinstance(value, int | float)]
        return fmean(numbers) if numbers else None

    def score(self, seeds: Sequence[Row]) -> float | None:
        """How good the cell is, more is better; None if it is not a number, or if no end of the scale is better."""
        if not self.sign or not seeds or self.star(seeds):
            return None
        if all(self.value(row) == EXACT for row in seeds):
            return float("inf")
        mean = self.mean(seeds)
        return None if mean is None else self.sign * mean


def _digits(metric: str) -> int:
    return 2 if in_decibels(metric) else 3


def _scale(metric: MetricFacts) -> str:
    """The unit of a metric with an arrow to the better end."""
    unit = "" if metric["unit"] == "1" else metric["unit"]
    return f"{unit} {'↑' if metric['direction'] == 'higher' else '↓'}".strip()


def _mean(name: str, scale: str, family: str, group: str = "", digits: int = 2, of: str = "mean") -> Column:
    """The mean over the slices of a group, by default those that decide, or another number of them."""
    write = partial(fixed, digits=digits)
    return Column(name, scale, lambda row: stated(row.stats(group or row.deciding_group, family), of), write)


def _spread(name: str, scale: str, family: str, digits: int = 2) -> Column:
    """Mean ± std over the slices that decide."""
    write = partial(plus_minus, digits=digits)
    return Column(
        name, scale, lambda row: stated(row.stats(row.deciding_group, family), "mean", "std"), write, over="slices"
    )


def bits(job: Job, size: int) -> float:
    """The bits a texel of so many bytes."""
    height, width = job["shape"]
    return 8 * size / (height * width)


def _timed(name: str, unit: str, field: str, write: Callable[..., str] = significant) -> Column:
    """A number of the timing; starred if it was timed in another start than the other rows."""

    def value(row: Row) -> Value:
        if row.timing is None:
            return None
        measured = dict(row.timing)[field]
        number = tuple(measured) if isinstance(measured, list) else cast(float, measured)
        return number if row.timed_apart or not row.timing_obstacle else NOT_COMPARABLE

    return Column(name, unit, value, write, pool=hull, starred=lambda row: row.timed_apart)


def _whole(value: float) -> str:
    return integer(round(value))


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
_WORST = replace(
    _mean("worst tenth", "dB ↑", PSNR),
    value=lambda row: stated(stats, "worst") if "worst" in (stats := row.stats(row.deciding_group, PSNR)) else None,
)
_POOLED = _mean("PSNR pooled", "dB ↑", PSNR, of="pooled")
RELATIVE_ERROR = Column(
    "RMSE",
    "% mean ↓",
    lambda row: None if (share := row.stats(row.deciding_group, RMSE).get("relative")) is None else 100 * share,
    partial(fixed, digits=1),
)
_NS = _timed("time", "ns ↓", "ns_per_sample")
_FLOOR = _timed("time", "× floor", "ratio_to_floor")
_FUSED = Column(
    "fused", "× floor", lambda row: row.fused["ratio_to_floor"] if row.fused else None, significant, sparse=True
)
_INTERVAL = _timed("95 % interval", "ns", "interval95_ns", lambda both: " to ".join(map(significant, both)))

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


def _declared() -> list[Column]:
    """The columns that fields of a record declare; see `bench.records.shown_columns`."""
    return [
        Column(name, unit, partial(_field, field), partial(significant, digits=digits) if digits else _whole)
        for field, (name, unit, digits) in shown_columns().items()
    ]


def _field(name: str, row: Row) -> Value:
    return cast(Value, dict(row.job).get(name))


def time() -> list[Column]:
    """The columns that fields declare, such as the seconds of a fit, and those of the time of a query."""
    return [*_declared(), _NS, _INTERVAL, _FLOOR, _FUSED]


def scored(material: MaterialRows) -> list[Column]:
    """Columns of a file that was scored alone, without a record of its fit."""
    size = [_PARAMETERS, _CHANNELS, TOTAL, BITS] if all(row.job["bytes"] for row in material.measured) else []
    return [*size, replace(_TRAIN, name="train"), HELDOUT, *_others(material, _mean)]


def short(material: MaterialRows) -> list[Column]:
    """Columns that fit a terminal."""
    return means([*scored(material), *_declared(), _NS, _FLOOR, _FUSED], HELDOUT)


def means(chosen: Sequence[Column], *whole: Column) -> list[Column]:
    """The same columns, without the deviation over seeds except for `whole`, because a terminal is narrow."""
    return [column if column in whole else replace(column, deviation=False) for column in chosen]


def quality(material: MaterialRows) -> list[Column]:
    """PSNR of training and of held-out pairs, and every other metric."""
    several = len(material.seeds) > 1  # a row has one kind of deviation: that over seeds, if there are several
    deciding, make = (HELDOUT, _mean) if several else (PER_SLICE, _spread)
    return [_TRAIN, deciding, _WORST, _POOLED, *_others(material, make)]


def main(material: MaterialRows) -> list[Column]:
    """Columns of cost, quality and time of a codec."""
    return [*SIZE, *quality(material), *time()]


def papers(material: MaterialRows) -> list[Column]:
    """Every metric as papers report it: mean ± std over slices."""
    return [PER_SLICE, *_others(material)]


def summary(materials: Sequence[MaterialRows]) -> list[Column]:
    """Columns of a summary over materials besides PSNR: every other metric, size, time."""
    metrics = {label_of(name): (name, each) for material in materials for name, each in material.metrics.items()}
    quality = [
        _mean(label, _scale(each), name.removesuffix(PERIODIC), digits=_digits(name))
        for label, (name, each) in metrics.items()
        if name != PSNR and not is_relative(name)
    ]
    times = [_FLOOR, _FUSED] if any(row.fused for each in materials for row in each.measured) else [_FLOOR]
    return [*quality, TOTAL, *(replace(time, unit="× floor ↓") for time in times)]


def _others(material: MaterialRows, make: Callable[..., Column] = _spread) -> Iterator[Column]:
    """A column for each metric but PSNR, and the errors of radiance, which have their own table."""
    for name, metric in material.metrics.items():
        if name != PSNR and not is_relative(name):
            yield make(label_of(name), _scale(metric), family=name, digits=_digits(name))


def bands(job: Job) -> list[Column]:
    """PSNR over each band of the pairs that decide."""
    return [_mean(name, f"dB ↑ ({count:,})", PSNR, group) for name, group, count in _bands(job)]


def radiance_bands(job: Job) -> list[Column]:
    """The error of linear radiance over each band, absolute and relative."""

    def value(group: str, row: Row) -> Value:
        stats = row.stats(group, RMSE)
        absolute, relative = stats.get("pooled"), stats.get("relative")
        return None if absolute is None else (absolute,) if relative is None else (absolute, 100 * relative)

    def write(numbers: tuple[float, ...]) -> str:
        return f"{significant(numbers[0])} ({f'{numbers[1]:,.1f}' if len(numbers) > 1 else NONE} %)"

    units = ((name, f"radiance ↓ ({count:,})", group) for name, group, count in _bands(job))
    return [Column(name, unit, partial(value, group), write) for name, unit, group in units]


def footprints(job: Job) -> list[Column]:
    """PSNR at each footprint."""

    def value(side: str, row: Row) -> Value:
        return stated(row.job["footprints"].get(side, {}), "mean")

    sides = ((side, f"{side} texel{'s' * (side != '1')}") for side in job["footprints"])
    return [Column(name, "dB ↑", partial(value, side), partial(fixed, digits=2)) for side, name in sides]


def _bands(job: Job) -> list[tuple[str, str, int]]:
    """(name, group, slices) of the pairs that decide and their subsets, without subsets of subsets."""
    decides = deciding_group(job["scores"])
    groups = [("held out" if decides == "heldout" else "all", decides)]
    for group in job["scores"]:
        prefix, _, band = group.partition(", ")
        if prefix == decides and band and ", " not in band:
            groups.append((_BAND_NAMES.get(band, band), group))
    order = list(_BAND_NAMES.values())
    groups[1:] = sorted(groups[1:], key=lambda item: order.index(item[0]) if item[0] in order else len(order))
    return [(name, group, job["scores"][group].get("slices", 0)) for name, group in groups]


def scene(job: Job) -> list[Column]:
    """Quality in the frames of a scene, over the pairs that the scene uses, and over the others."""
    if "scene" not in job:
        return []

    def value(name: str, row: Row) -> Value:
        values = row.job.get("scene", {}).get("metrics", {})
        known = metric_of(values, name)
        return None if not known else EXACT if values[known] is None else values[known]

    chosen = [TOTAL]
    if SCENE_HELDOUT in job["scores"]:
        chosen.append(_mean("held out in the scene", "dB ↑", PSNR, SCENE_HELDOUT))
    for name, metric in _not_of_radiance(job, job["scene"]["metrics"]):
        write = partial(fixed, digits=_digits(name))
        chosen.append(Column(f"frames {label_of(name)}", _scale(metric), partial(value, name), write))
    for name, metric in _not_of_radiance(job, metrics_of(job, "scene")):
        label = f"weighted {label_of(name)}"
        chosen.append(_mean(label, _scale(metric), name, "scene", _digits(name), "pooled"))
    outside = _mean("outside PSNR", "dB ↑", PSNR, OUTSIDE)
    return [*chosen, *(replace(column, whole_only=True) for column in (outside, HELDOUT))]


def _not_of_radiance(job: Job, names: Iterable[str]) -> Iterator[tuple[str, MetricFacts]]:
    return ((name, facts_of(job, name)) for name in names if not is_relative(name))


_BAND_NAMES = {"grazing view": "θ_o>60°", "grazing light": "θ_i>60°"}
_BAND_NAMES |= {name: name for name in ("inside hull", "outside hull", "new view", "new light", "both new")}
