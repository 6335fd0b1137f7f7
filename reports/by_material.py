"""The tables by material: what each codec costs, and its quality by metric, direction and footprint, and in a scene.

Each column is a `Measure`: its header, and the field of `bench.compare.frame` that has its number. A row is over the
seeds. A record has statistics of each *group* of pairs (`train`, `heldout`, `heldout, grazing view`): `mean`, `std` and
`pooled` of its slices, and `worst`, the mean of the worst tenth. The *frames* of a model of a scene are pictures of
that scene.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from math import inf, isnan, nan
from statistics import fmean, stdev
from typing import Any, NamedTuple

import pandas as pd

from bench.compare.frame import FUSED
from bench.metrics import all_exact, in_decibels, is_relative, label_of
from bench.records import (
    LOW_LIGHT,
    OUTSIDE,
    PSNR,
    RMSE,
    SCENE_HELDOUT,
    Job,
    MetricFacts,
    counted,
    grouped,
    metrics_of,
    shown_columns,
)
from reports.notes import common_notes, cost_notes, main_notes, quality_notes, scene_notes
from reports.numbers import NOT_APPLICABLE, NOT_COMPARABLE, as_read
from reports.rows import CodecRows, MaterialRows, Row, facts_of
from reports.scene_models import scene_gains, scene_quality
from reports.table import Apart, Spread, Table
from reports.values import WHY, Column, written

_DEVIATION = " ± {}"
_OTHER_BYTES, _PERCENT = "other bytes", "percent"  # fields that are computed here
_NAMED_BYTES = {f"bytes/{part}" for part in ("decoder", "texture", "total", "shared")}  # with columns of their own
# By the last part of a group's name: the name in the header, in the order of columns.
_BAND_NAMES = {"grazing view": "θ_o>60°", "grazing light": "θ_i>60°"}
_BAND_NAMES |= {name: name for name in ("inside hull", "outside hull", "new view", "new light", "both new")}


class OverSeeds(NamedTuple):
    """The number of a cell over seeds, infinite if all are exact; the second one in the cell; and why there is none."""

    value: float  # NaN without one
    second: float = nan
    why: str = ""


class Measure(NamedTuple):
    """A column of these tables: its header, and where the record of a job has its number."""

    name: str
    unit: str  # with an arrow to the better end, if one is
    field: str
    digits: int = 0  # decimals; −n: n significant digits
    second: str = ""  # the field of a second number in the cell; without one, the deviation over seeds stands there
    pair: str = _DEVIATION  # how that stands after the first
    second_digits: int | None = None
    is_interval: bool = False  # whether the two numbers are the ends of an interval
    native: str = ""  # what the file in which the measured data came has for it: its `rank` or `bytes`
    sparse: bool = False  # whether to leave the column out if no row has a number for it
    timed: bool = False  # whether it is a time, which gets a star and no mark if it was measured apart from the others
    stated: bool = False  # whether it is a statistic over slices, which may be exact or not applicable
    of_frames: bool = False  # whether it is a metric of frames, which may be so, too
    deviation: bool = True  # whether to show the deviation over seeds
    whole_only: bool = False  # whether it says nothing about a scene, so that models of a scene are not marked in it

    @property
    def beside(self) -> str:
        """The column of values that has the second number of a cell."""
        return self.second or f"{self.field} ± seeds"

    @property
    def why(self) -> str:
        """The column of values that says why there is no number."""
        return WHY.format(self.field)

    def column(self, values: pd.DataFrame, unranked: str = "unranked") -> Column:
        """The column as it is written of these values; `unranked` is the column of rows that get no mark."""
        unit = self.unit
        if self.pair == _DEVIATION and values[self.beside].notna().any():
            unit = Spread(unit, "± slices" if self.second else "± seeds")
        better = next((arrow for arrow in "↑↓" if arrow in self.unit), "")
        return Column(
            self.name,
            unit,
            self.field,
            self.digits,
            better=better,
            after=("*", "timed apart") if self.timed else ("", ""),
            beside=self.beside,
            pair=self.pair,
            beside_digits=self.second_digits,
            unranked="unranked in time" if self.timed else unranked,
        )

    def over_seeds(self, records: Sequence[Mapping[str, Any]]) -> OverSeeds:
        """The numbers of a cell over the seeds of a codec; each record is as `_values_of_job` makes it."""
        measured = []
        reasons = []  # why the other records have no number
        for record in records:
            value, why = self._value_or_why(record)
            if isnan(value):
                reasons.append(why)
            else:
                measured.append((value, record))
        if not measured:
            return OverSeeds(nan, why=reasons[0] if reasons else "")
        if all(value == inf for value, _ in measured):
            return OverSeeds(inf)
        numbers = [self._counted_if_exact(record) if value == inf else value for value, record in measured]
        if self.is_interval:  # from the lowest to the highest end of the seeds' intervals
            return OverSeeds(min(numbers), max(record[self.second] for _, record in measured))
        second = self._mean_second(measured) if self.second else self._deviation_over(numbers)
        return OverSeeds(fmean(numbers), second)

    def _mean_second(self, measured: Iterable[tuple[float, Mapping[str, Any]]]) -> float:
        """The mean of the second number of records, each with its first number; NaN where none has one.

        That of an exact record is 0, because its slices do not differ.
        """
        seconds = [0.0 if value == inf else record[self.second] for value, record in measured]
        numbers = [second for second in seconds if not isnan(second)]
        return fmean(numbers) if numbers else nan

    def _deviation_over(self, numbers: Sequence[float]) -> float:
        """The deviation over seeds; NaN where the column does not show it, and where all seeds read the same."""
        differ = len({as_read(number, self.digits) for number in numbers}) > 1
        return stdev(numbers) if self.deviation and differ else nan

    def _counted_if_exact(self, record: Mapping[str, Any]) -> float:
        """What an exact record counts as in a mean: what it holds, or else the most that a slice counts, in dB."""
        return counted(None if isnan(record[self.field]) else record[self.field])

    def _value_or_why(self, record: Mapping[str, Any]) -> tuple[float, str]:
        """The number of one record, infinite if it is exact, also where lower is better; without one NaN, and a word
        that says why, or ""."""
        value = record[self.field]
        if self.timed and record["time left out"] and not isnan(value):
            return nan, NOT_COMPARABLE
        if self.of_frames:
            return self._of_frames(value, record)
        return self._of_slices(value, record) if self.stated else (value, "")

    def _of_frames(self, value: float, record: Mapping[str, Any]) -> tuple[float, str]:
        """As `_value_or_why`, of a metric of frames."""
        has_scene = isinstance(record["scene/name"], str)  # NaN without one
        if not has_scene or not isnan(value):
            return value, ""
        # A PSNR is missing where there is no error, another metric where no pixel's window lies in a frame.
        metric = self.field.rpartition("/")[2]
        return (inf, "") if in_decibels(metric) else (nan, NOT_APPLICABLE)

    def _of_slices(self, value: float, record: Mapping[str, Any]) -> tuple[float, str]:
        """As `_value_or_why`, of a statistic over slices."""
        statistics = self.field.rpartition("/")[0]
        counts = {name: record[f"{statistics}/{name}"] for name in ("exact", "slices")}  # NaN where not measured
        if all_exact(counts):
            return inf, ""
        may_be_absent = self.field.endswith("/worst")  # older records lack it
        was_measured = not isnan(counts["slices"])
        why = NOT_APPLICABLE if isnan(value) and was_measured and not may_be_absent else ""
        return value, why


_PARAMETERS = Measure("decoder", "param.", "parameters")
_CHANNELS = Measure("tex.", "chan.", "cost/texture_channels", native="rank")
_TOTAL = Measure("total", "bytes ↓", "bytes/total", native="bytes")
_BITS = Measure("bits per", "texel ↓", "bits", -4)
_SIZE = (
    _PARAMETERS,
    _CHANNELS,
    Measure("decoder", "bytes", "bytes/decoder"),
    Measure("texture", "bytes", "bytes/texture"),
    Measure("other", "bytes", _OTHER_BYTES),
    _TOTAL,
    Measure("shared", "bytes", "bytes/shared", sparse=True),
    Measure("resident", "bytes", "resident", sparse=True),
    _BITS,
)
_NS = Measure("time", "ns ↓", "timing/ns_per_sample", -3, timed=True)
_ENDS = ("timing/interval95_ns/0", "timing/interval95_ns/1")
_INTERVAL = Measure("95 % interval", "ns", _ENDS[0], -3, _ENDS[1], " to {}", is_interval=True, timed=True)
_FLOOR = Measure("time", "× floor ↓", "timing/ratio_to_floor", -3, timed=True)
_FUSED = Measure("fused", "× floor ↓", FUSED, -3, sparse=True)


def _declared() -> list[Measure]:
    """The columns that fields of a record declare, such as the seconds of a fit; see `bench.records.shown_columns`."""
    # `digits` are significant ones; 0 for an integer.
    return [Measure(name, unit, field, -digits) for field, (name, unit, digits) in shown_columns().items()]


def _times() -> list[Measure]:
    """The columns that fields declare, and those of the time of a query."""
    return [*_declared(), _NS, _INTERVAL, _FLOOR, _FUSED]


def _unit_and_arrow(metric: MetricFacts) -> str:
    """The unit of a metric with an arrow to the better end: "dB ↑"; without a unit the arrow alone."""
    unit = "" if metric["unit"] == "1" else metric["unit"]  # "1": it has no unit
    arrow = "↑" if metric["direction"] == "higher" else "↓"
    return f"{unit} {arrow}".strip()


def _metric(name: str, unit: str, metric: str, group: str, statistic: str = "mean", spread: bool = False) -> Measure:
    """The column of a statistic of a metric over a group of pairs, under the header `name` and `unit`; with `spread`,
    its deviation over slices stands beside it."""
    field = f"scores/{group}/metrics/{metric}"
    second = f"{field}/std" if spread else ""
    return Measure(name, unit, f"{field}/{statistic}", _decimals(metric), second, stated=True)


def _decimals(metric: str) -> int:
    """The decimals with which a metric is shown."""
    return 2 if in_decibels(metric) else 3


def _other_metrics(material: MaterialRows, spread: bool) -> list[Measure]:
    """Every metric over the pairs that decide, but for PSNR and errors of radiance, which have a table of their own."""
    group = material.deciding_group
    shown = [(name, facts) for name, facts in material.metrics.items() if name != PSNR and not is_relative(name)]
    return [_metric(label_of(name), _unit_and_arrow(facts), name, group, spread=spread) for name, facts in shown]


def _psnr(material: MaterialRows, spread: bool = False) -> Measure:
    """PSNR over the pairs that decide."""
    return _metric("PSNR", "dB ↑", PSNR, material.deciding_group, spread=spread)


def _quality(material: MaterialRows) -> list[Measure]:
    """PSNR of training pairs and of those that decide, and every other metric."""
    # All cells of a row show one kind of deviation: that over seeds, if there are several seeds, else that over slices.
    spread = len(material.seeds) == 1
    return [
        _metric("PSNR train", "dB ↑", PSNR, "train"),
        _psnr(material, spread),
        _metric("worst tenth", "dB ↑", PSNR, material.deciding_group, "worst"),
        _metric("PSNR pooled", "dB ↑", PSNR, material.deciding_group, "pooled"),
        *_other_metrics(material, spread),
    ]


def in_short(material: MaterialRows) -> list[Measure]:
    """The size of a file, its PSNR and its times, whether or not rows have them."""
    return [_TOTAL, _BITS, _psnr(material), *(measure for measure in _times() if not measure.sparse)]


def in_summary(material: MaterialRows) -> list[Measure]:
    """The columns of a summary over materials besides PSNR: every other metric, size, time."""
    return [*_other_metrics(material, spread=False), _TOTAL, _FLOOR, _FUSED]


def _main(material: MaterialRows) -> list[Measure]:
    """Size, quality and time."""
    return [*_SIZE, *_quality(material), *_times()]


def _slices(material: MaterialRows) -> list[Measure]:
    """Every metric as papers report it: mean ± std over slices."""
    return [_psnr(material, spread=True), *_other_metrics(material, spread=True)]


def _angular(material: MaterialRows) -> list[Measure]:
    """PSNR over each band of the pairs that decide, such as grazing views, with its number of slices."""
    return [_metric(name, f"dB ↑ ({count:,})", PSNR, group) for name, group, count in _bands(material)]


def _radiance(material: MaterialRows) -> list[Measure]:
    """The error of linear radiance over each band, absolute and in per cent of the mean radiance."""
    measures = []
    for name, group, count in _bands(material):
        field = f"scores/{group}/metrics/{RMSE}"
        unit = f"radiance ↓ ({count:,})"
        measures.append(Measure(name, unit, f"{field}/pooled", -3, f"{field}/{_PERCENT}", " ({} %)", 1))
    return measures


def _footprints(material: MaterialRows) -> list[Measure]:
    """PSNR by footprint, then that of answers between texels."""
    measures = []
    for side in material.measured[0].job["footprints"]:
        name = "1 texel" if side == "1" else f"{side} texels"
        measures.append(Measure(name, "dB ↑", f"footprints/{side}/mean", 2, stated=True))
    return [*measures, Measure("between texels", "dB ↑", "between/mean", 2, sparse=True)]


def _scored(material: MaterialRows) -> list[Measure]:
    """Columns of a file that was scored alone, without a record of its fit."""
    sizes: list[Measure] = []
    if all(row.job["bytes"] for row in material.measured):  # slices that another program computed come without a file
        sizes = [_PARAMETERS, _CHANNELS, _TOTAL, _BITS]
    train = _metric("train", "dB ↑", PSNR, "train")  # a shorter name, because a terminal is narrow
    return [*sizes, train, _psnr(material), *_other_metrics(material, spread=False)]


def _short(material: MaterialRows) -> list[Measure]:
    """Columns that fit into the width of a terminal, of which only PSNR shows its deviation over seeds."""
    measures = [*_scored(material), *_declared(), _NS, _FLOOR, _FUSED]
    return [measure._replace(deviation=measure.name == "PSNR") for measure in measures]


def _detail(material: MaterialRows) -> list[Measure]:
    """PSNR by direction and by footprint, and the error of radiance over the pairs that decide."""
    error = Measure("RMSE", "% mean ↓", f"scores/{material.deciding_group}/metrics/{RMSE}/{_PERCENT}", 1)
    # Without the first band, all pairs that decide, and the first footprint, one texel: the first column shows both.
    others = [*_angular(material)[1:], error, *_footprints(material)[1:]]
    return [_psnr(material, spread=True), *(measure._replace(deviation=False) for measure in others)]


class _Band(NamedTuple):
    """A group of pairs as a column: the name in the header, the group in a record, and the number of its slices."""

    name: str
    group: str
    slices: int


def _bands(material: MaterialRows) -> list[_Band]:
    """All pairs that decide; then their subsets, but no subsets of these, which would be too many columns; last the
    pairs of low light, which decide nothing, if a record has them.

    A record names a group after what it is part of: "heldout", then "heldout, grazing view".
    """
    scores = material.measured[0].job["scores"]  # all comparable rows have the same groups
    deciding = material.deciding_group
    paths = [group.split(", ") for group in scores]
    subsets = [path[1] for path in paths if path[0] == deciding and len(path) == 2]
    order = list(_BAND_NAMES)  # other subsets are last
    subsets.sort(key=lambda subset: order.index(subset) if subset in order else len(order))
    groups = {deciding: "held out" if deciding == "heldout" else "all"}  # the name in the header of each
    groups |= {f"{deciding}, {subset}": _BAND_NAMES.get(subset, subset) for subset in subsets}
    if LOW_LIGHT in scores:
        groups[LOW_LIGHT] = LOW_LIGHT
    return [_Band(name, group, scores[group].get("slices", 0)) for group, name in groups.items()]


def _scene(material: MaterialRows) -> list[Measure]:
    """Quality in the frames of a scene, over the pairs that it uses, and over the others; none without a scene.

    *Weighted* metrics are over the queries that the scene makes.
    """
    job = material.measured[0].job
    if not job.get("scene"):
        return []
    measures = [_TOTAL]
    # Pairs that are held out and that the scene uses; a scene may use none.
    if SCENE_HELDOUT in job["scores"]:
        measures.append(_metric("held out in the scene", "dB ↑", PSNR, SCENE_HELDOUT))
    for name in job["scene"]["metrics"]:
        if not is_relative(name):
            unit = _unit_and_arrow(facts_of(job, name))
            field, digits = f"scene/metrics/{name}", _decimals(name)
            measures.append(Measure(f"frames {label_of(name)}", unit, field, digits, of_frames=True))
    for name in metrics_of(job, "scene"):  # the group of the pairs that the scene uses
        if not is_relative(name):
            unit = _unit_and_arrow(facts_of(job, name))
            measures.append(_metric(f"weighted {label_of(name)}", unit, name, "scene", "pooled"))
    outside = _metric("outside PSNR", "dB ↑", PSNR, OUTSIDE)  # over the pairs that the scene does not use
    return [*measures, *(measure._replace(whole_only=True) for measure in (outside, _psnr(material)))]


def _scene_notes(material: MaterialRows) -> list[str]:
    """The notes of the table of scores in the scene; none without a scene."""
    scene = material.measured[0].job.get("scene")
    if not scene:
        return []
    count, height, width = scene["frames"]  # the number of frames, and their sides in pixels
    pictures = f"picture{'s' if count != 1 else ''}"
    return [
        *map(Apart, scene_gains(material)),
        "Held out in the scene: PSNR of held-out pairs between pairs that the scene uses, weighted by its demand. No "
        "codec saw them; frames have a reference that is interpolated between training pairs, which are seen.",
        f"Frames: the scene's {count} {pictures} of {width} × {height}, rendered from the decoded file and compared "
        "with those of the reference table, over the pixels that show the material.",
        "Weighted: slices of all pairs, weighted by how often the scene looks at them. Outside: at pairs that it never "
        "looks at. PSNR: at the held-out pairs, as in the main table.",
        *common_notes(material),
        *_seed_notes(material),
    ]


def _all_notes(
    notes_of: Callable[[MaterialRows], Sequence[str]] = common_notes, first: Sequence[str] = ()
) -> Callable[[MaterialRows], list[str]]:
    """A function that gives all notes of a table: some `first` ones, its own, then those on models of a scene and on
    seeds."""
    return lambda material: [*first, *notes_of(material), *scene_notes([material]), *_seed_notes(material)]


class _Described(NamedTuple):
    """The tables of a kind: words for their title, their columns, and their notes.

    The functions are called only for materials with a measured row.
    """

    kind: str
    about: str
    measures: Callable[[MaterialRows], Sequence[Measure]]
    notes: Callable[[MaterialRows], Sequence[str]]


_RELATIVE = "(…): relative to the mean radiance of the same pairs, because an absolute error is small in dark slices."
_BOXES = "Answers over a square of this many texels a side, compared with the box-filtered truth."
_WHERE = "dB: display PSNR by direction (and number of slices) and by footprint. RMSE: of radiance, over its mean."
_SLICES = "as papers report it, mean ± std over slices"
_TABLES = {
    "main": _Described("main", "", _main, _all_notes(main_notes)),
    # A main table for a page that is too narrow for all of its columns is two.
    "quality": _Described("main", "quality", _quality, _all_notes(quality_notes)),
    "cost": _Described("main", "size and time", lambda _: (*_SIZE, *_times()), _all_notes(cost_notes)),
    # For a terminal: a main table, one of a file without a run, and both footprints and directions.
    "short": _Described("main", "", _short, _all_notes(main_notes)),
    "scored": _Described("main", "", _scored, _all_notes(main_notes)),
    "detail": _Described("detail", "where the error lies", _detail, lambda _: [_WHERE]),
    "slices": _Described("slices", _SLICES, _slices, _all_notes(quality_notes)),
    "angular": _Described("angular", "display PSNR by direction", _angular, _all_notes()),
    "radiance": _Described("radiance", "error of radiance by direction", _radiance, _all_notes(first=[_RELATIVE])),
    "footprints": _Described("footprints", "display PSNR by footprint", _footprints, _all_notes(first=[_BOXES])),
    "scene": _Described("scene", "scores in the scene", _scene, _scene_notes),
}


def tables(materials: Iterable[MaterialRows], name: str, stale: bool = True) -> Iterator[Table]:
    """The tables that `_TABLES` describes by that name, one for each material that has numbers.

    A row a codec, the mean over its seeds, the best first; with `stale`, rows of older versions are marked.
    """
    kind, about, measures_of, notes_of = _TABLES[name]
    for material in materials:
        measures = measures_of(material) if material.measured else []
        if not measures:
            continue
        codecs = sorted(material.codecs, key=scene_quality if kind == "scene" else _whole_first, reverse=True)
        rows = [*rows_of(codecs, measures), *_in_addition(material.measured[0].job, measures)]
        values = pd.DataFrame(rows, dtype=object).drop(columns=[] if stale else "stale")
        columns = [Column("codec", "", "codec"), *_columns_with_numbers(kind, measures, values)]
        title = f"{material.name}: {about}" if about else material.name
        if kind == "scene":
            title += f" {material.measured[0].job['scene']['name']}"
        if kind != "detail":
            title += f" ({material.split_in_words})"
        yield written(kind, title, values, columns, notes_of(material), material=material.name)


def _columns_with_numbers(kind: str, measures: Sequence[Measure], values: pd.DataFrame) -> Iterator[Column]:
    """The columns of a table, without sparse ones for which no measured codec has a number."""
    for measure in measures:
        if not measure.sparse or values.loc[values["measured"], measure.field].notna().any():
            # In the table of a scene its models are ranked, but not in columns that are not about it.
            in_scene = kind == "scene" and not measure.whole_only
            yield measure.column(values, "in addition" if in_scene else "unranked")


def rows_of(codecs: Iterable[CodecRows], measures: Sequence[Measure]) -> Iterator[dict[str, Any]]:
    """The row of each codec on a material, over its seeds. Each measure gives three values: its number, the second one
    beside it, and why there is none. Without a measured seed that is `n/c` if a job is not comparable; if one failed,
    it is “failed” for the first measure alone.

    Further values: `codec`, its label; whether it is `stale`, since the installed version cannot make some shown seed
    again; is `measured`, so that it has numbers; is `unranked`; has times that were `timed apart`; or is `in addition`
    to the codecs.
    """
    for codec in codecs:
        measured = [_values_of_job(row) for row in codec.measured]
        apart = any(row.timed_apart for row in codec.measured)
        values: dict[str, Any] = {
            "codec": codec.label,
            "stale": any(row.values["stale"] for row in codec.measured or codec.rows),
            "measured": bool(measured),
            "unranked": codec.of_scene,
            "timed apart": apart,
            "unranked in time": codec.of_scene or apart,
            "in addition": False,
        }
        for measure in measures:
            values[measure.field], values[measure.beside], values[measure.why] = measure.over_seeds(measured)
        if not measured and any(row.obstacle for row in codec.rows):
            values |= {measure.why: NOT_COMPARABLE for measure in measures}
        elif not measured and any(row.job["status"] == "failed" for row in codec.rows):
            values[measures[0].why] = "failed"
        yield values


def _values_of_job(row: Row) -> Mapping[str, Any]:
    """The values of a job by column of the frame, NaN where it has none. Added here: the fields `_PERCENT` of errors
    and `_OTHER_BYTES`, and under "time left out" whether its time is not shown."""
    values = {name: value for name, value in row.values.items() if value is not None}
    relative = {name: value for name, value in values.items() if name.endswith("/relative")}
    percent = {name.removesuffix("relative") + _PERCENT: 100 * value for name, value in relative.items()}
    other_bytes = [size for name, size in values.items() if name.startswith("bytes/") and name not in _NAMED_BYTES]
    added = {_OTHER_BYTES: sum(other_bytes), "time left out": row.time_left_out}
    return defaultdict(lambda: nan, values | percent | added)


def _in_addition(job: Job, measures: Sequence[Measure]) -> Iterator[dict[str, Any]]:
    """The rows of the file in which the measured data came, and of an all-black answer, where they say something.

    The first needs a file that is a factorisation, such as a codec makes; the second has a PSNR if the material is
    badly exposed. `job` is any comparable one of the material.
    """
    empty: dict[str, Any] = {"stale": False, "measured": False, "timed apart": False}
    empty |= {"unranked": True, "unranked in time": True, "in addition": True}
    for measure in measures:
        empty |= {measure.field: nan, measure.beside: nan, measure.why: ""}
    native = job.get("provenance", {}).get("native")  # its `bytes`, its `rank`, and its `name` from some readers
    shown = [measure for measure in measures if measure.native]
    if native and shown:
        name = native.get("name", "dfmf")  # only the reader of UBO2014, whose files are of this format, gives no name
        yield empty | {"codec": f"{name} (native)"} | {measure.field: native[measure.native] for measure in shown}
    psnr = [measure.field for measure in measures if measure.name == "PSNR"]
    if "black" in job and psnr:
        yield empty | {"codec": "black"} | dict.fromkeys(psnr, job["black"])


def _whole_first(codec: CodecRows) -> tuple[bool, float]:
    """The key that sorts a table, the greatest first: whether the codec models the whole material and not a scene, then
    the mean PSNR of its seeds. A codec without any number is the last of the models of whole materials."""
    if not codec.measured:
        return True, -inf
    return not codec.of_scene, fmean(counted(row.psnr) for row in codec.measured)


def _seed_notes(material: MaterialRows) -> Iterator[str]:
    """Notes on several seeds, and on codecs that lack some."""
    seeds = material.seeds
    if len(seeds) < 2:
        return
    yield f"Seeds {', '.join(map(str, seeds))}: a number is their mean; “± seeds”: the deviation over them."
    lacking = [codec for codec in material.codecs if 0 < len(codec.measured) < len(seeds)]
    for count, codecs in grouped(lacking, lambda codec: len(codec.measured)).items():
        yield f"{count} of {len(seeds)} seeds: {', '.join(codec.label for codec in codecs)}."
