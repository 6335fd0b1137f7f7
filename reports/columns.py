"""The columns of tables by material: each finds its number in a record, and writes one seed or several."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from statistics import fmean, stdev
from typing import Any

from bench.metrics import PERIODIC, label_of
from bench.records import OUTSIDE, PSNR, RMSE, Record, gate, metric_of, metrics_of, shown_columns
from reports.numbers import EXACT, NONE, NOT_COMPARABLE, fixed, integer, mean, plus_minus, pooled, significant, spread
from reports.rows import MaterialRows, Row, described

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
    `native` fills the cell of the measured data's own file, from any record of the material. A `sparse` column is left
    out if no row has a number for it. A `starred` number has a star, and is never the best.
    """

    name: str
    unit: str
    value: Callable[[Row], Value]
    write: Callable[[Any], str]
    native: Callable[[Record], str] | None = None
    sparse: bool = False
    pool: Callable[[Sequence[tuple[float, ...]]], tuple[float, ...]] = elementwise
    starred: Callable[[Row], bool] = lambda row: False  # whether its number was measured apart from those of other rows
    deviation: bool = True  # whether to show the deviation over seeds beside their mean
    over: str = "seeds"  # what the deviation of a cell is over, which its header says

    def cell(self, seeds: Sequence[Row]) -> str:
        """The text of one codec's cell: the number if its seeds agree, else mean ± std over them."""
        return f"{self._text(seeds)}{self.star(seeds)}"

    def star(self, seeds: Sequence[Row]) -> str:
        """A star if a number of these seeds is starred."""
        return "*" if any(self.starred(row) and self.value(row) is not None for row in seeds) else ""

    def _text(self, seeds: Sequence[Row]) -> str:
        values = [self.value(row) for row in seeds]
        texts = [self._written(value) for value in values]
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
        values = [self.value(row) for row in seeds]
        firsts = [value[0] if isinstance(value, tuple) else value for value in values]
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

    def _written(self, value: Value) -> str:
        if value is None:
            return NONE
        return value if isinstance(value, str) else self.write(value)


Number = Callable[[Record], Value]  # of the statistics of a metric over some slices


def _digits(unit: str) -> int:
    return 2 if unit == "dB" else 3


def _scale(metric: Record) -> str:
    """The unit of a metric with an arrow to the better end."""
    unit = "" if metric["unit"] == "1" else metric["unit"]
    return f"{unit} {'↑' if metric['direction'] == 'higher' else '↓'}".strip()


def _mean(name: str, scale: str, family: str, group: str = "", unit: str = "dB", of: Number = mean) -> Column:
    """The mean over the slices of a group, by default those that decide, or another number of them."""

    def value(row: Row) -> Value:
        return of(row.stats(group or row.gate, family))

    return Column(name, scale, value, partial(fixed, digits=_digits(unit)))


def _spread(name: str, scale: str, family: str, unit: str = "dB") -> Column:
    """Mean ± std over the slices that decide."""
    column = _mean(name, scale, family, unit=unit, of=spread)
    return replace(column, write=partial(plus_minus, digits=_digits(unit)), over="slices")


def _worst(row: Row) -> Value:
    stats = row.stats(row.gate, PSNR)
    return mean(stats | {"mean": stats["worst"]}) if "worst" in stats else None


def _declared() -> list[Column]:
    """The columns that fields of a record declare; see `bench.records.shown_columns`."""

    def column(field: str, name: str, unit: str, digits: int) -> Column:
        write = partial(significant, digits=digits) if digits else _whole
        return Column(name, unit, lambda row: row.job.get(field), write)

    return [column(field, *heading) for field, heading in shown_columns().items()]


def _bytes(part: str) -> Callable[[Row], Value]:
    return lambda row: row.job["bytes"].get(part)


def _bits(job: Record, size: int) -> float:
    height, width = job["shape"]
    return 8 * size / (height * width)


def _native(job: Record) -> Record:
    native: Record = job["provenance"]["native"]
    return native


def _other_bytes(row: Row) -> int:
    named = {"decoder", "texture", "total", "shared"}
    return sum(size for part, size in row.job["bytes"].items() if part not in named)


def _timed(name: str, unit: str, field: str, write: Callable[..., str] = significant) -> Column:
    """A number of the timing; starred if it was timed in another start than the other rows."""

    def value(row: Row) -> Value:
        if row.timing is None:
            return None
        measured = row.timing[field]
        number: Value = tuple(measured) if isinstance(measured, list) else measured
        return number if row.timed_apart or not row.timing_obstacle else NOT_COMPARABLE

    return Column(name, unit, value, write, pool=hull, starred=lambda row: row.timed_apart)


def _whole(value: float) -> str:
    return integer(round(value))


_four = partial(significant, digits=4)
_PARAMETERS = Column("decoder", "param.", lambda row: row.job["parameters"], _whole)
_CHANNELS = Column(
    "tex.", "chan.", lambda row: row.job["cost"]["texture_channels"], _whole, lambda job: integer(_native(job)["rank"])
)
TOTAL = Column("total", "bytes ↓", _bytes("total"), _whole, lambda job: integer(_native(job)["bytes"]))
_SHARED = Column("shared", "bytes", _bytes("shared"), _whole, sparse=True)
BITS = Column(
    "bits per",
    "texel ↓",
    lambda row: _bits(row.job, row.job["bytes"]["total"]),
    _four,
    lambda job: _four(_bits(job, _native(job)["bytes"])),
)
_TRAIN = _mean("PSNR train", "dB ↑", PSNR, "train")
HELDOUT = _mean("PSNR", "dB ↑", PSNR)
PER_SLICE = _spread("PSNR", "dB ↑", PSNR)
_WORST = Column("worst tenth", "dB ↑", _worst, partial(fixed, digits=2))
_POOLED = _mean("PSNR pooled", "dB ↑", PSNR, of=pooled)
_NS = _timed("time", "ns ↓", "ns_per_sample")
_FLOOR = _timed("time", "× floor", "ratio_to_floor")
_FUSED = Column(
    "fused", "× floor", lambda row: row.fused["ratio_to_floor"] if row.fused else None, significant, sparse=True
)

SIZE = (
    _PARAMETERS,
    _CHANNELS,
    Column("decoder", "bytes", _bytes("decoder"), _whole),
    Column("texture", "bytes", _bytes("texture"), _whole),
    Column("other", "bytes", _other_bytes, _whole),
    TOTAL,
    _SHARED,
    Column("resident", "bytes", lambda row: row.job.get("resident"), _whole, sparse=True),
    BITS,
)


def time() -> list[Column]:
    """The columns that fields declare, such as the seconds of a fit, and those of the time of a query."""
    return [
        *_declared(),
        _NS,
        _timed("95 % interval", "ns", "interval95_ns", lambda both: " to ".join(map(significant, both))),
        _FLOOR,
        _FUSED,
    ]


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
        _mean(label, _scale(each), name.removesuffix(PERIODIC), unit=each["unit"])
        for label, (name, each) in metrics.items()
        if name != PSNR and each["unit"] != "radiance"
    ]
    times = [_FLOOR, _FUSED] if any(row.fused for each in materials for row in each.measured) else [_FLOOR]
    return [*quality, TOTAL, *(replace(time, unit="× floor ↓") for time in times)]


def _others(material: MaterialRows, make: Callable[..., Column] = _spread) -> Iterator[Column]:
    """A column for each metric but PSNR, and the errors of radiance, which have their own table."""
    for name, metric in material.metrics.items():
        unit = metric["unit"]
        if name != PSNR and unit != "radiance":
            yield make(label_of(name), _scale(metric), family=name, unit=unit)


def bands(job: Record) -> list[Column]:
    """PSNR over each band of the pairs that decide."""
    return [_mean(name, f"dB ↑ ({count:,})", PSNR, group) for name, group, count in _bands(job)]


def radiance_bands(job: Record) -> list[Column]:
    """The error of linear radiance over each band, absolute and relative."""
    return [_radiance(name, f"radiance ↓ ({count:,})", group) for name, group, count in _bands(job)]


def footprints(job: Record) -> list[Column]:
    """PSNR at each footprint."""
    return [_footprint(side) for side in job["footprints"]]


def _bands(job: Record) -> list[tuple[str, str, int]]:
    """(name, group, slices) of the pairs that decide and their subsets, without subsets of subsets."""
    decides = gate(job["scores"])
    groups = [("held out" if decides == "heldout" else "all", decides)]
    for group in job["scores"]:
        prefix, _, band = group.partition(", ")
        if prefix == decides and band and ", " not in band:
            groups.append((_BAND_NAMES.get(band, band), group))
    order = list(_BAND_NAMES.values())
    groups[1:] = sorted(groups[1:], key=lambda item: order.index(item[0]) if item[0] in order else len(order))
    return [(name, group, job["scores"][group].get("slices", 0)) for name, group in groups]


def scene(job: Record) -> list[Column]:
    """Quality in the frames of a scene, over the pairs that the scene uses, and over the others."""
    if "scene" not in job:
        return []
    frames = [name for name in job["scene"]["metrics"] if described(job, name)["unit"] != "radiance"]
    weighted = [name for name in metrics_of(job, "scene") if described(job, name)["unit"] != "radiance"]
    return [
        TOTAL,
        *(_frames(name, job) for name in frames),
        *(_weighted(name, job) for name in weighted),
        _mean("outside PSNR", "dB ↑", PSNR, OUTSIDE),
        HELDOUT,
    ]


def _weighted(name: str, job: Record) -> Column:
    metric = described(job, name)
    return _mean(f"weighted {label_of(name)}", _scale(metric), name, "scene", metric["unit"], pooled)


def _frames(name: str, job: Record) -> Column:
    metric = described(job, name)

    def value(row: Row) -> Value:
        values = row.job.get("scene", {}).get("metrics", {})
        known = metric_of(values, name)
        return None if not known else EXACT if values[known] is None else values[known]

    return Column(f"frames {label_of(name)}", _scale(metric), value, partial(fixed, digits=_digits(metric["unit"])))


_BAND_NAMES = {"grazing view": "θ_o>60°", "grazing light": "θ_i>60°"}
_BAND_NAMES |= {name: name for name in ("inside hull", "outside hull", "new view", "new light", "both new")}


def _radiance(name: str, unit: str, group: str) -> Column:
    def value(row: Row) -> Value:
        stats = row.stats(group, RMSE)
        absolute, relative = stats.get("pooled"), stats.get("relative")
        return None if absolute is None else (absolute,) if relative is None else (absolute, 100 * relative)

    return Column(name, unit, value, _with_relative)


def _with_relative(numbers: tuple[float, ...]) -> str:
    relative = f"{numbers[1]:,.1f}" if len(numbers) > 1 else NONE
    return f"{significant(numbers[0])} ({relative} %)"


def _footprint(side: str) -> Column:
    def value(row: Row) -> Value:
        stats = row.job["footprints"].get(side)
        return mean(stats) if stats else None

    return Column(f"{side} texel{'s' * (side != '1')}", "dB ↑", value, partial(fixed, digits=2))


def _relative_error(row: Row) -> Value:
    relative = row.stats(row.gate, RMSE).get("relative")
    return None if relative is None else 100 * relative


RELATIVE_ERROR = Column("RMSE", "% mean ↓", _relative_error, partial(fixed, digits=1))
