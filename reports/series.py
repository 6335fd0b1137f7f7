"""The data of plots, for the page and for figures: points, curves and samples by codec, as JSON can hold them."""

from collections.abc import Callable, Iterator, Sequence
from statistics import fmean
from typing import Any

import numpy as np

from bench.compare.choosing.budgets import line_of
from bench.compare.paired import decibels
from bench.inputs.errors import InputError
from bench.records import MOST_DB, Run, view
from reports.fits import FitCurve, curves_by_material
from reports.rows import CodecRows, MaterialRows, Row, materials
from reports.styles import Styles, is_own

Plot = dict[str, Any]
Series = list[dict[str, Any]]
QUALITY = "display PSNR, dB"
MOST_LINES = 24  # of a plot
_CROWDED = ("fits", "footprints", "slices")  # plots with a line or a row for each setting
_MEANS = ("rate", "speed", "cost")  # plots of which there is also one of the means over all materials
_DASHES = {"--": "6 3", ":": "2 3", "-.": "6 3 2 3"}  # lines of Matplotlib as SVG has them


def codecs(run: Run) -> Series:
    """Every codec that has a result with its colour, marker and line, in the order of the suite."""
    styles = Styles(run)
    entries = []
    for label in dict.fromkeys(codec.label for material in materials(run) for codec in material.codecs):
        look = styles.of_codec(label)
        entry = {"label": label, "colour": look["color"], "marker": look["marker"]}
        entry["hollow"] = look["markerfacecolor"] != look["color"]
        entry["dash"] = _DASHES.get(look["linestyle"], "")
        entries.append(entry)
    return entries


@view
def plots_of(run: Run) -> list[Plot]:
    """Every plot that has a point, those over all materials first."""
    curves = curves_by_material(run)
    measured = [material for material in materials(run) if material.measured]
    by_material: list[Plot] = []
    for material in measured:
        by_material += _of_material(run, material, curves.get(material.name, []))
    means = []
    if len(measured) > 1:
        means = [_mean(kind, by_material, len(measured)) for kind in _MEANS]
    return [plot for plot in (*means, *by_material) if plot["series"]]


def _of_material(run: Run, material: MaterialRows, curves: Sequence[FitCurve]) -> Iterator[Plot]:
    """The plots of a material, which show scores of the whole of it: models of a scene stand in none."""
    whole = [codec for codec in material.codecs if not codec.of_scene]
    best = whole  # the codecs in crowded plots
    words = ""
    if len(whole) > MOST_LINES:
        best = _at_their_best(whole)
        words = ", each codec at its best setting"

    def plot(kind: str, title: str, x: dict[str, Any], y: str, series: Series) -> Plot:
        """A plot as JSON can hold it. `missing` are the codecs that should be in it, but have no point."""
        drawn = {each["label"] for each in series}
        due = best if kind in _CROWDED else whole
        return {
            "material": material.name,
            "kind": kind,
            "title": title,
            "x": x,
            "y": {"label": y},
            "series": sorted(series, key=lambda each: is_own(each["label"])),  # what is drawn last is above
            "missing": [codec.label for codec in due if codec.label not in drawn],
        }

    quality = f"{QUALITY} ({material.deciding})"
    x = {"label": "bytes of the file", "log": True, "unit": "B", "less": True}
    yield plot("rate", "Rate and distortion", x, quality, _points(whole, lambda row: [row.job["bytes"]["total"]]))

    x = {"label": "ns a sample, median and 95 % interval", "log": True, "unit": "ns", "less": True}
    yield plot("speed", "Speed and accuracy", x, quality, _points(whole, _time))
    x = {"label": "seconds of the fit", "log": True, "unit": "s", "less": True}
    yield plot("cost", "Fit and accuracy", x, quality, _points(whole, _fit_seconds))

    shown = {codec.label for codec in best}
    fitted = {}
    for fit in curves:
        if fit.label in shown:
            fitted[fit.label] = [[second, psnr] for _, second, psnr in fit.points if second > 0]
    yield plot("fits", f"Quality over seconds{words}", x, f"{QUALITY} (training samples)", _lines(fitted))
    sides = {codec.label: _footprints(codec) for codec in best}
    marks = sorted({side for points in sides.values() for side, _ in points})
    x = {"label": "footprint in texels a side", "log": True, "unit": "texels", "ticks": marks}
    several = any(len(points) > 1 for points in sides.values())
    yield plot("footprints", f"Level of detail{words}", x, quality, _lines(sides) if several else [])
    spans = {codec.label: _quantiles(run, codec.measured[0]) for codec in best if codec.measured}
    x = {"label": f"{QUALITY} a slice: from the worst 5 % to the best 5 %, the middle half thick", "unit": "dB"}
    series = [{"label": label, "points": [span]} for label, span in spans.items() if span]
    yield plot("slices", f"Slices by their error{words}", x, "", series)


def _at_their_best(codecs: Sequence[CodecRows]) -> list[CodecRows]:
    """Each codec at the setting of its highest PSNR: more lines than `MOST_LINES` cannot be told apart."""
    best: dict[str, tuple[float, CodecRows]] = {}
    for codec in codecs:
        if not codec.measured:
            continue
        quality = fmean(MOST_DB if row.psnr is None else row.psnr for row in codec.measured)
        name = line_of(codec.measured[0].job)
        if name not in best or quality > best[name][0]:
            best[name] = quality, codec
    return [codec for _, codec in best.values()]


def _time(row: Row) -> list[float] | None:
    """The ns of a sample, and the low and high end of their interval; None where they must not be compared."""
    if not row.timing or (row.timing_obstacle and not row.timed_apart):
        return None
    return [row.timing["ns_per_sample"], *row.timing["interval95_ns"]]


def _fit_seconds(row: Row) -> list[float] | None:
    """The seconds of a fit in a list; None if they are not known, as for a file that was handed in."""
    seconds = row.job.get("fit_seconds")
    return [seconds] if seconds else None


def _lines(curves: dict[str, list[list[float]]]) -> Series:
    """A line for each codec with points."""
    return [{"label": label, "line": True, "points": points} for label, points in curves.items() if points]


def _points(codecs: Sequence[CodecRows], of_row: Callable[[Row], list[float] | None]) -> Series:
    """One point a codec, [x, PSNR] or [x, PSNR, low, high], means over seeds; a line joins points of the same `curve`.

    `of_row` gives [x] or [x, low, high] of a seed. The point has the lowest low and the highest high of all seeds.
    """
    series = []
    for codec in codecs:
        places = []
        qualities = []
        for row in codec.measured:
            place = of_row(row)
            if place and row.psnr is not None:
                places.append(place)
                qualities.append(row.psnr)
        if places:
            x, *ends = zip(*places, strict=True)  # from a list a seed to a tuple a number
            point = [fmean(x), fmean(qualities)]
            if ends:
                lows, highs = ends
                point += [min(lows), max(highs)]
            series.append({"label": codec.label, "curve": codec.ladder, "points": [point]})
    return series


def _footprints(codec: CodecRows) -> list[list[float]]:
    """[side in texels, mean display PSNR of slices in dB] for each footprint, a mean over seeds.

    A footprint is left out if a seed has no number for it, because it was not measured or has no error.
    """
    stats = [row.job.get("footprints", {}) for row in codec.measured]
    sides = {int(side) for each in stats for side in each if side.isdecimal()}
    points = []
    for side in sorted(sides - {0}):
        means = [each.get(str(side), {}).get("mean") for each in stats]
        known = [mean for mean in means if mean is not None]
        if len(known) == len(means):
            points.append([side, fmean(known)])
    return points


def _mean(kind: str, by_material: Sequence[Plot], count: int) -> Plot:
    """The plot of one kind over all materials: a point a codec, the mean of its points.

    `count` is the number of materials. A codec without a point on one of them is among the `missing` ones.
    """
    chosen = [plot for plot in by_material if plot["kind"] == kind]
    by_label: dict[str, Series] = {}
    for plot in chosen:
        for each in plot["series"]:
            by_label.setdefault(str(each["label"]), []).append(each)
    series = []
    for on_materials in by_label.values():
        if len(on_materials) == count:
            points = [each["points"][0] for each in on_materials]  # in these plots a codec has one point a material
            mean = [fmean(numbers) for numbers in zip(*points, strict=True)]
            series.append(on_materials[0] | {"points": [mean]})
    drawn = {each["label"] for each in series}
    labels = list(by_label)
    for plot in chosen:
        labels += plot["missing"]
    missing = [label for label in dict.fromkeys(labels) if label not in drawn]
    title = f"{chosen[0]['title']}, means over {count} materials"
    return chosen[0] | {"material": "", "title": title, "series": series, "missing": missing}


def _quantiles(run: Run, row: Row) -> list[float]:
    """The 5, 25, 50, 75 and 95 % quantiles of the PSNR of slices that decide, in dB; empty where none has an error."""
    try:
        values = decibels(run.folder, row.job)
    except InputError:  # the records of a run are useful without its large files
        return []
    if values is None:
        return []
    known = values[np.isfinite(values)]
    if not len(known):
        return []
    return np.quantile(known, (0.05, 0.25, 0.5, 0.75, 0.95)).tolist()
