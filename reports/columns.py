"""The columns of tables by material: name, unit, and the cell of a row."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

from bench.fields import PSNR, RMSE, gate, metric_of, metrics_of
from bench.metrics import label_of
from bench.records import Record
from reports.numbers import EXACT, NONE, NOT_COMPARABLE, fixed, integer, pooled, significant, spread
from reports.rows import NEW_RUN, Material, Row, described

OUTSIDE = "outside the scene"


@dataclass(frozen=True)
class Column:
    """A name, a unit with an arrow to the better end, and how a measured row fills it.

    `native`, where there is one, fills it for the measured data's own file, from any record of the material. A column
    that is `sparse` is left out where no row has a number for it.
    """

    name: str
    unit: str
    cell: Callable[[Row], str]
    native: Callable[[Record], str] | None = None
    sparse: bool = False


def _digits(unit: str) -> int:
    return 2 if unit == "dB" else 3


def _scale(said: Record) -> str:
    """The unit of a metric with an arrow to the better end."""
    unit = "" if said["unit"] == "1" else said["unit"]
    return f"{unit} {'↑' if said['direction'] == 'higher' else '↓'}".strip()


def _pooled(row: Row, family: str, group: str = "", unit: str = "dB") -> str:
    return pooled(row.stats(group or row.gate, family), _digits(unit))


def _spread(row: Row, family: str, unit: str = "dB") -> str:
    return spread(row.stats(row.gate, family), _digits(unit))


def _part(row: Row, part: str) -> str:
    return integer(row.job["bytes"].get(part))


def _bits(job: Record, size: int) -> str:
    height, width = job["shape"]
    return significant(8 * size / (height * width), 4)


def _native(job: Record) -> Record:
    found: Record = job["provenance"]["native"]
    return found


def _other_bytes(row: Row) -> str:
    named = {"decoder", "texture", "total", "shared"}
    return integer(sum(size for part, size in row.job["bytes"].items() if part not in named))


def _seconds(row: Row) -> str:
    return significant(row.job.get("fit_seconds"), 2)


def _nanoseconds(row: Row) -> str:
    return _timed(row, lambda timing: significant(timing["ns_per_sample"]))


def _interval(row: Row) -> str:
    return _timed(row, lambda timing: " to ".join(map(significant, timing["interval95_ns"])))


def _ratio(row: Row) -> str:
    return _timed(row, lambda timing: significant(timing["ratio_to_floor"]))


def _timed(row: Row, cell: Callable[[Record], str]) -> str:
    if row.timing is None:
        return NONE
    if row.timing_obstacle == NEW_RUN:
        return f"{cell(row.timing)}*"
    return NOT_COMPARABLE if row.timing_obstacle else cell(row.timing)


_PARAMETERS = Column("decoder", "param.", lambda row: integer(row.job["parameters"]))
_CHANNELS = Column(
    "tex.",
    "chan.",
    lambda row: integer(row.job["cost"]["texture_channels"]),
    lambda job: integer(_native(job)["rank"]),
)
_TOTAL = Column("total", "bytes ↓", partial(_part, part="total"), lambda job: integer(_native(job)["bytes"]))
_SHARED = Column("shared", "bytes", partial(_part, part="shared"), sparse=True)
_BITS = Column(
    "bits per",
    "texel ↓",
    lambda row: _bits(row.job, row.job["bytes"]["total"]),
    lambda job: _bits(job, _native(job)["bytes"]),
)
_TRAIN = Column("PSNR train", "dB ↑", partial(_pooled, family=PSNR, group="train"))
_HELDOUT = Column("PSNR", "dB ↑", partial(_pooled, family=PSNR))
RATES = (_TOTAL, _BITS, _HELDOUT)
PER_SLICE = Column("PSNR per slice", "dB ↑", partial(_spread, family=PSNR))
_FIT = Column("fit", "s", _seconds)
_NS = Column("time", "ns ↓", _nanoseconds)
_FLOOR = Column("time", "× floor", _ratio)

SIZE = (
    _PARAMETERS,
    _CHANNELS,
    Column("decoder", "bytes", partial(_part, part="decoder")),
    Column("texture", "bytes", partial(_part, part="texture")),
    Column("other", "bytes", _other_bytes),
    _TOTAL,
    _SHARED,
    _BITS,
)
TIME = (_FIT, _NS, Column("95 % interval", "ns", _interval), _FLOOR)


def scored(material: Material) -> list[Column]:
    """What is known of a file without its fit, for a terminal."""
    train = Column("train", "dB ↑", _TRAIN.cell)
    return [_PARAMETERS, _CHANNELS, _TOTAL, _BITS, train, _HELDOUT, *_others(material, _pooled)]


def short(material: Material) -> list[Column]:
    """What fits a terminal."""
    return [*scored(material), _FIT, _NS, _FLOOR]


def quality(material: Material) -> list[Column]:
    """PSNR of training and of held-out pairs, and every other metric."""
    return [_TRAIN, _HELDOUT, PER_SLICE, *_others(material)]


def main(material: Material) -> list[Column]:
    """All of a codec's cost, quality and time."""
    return [*SIZE, *quality(material), *TIME]


def _others(material: Material, cell: Callable[..., str] | None = None) -> Iterator[Column]:
    """A column for each metric but PSNR, and the errors of radiance, which have a table of their own.

    Decibels are pooled, other metrics are mean ± std over slices, unless a `cell` writes them all.
    """
    for name, said in material.metrics.items():
        unit = said["unit"]
        if name != PSNR and unit != "radiance":
            write = cell or (_pooled if unit == "dB" else _spread)
            yield Column(label_of(name), _scale(said), partial(write, family=name, unit=unit))


def bands(job: Record) -> list[Column]:
    """PSNR over each band of the pairs that decide."""
    return [Column(name, f"dB ↑ ({count:,})", partial(_pooled, family=PSNR, group=group))
            for name, group, count in _bands(job)]  # fmt: skip


def radiance_bands(job: Record) -> list[Column]:
    """The error of linear radiance over each band, absolute and relative."""
    return [Column(name, f"radiance ↓ ({count:,})", partial(_radiance, group=group))
            for name, group, count in _bands(job)]  # fmt: skip


def footprints(job: Record) -> list[Column]:
    """PSNR at each footprint."""
    return [Column(f"{side} texel{'s' * (side != '1')}", "dB ↑", partial(_footprint, side=side))
            for side in job["footprints"]]  # fmt: skip


def _bands(job: Record) -> list[tuple[str, str, int]]:
    """(name, group, slices) of the pairs that decide and their subsets, without subsets of subsets."""
    decides = gate(job["scores"])
    found = [("held out" if decides == "heldout" else "all", decides)]
    for group in job["scores"]:
        prefix, _, band = group.partition(", ")
        if prefix == decides and band and ", " not in band:
            found.append((_BAND_NAMES.get(band, band), group))
    order = list(_BAND_NAMES.values())
    found[1:] = sorted(found[1:], key=lambda item: order.index(item[0]) if item[0] in order else len(order))
    return [(name, group, job["scores"][group]["slices"]) for name, group in found]


def scene(job: Record) -> list[Column]:
    """How a material does in the frames of a scene, over the pairs it looks between, and over those it does not."""
    if "scene" not in job:
        return []
    frames = [name for name in job["scene"]["metrics"] if described(job, name)["unit"] != "radiance"]
    weighted = [name for name in metrics_of(job, "scene") if described(job, name)["unit"] != "radiance"]
    return [
        _TOTAL,
        *(_of_scene("frames", _frames, name, job) for name in frames),
        *(_of_scene("weighted", partial(_pooled, group="scene"), name, job) for name in weighted),
        Column("outside PSNR", "dB ↑", partial(_pooled, family=PSNR, group=OUTSIDE)),
        _HELDOUT,
    ]


def _of_scene(where: str, cell: Callable[..., str], name: str, job: Record) -> Column:
    said = described(job, name)
    return Column(f"{where} {label_of(name)}", _scale(said), partial(cell, family=name, unit=said["unit"]))


def _frames(row: Row, family: str, unit: str) -> str:
    found = row.job.get("scene", {}).get("metrics", {})
    name = metric_of(found, family)
    if not name:
        return NONE
    return EXACT if found[name] is None else fixed(found[name], _digits(unit))


_BAND_NAMES = {
    "grazing view": "θ_o>60°",
    "grazing light": "θ_i>60°",
    "inside hull": "inside hull",
    "outside hull": "outside hull",
    "new view": "new view",
    "new light": "new light",
    "both new": "both new",
}


def _radiance(row: Row, group: str) -> str:
    stats = row.stats(group, RMSE)
    if not stats or stats["pooled"] is None:
        return NONE
    return f"{significant(stats['pooled'])} ({_relative(row, group)} %)"


def _relative(row: Row, group: str) -> str:
    relative = row.stats(group, RMSE).get("relative")
    return NONE if relative is None else fixed(100 * relative, 1)


def _footprint(row: Row, side: str) -> str:
    found = row.job["footprints"].get(side)
    return pooled({"pooled": found[PSNR]} | found, 2) if found else NONE


RELATIVE_ERROR = Column("RMSE", "% mean ↓", lambda row: _relative(row, row.gate))
