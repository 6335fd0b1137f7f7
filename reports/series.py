"""The data of plots, for the page and for figures: points, curves and samples by codec, as JSON can hold them.

A plot has `material` ("" if it is over all), `kind`, `title`, its axes `x` and `y`, its `series`, the labels of
`missing` codecs and, maybe, a `note`. An axis has a `label` and may have a `unit`; `log` is true of a logarithmic one,
`less` where less is better, and `ticks` are its marks. An entry of the series is a codec with its settings: its `label`
and its `points`, lists of numbers; with `line`, a line joins them; one line joins all entries with the same `curve`.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain
from operator import itemgetter
from statistics import fmean
from typing import Any

import numpy as np

from bench.compare.choosing import has_validation, validation_of
from bench.compare.frame import line_of
from bench.compare.paired import decibels
from bench.inputs.errors import InputError
from bench.records import Run, counted, grouped, view
from reports.fits import FitCurve, curves_by_material, stages_note
from reports.rows import CodecRows, MaterialRows, Row, materials
from reports.styles import Styles, is_own

Plot = dict[str, Any]  # for its keys see above
Series = list[dict[str, Any]]  # entries, each of one codec
QUALITY = "display PSNR, dB"  # the label of an axis
MOST_LINES = 24  # of a plot: more cannot be told apart
_CROWDED = ("fits", "footprints", "slices")  # plots with a line or a row for each setting
_MEANS = ("rate", "speed", "cost")  # plots of which there is also one of the means over all materials
_DASHES = {"--": "6 3", ":": "2 3", "-.": "6 3 2 3"}  # lines of Matplotlib as SVG's `stroke-dasharray`
_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)  # of the PSNR of slices


def looks(run: Run, lines: Iterable[str] = ()) -> Series:
    """How each codec that has a result is drawn, in the order of the suite, after the `lines` of budgets, if any.

    An entry has its `label`, `colour`, `marker` (in Matplotlib's letters), whether the marker is `hollow`, and its
    `dash` ("" for a full line).
    """
    styles = Styles(run.jobs)
    look_of = {line: styles.of_line(line) for line in lines}
    for material in materials(run):
        for codec in material.codecs:
            look_of.setdefault(codec.label, styles.of_codec(codec.label))
    entries = []
    for label, look in look_of.items():
        entry = {"label": label, "colour": look["color"], "marker": look["marker"]}
        entry["hollow"] = look["markerfacecolor"] != look["color"]
        entry["dash"] = _DASHES.get(look["linestyle"], "")
        entries.append(entry)
    return entries


@view
def plots_of(run: Run) -> list[Plot]:
    """Every plot that has a point, those over all materials first. Kept with the run.

    Means over a single material would repeat its plots, so they are made of two materials or more.
    """
    curves = curves_by_material(run)
    measured = [material for material in materials(run) if material.measured]
    of_materials: list[Plot] = []
    for material in measured:
        of_materials += _plots_of_material(run, material, curves.get(material.name, []))
    of_means = []
    if len(measured) > 1:
        of_means = [_plot_of_means(kind, of_materials, len(measured)) for kind in _MEANS]
    return [plot for plot in (*of_means, *of_materials) if plot["series"]]


def _plots_of_material(run: Run, material: MaterialRows, curves: Sequence[FitCurve]) -> Iterator[Plot]:
    """A plot of each kind, some without points. They show scores of the whole material, so models of a scene stand in
    none. `curves` are the curves of the material's fits."""
    whole = [codec for codec in material.codecs if not codec.of_scene]
    is_crowded = len(whole) > MOST_LINES
    in_crowded_plots = _at_their_best(whole) if is_crowded else whole
    own = {codec.label for codec in whole if is_own(codec.codec)}
    remark = ", each codec at its best setting" if is_crowded else ""  # in the titles of crowded plots

    def plot(kind: str, title: str, x: dict[str, Any], y: str, series: Series, note: str = "") -> Plot:
        """A plot as JSON can hold it; `x` is its axis, and `y` only the label of the other axis."""
        labels_with_points = {entry["label"] for entry in series}
        expected = in_crowded_plots if kind in _CROWDED else whole
        return {
            "material": material.name,
            "kind": kind,
            "title": title,
            "x": x,
            "y": {"label": y},
            # Codecs from outside come last, because what is drawn last is above.
            "series": sorted(series, key=lambda entry: entry["label"] in own),
            "missing": [codec.label for codec in expected if codec.label not in labels_with_points],
            "note": note,
        }

    # Plots of a point a codec: quality over bytes, over the time of a query, and over the time of the fit.
    quality = f"{QUALITY} ({material.deciding_in_words})"
    size = {"label": "bytes of the file", "log": True, "unit": "B", "less": True}
    yield plot("rate", "Rate and distortion", size, quality, _points(whole, lambda row: [row.job["bytes"]["total"]]))
    time = {"label": "ns a sample, median and 95 % interval", "log": True, "unit": "ns", "less": True}
    yield plot("speed", "Speed and accuracy", time, quality, _points(whole, _time_of_query))
    fit = {"label": "seconds of the fit", "log": True, "unit": "s", "less": True}
    yield plot("cost", "Fit and accuracy", fit, quality, _points(whole, _fit_seconds))

    # The curves of fits.
    labels = {codec.label for codec in in_crowded_plots}
    drawn = [curve for curve in curves if curve.label in labels]
    quality_in_fit = f"{QUALITY} (training samples)"
    yield plot("fits", f"Quality over seconds{remark}", fit, quality_in_fit, _fit_lines(drawn), stages_note(drawn))

    # Quality over footprints. A plot of single points would show no change of quality, so it is left without points.
    by_footprint = {codec.label: _psnr_by_footprint(codec) for codec in in_crowded_plots}
    sides = sorted({side for points in by_footprint.values() for side, _ in points})  # in texels
    footprint = {"label": "footprint in texels a side", "log": True, "unit": "texels", "ticks": sides}
    lines = _lines(by_footprint) if any(len(points) > 1 for points in by_footprint.values()) else []
    yield plot("footprints", f"Level of detail{remark}", footprint, quality, lines)

    # The spread of slices, a row a codec: the y axis has no label.
    spread = {"label": f"{QUALITY} a slice: from the worst 5 % to the best 5 %, the middle half thick", "unit": "dB"}
    yield plot("slices", f"Slices by their error{remark}", spread, "", _spreads(run, in_crowded_plots))


def _at_their_best(codecs: Sequence[CodecRows]) -> list[CodecRows]:
    """Each codec at the setting of its highest PSNR, because more lines than `MOST_LINES` cannot be told apart.

    `codecs` has an item for each setting. A codec as published (`recipe=paper`) counts as another one. The PSNR is that
    of validation pairs, or of what the plots show where some setting has none of these.
    """
    rows = [row for codec in codecs for row in codec.measured]
    by_validation = all(has_validation(row.job) for row in rows)

    def psnr_of(row: Row) -> float:
        """The PSNR of a row in dB by which its setting is chosen."""
        psnr = validation_of(row.job).get("mean") if by_validation else row.psnr
        return counted(psnr)

    def quality(codec: CodecRows) -> float:
        """The mean PSNR of a setting over its seeds."""
        return fmean(map(psnr_of, codec.measured))

    measured = [codec for codec in codecs if codec.measured]
    settings_of_lines = grouped(measured, lambda codec: line_of(codec.measured[0].job))
    return [max(settings, key=quality) for settings in settings_of_lines.values()]


def _time_of_query(row: Row) -> list[float] | None:
    """[median, low, high]: the ns of a sample and the ends of their 95 % interval. None if it was not timed, or its
    time is left out; a time of another start under the same conditions is shown."""
    if not row.timing or row.time_left_out:
        return None
    return [row.timing["ns_per_sample"], *row.timing["interval95_ns"]]


def _fit_seconds(row: Row) -> list[float] | None:
    """The seconds of a fit in a list; None if they are not known, as for a file that was handed in."""
    seconds = row.job.get("fit_seconds")
    return [seconds] if seconds else None


def _fit_lines(fits: Sequence[FitCurve]) -> Series:
    """An entry with a line for each fit, its points [seconds, PSNR in dB]."""
    # The axis is logarithmic, so it has no place for 0 seconds.
    return _lines({fit.label: [[seconds, psnr] for _, seconds, psnr in fit.points if seconds > 0] for fit in fits})


def _spreads(run: Run, codecs: Sequence[CodecRows]) -> Series:
    """An entry for each codec whose first seed has the PSNR of its slices: its one point are their quantiles."""
    series = []
    for codec in codecs:
        quantiles = _quantiles(run, codec.measured[0]) if codec.measured else []
        if quantiles:
            series.append({"label": codec.label, "points": [quantiles]})
    return series


def _lines(curves: dict[str, list[list[float]]]) -> Series:
    """An entry with a line for each codec that has points; `curves` maps a label to them, each [x, PSNR in dB]."""
    return [{"label": label, "line": True, "points": points} for label, points in curves.items() if points]


def _points(codecs: Sequence[CodecRows], of_row: Callable[[Row], list[float] | None]) -> Series:
    """One point a codec, [x, PSNR] or [x, PSNR, low, high], means over seeds; a line joins points of the same `curve`.

    `of_row` gives [x] or [x, low, high] of a seed, or None if it has no number. The point has the lowest low and the
    highest high of all seeds. Seeds without a number or without an error, whose PSNR is infinite, do not count; a codec
    with no other has no point.
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
            x, *ends = zip(*places, strict=True)  # from a list for each seed to a tuple for each number
            point = [fmean(x), fmean(qualities)]
            if ends:
                lows, highs = ends
                point += [min(lows), max(highs)]
            series.append({"label": codec.label, "curve": codec.ladder, "points": [point]})
    return series


def _psnr_by_footprint(codec: CodecRows) -> list[list[float]]:
    """[side in texels, mean display PSNR of slices in dB] for each footprint, a mean over seeds.

    A footprint is left out if a seed has no number for it, because it was not measured or has no error.
    """
    stats_of_seeds = [row.job.get("footprints", {}) for row in codec.measured]  # of each seed, by side as text
    # A record may hold any text as a side.
    sides = {int(side) for stats in stats_of_seeds for side in stats if side.isdecimal()}
    points = []
    for side in sorted(sides - {0}):  # the axis is logarithmic, so it has no place for 0
        means = [stats.get(str(side), {}).get("mean") for stats in stats_of_seeds]
        numbers = [mean for mean in means if mean is not None]
        if len(numbers) == len(means):  # else the mean would be over other seeds than those of its neighbours
            points.append([side, fmean(numbers)])
    return points


def _plot_of_means(kind: str, of_materials: Sequence[Plot], count: int) -> Plot:
    """The plot of one kind over all materials, from those of each: a point a codec, the mean of its points.

    `count` is the number of materials. A codec without a point on one of them is among the `missing` ones, because its
    mean would be over fewer materials than the others'.
    """
    plots = [plot for plot in of_materials if plot["kind"] == kind]
    # For each codec, its entries in these plots.
    entries_by_label = grouped(chain.from_iterable(plot["series"] for plot in plots), itemgetter("label"))
    series = []
    for entries in entries_by_label.values():
        if len(entries) == count:
            points = [entry["points"][0] for entry in entries]  # in these plots a codec has one point a material
            mean_point = [fmean(numbers) for numbers in zip(*points, strict=True)]
            series.append(entries[0] | {"points": [mean_point]})
    labels_with_points = {entry["label"] for entry in series}
    labels = dict.fromkeys(chain(entries_by_label, *(plot["missing"] for plot in plots)))
    missing = [label for label in labels if label not in labels_with_points]
    title = f"{plots[0]['title']}, means over {count} materials"
    return plots[0] | {"material": "", "title": title, "series": series, "missing": missing}


def _quantiles(run: Run, row: Row) -> list[float]:
    """The 5, 25, 50, 75 and 95 % quantiles of the PSNR of slices that decide, in dB.

    Reads the file of slices that a run stores beside its records. Empty where it is not at hand or damaged, because the
    other plots do not need it, and where no slice has a PSNR.
    """
    try:
        psnr_of_slices = decibels(run.folder, row.job)
    except InputError:
        return []
    if psnr_of_slices is None or not len(psnr_of_slices):
        return []
    return np.quantile(psnr_of_slices, _QUANTILES).tolist()
