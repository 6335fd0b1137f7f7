"""The data of plots, for the page and for figures: points, curves and samples by codec, as JSON can hold them."""

from collections.abc import Callable, Iterator, Sequence
from statistics import fmean
from typing import Any

import numpy as np

from bench.compare.paired import decibels
from bench.inputs.errors import InputError
from bench.records import Run, grouped, view
from reports.fits import FitCurve, curves_by_material
from reports.rows import CodecRows, MaterialRows, Row, materials
from reports.styles import Styles, is_own

Plot = dict[str, Any]
Series = list[dict[str, Any]]
QUALITY = "display PSNR, dB"
_MEANS = ("rate", "speed", "cost")  # of which there is a plot over all materials


def codecs(run: Run) -> Series:
    """Every codec that has a result with its colour, marker and line, in the order of the suite."""
    styles, entries = Styles(run), []
    for label in dict.fromkeys(codec.label for material in materials(run) for codec in material.codecs):
        look = styles.of_codec(label)
        entry = {"label": label, "colour": look["color"], "marker": look["marker"]}
        entry["hollow"] = look["markerfacecolor"] != look["color"]
        entries.append(entry | {"dash": {"--": "6 3", ":": "2 3", "-.": "6 3 2 3"}.get(look["linestyle"], "")})
    return entries


@view
def plots_of(run: Run) -> list[Plot]:
    """Every plot that has a point, those over all materials first."""
    curves = curves_by_material(run)
    measured = [material for material in materials(run) if material.measured]
    by_material = [plot for each in measured for plot in _of_material(run, each, curves.get(each.name, []))]
    means = [_mean(kind, by_material, len(measured)) for kind in _MEANS] if len(measured) > 1 else []
    return [plot for plot in (*means, *by_material) if plot["series"]]


def _of_material(run: Run, material: MaterialRows, curves: Sequence[FitCurve]) -> Iterator[Plot]:
    """The plots of a material, which show scores of the whole of it: models of a scene stand in none."""
    whole = [codec for codec in material.codecs if not codec.of_scene]

    def plot(kind: str, title: str, x: dict[str, Any], y: str, series: Series) -> Plot:
        missing = [codec.label for codec in whole if codec.label not in {each["label"] for each in series}]
        names = {"material": material.name, "kind": kind, "title": title}
        above = sorted(series, key=lambda each: is_own(each["label"]))  # drawn last, so above
        return names | {"x": x, "y": {"label": y}, "series": above, "missing": missing}

    quality = f"{QUALITY} ({material.deciding})"
    x = {"label": "bytes of the file", "log": True, "unit": "B", "less": True}
    yield plot("rate", "Rate and distortion", x, quality, _points(whole, lambda row: [row.job["bytes"]["total"]]))

    def time(row: Row) -> list[float] | None:
        timed = row.timing and (row.timed_apart or not row.timing_obstacle)
        return [row.timing["ns_per_sample"], *row.timing["interval95_ns"]] if row.timing and timed else None

    x = {"label": "ns a sample, median and 95 % interval", "log": True, "unit": "ns", "less": True}
    yield plot("speed", "Speed and accuracy", x, quality, _points(whole, time))
    x = {"label": "seconds of the fit", "log": True, "unit": "s", "less": True}
    # Nobody measured the seconds of a file that was handed in.
    seconds = _points(whole, lambda row: [each] if (each := row.job.get("fit_seconds")) else None)
    yield plot("cost", "Fit and accuracy", x, quality, seconds)

    def lines(curves: dict[str, list[list[float]]]) -> Series:
        return [{"label": label, "line": True, "points": points} for label, points in curves.items() if points]

    fitted = {fit.label: [[second, psnr] for _, second, psnr in fit.points if second > 0] for fit in curves}
    yield plot("fits", "Quality over seconds", x, f"{QUALITY} (training samples)", lines(fitted))
    sides = {codec.label: _footprints(codec) for codec in whole}
    marks = sorted({side for points in sides.values() for side, _ in points})
    x = {"label": "footprint in texels a side", "log": True, "unit": "texels", "ticks": marks}
    several = any(len(points) > 1 for points in sides.values())
    yield plot("footprints", "Level of detail", x, quality, lines(sides) if several else [])
    spans = {codec.label: _quantiles(run, codec.measured[0]) for codec in whole if codec.measured}
    x = {"label": f"{QUALITY} a slice: from the worst 5 % to the best 5 %, the middle half thick", "unit": "dB"}
    series = [{"label": label, "points": [span]} for label, span in spans.items() if span]
    yield plot("slices", "Slices by their error", x, "", series)


def _points(codecs: Sequence[CodecRows], of_row: Callable[[Row], list[float] | None]) -> Series:
    """One point a codec, [x, PSNR, low, high of all seeds], a mean over seeds; `curve` joins those of a ladder."""
    series = []
    for codec in codecs:
        seeds = [(row.psnr, of_row(row)) for row in codec.measured]
        known = [(quality, at) for quality, at in seeds if quality is not None and at]
        if known:
            x, *ends = zip(*(at for _, at in known), strict=True)
            point = [fmean(x), fmean(quality for quality, _ in known)]
            point += [min(ends[0]), max(ends[1])] if ends else []
            series.append({"label": codec.label, "curve": codec.ladder, "points": [point]})
    return series


def _footprints(codec: CodecRows) -> list[list[float]]:
    """[side in texels, mean display PSNR of slices in dB], means over seeds, where every seed has an error."""
    stats = [row.job.get("footprints", {}) for row in codec.measured]
    sides = sorted({int(side) for each in stats for side in each if side.isdecimal() and int(side)})
    points = []
    for side in sides:
        means = [each.get(str(side), {}).get("mean") for each in stats]
        known = [mean for mean in means if mean is not None]
        if len(known) == len(means):
            points.append([side, fmean(known)])
    return points


def _mean(kind: str, by_material: Sequence[Plot], materials: int) -> Plot:
    """The mean over materials of each codec that has a point on all of them."""
    chosen = [plot for plot in by_material if plot["kind"] == kind]
    by_label = grouped((each for plot in chosen for each in plot["series"]), lambda each: str(each["label"]))
    series = [
        all_of[0] | {"points": [list(map(fmean, zip(*(each["points"][0] for each in all_of), strict=True)))]}
        for all_of in by_label.values()
        if len(all_of) == materials
    ]
    labels = [*by_label, *(label for plot in chosen for label in plot["missing"])]
    missing = [label for label in dict.fromkeys(labels) if len(by_label.get(label, [])) != materials]
    title = f"{chosen[0]['title']}, means over {materials} materials"
    return chosen[0] | {"material": "", "title": title, "series": series, "missing": missing}


def _quantiles(run: Run, row: Row) -> list[float]:
    """The PSNR of slices that decide at 5, 25, 50, 75 and 95 %, the best last; nothing where none has an error."""
    try:
        values = decibels(run.folder, row.job)
    except InputError:  # the records of a run are useful without its large files
        return []
    known = [] if values is None else values[np.isfinite(values)]
    return np.quantile(known, (0.05, 0.25, 0.5, 0.75, 0.95)).tolist() if len(known) else []
