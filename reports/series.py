"""The data of a page's interactive plots: points, curves and samples by codec, as JSON can hold them."""

from collections.abc import Callable, Iterator, Sequence
from statistics import fmean
from typing import Any

import numpy as np

from bench.compare.slices import decibels
from bench.errors import InputError
from bench.records import Run, shown_label
from reports.fits import curves_by_material
from reports.rows import MaterialRows, Row, Span, byte_span, footprint_curves, time_span
from reports.styles import Styles

Plot = dict[str, Any]
QUALITY = "display PSNR, dB"


def codecs(run: Run) -> list[dict[str, Any]]:
    """Every codec of the run with its colour, marker and line, in the order of the suite."""
    styles = Styles(run)
    entries = []
    for label in dict.fromkeys(map(shown_label, run.jobs)):
        look = styles.of_codec(label)
        hollow = look["markerfacecolor"] != look["color"]
        entries.append(
            {"label": label, "colour": look["color"], "marker": look["marker"], "hollow": hollow}
            | {"dash": {"--": "6 3", ":": "2 3", "-.": "6 3 2 3"}.get(look["linestyle"], "")}
        )
    return entries


def plots(run: Run, materials: Sequence[MaterialRows]) -> list[Plot]:
    """Every plot that has a point, those over all materials first."""
    curves = curves_by_material(run)
    by_material = [plot for each in materials for plot in _of_material(run, each, curves.get(each.name, []))]
    measured = [material for material in materials if material.measured]
    means = [_mean(kind, by_material, len(measured)) for kind in ("rate", "speed")] if len(measured) > 1 else []
    return [plot for plot in (*means, *by_material) if plot["series"]]


def _of_material(run: Run, material: MaterialRows, curves: Sequence[Any]) -> Iterator[Plot]:
    if not material.measured:
        return
    y = {"label": f"{QUALITY} ({material.deciding})"}
    bytes_axis = {"label": "bytes of the file", "log": True, "unit": "B"}
    time_axis = {"label": "ns a sample, median and 95 % interval", "log": True, "unit": "ns"}
    yield _plot(material, "rate", "Rate and distortion", bytes_axis, y, _points(material, byte_span))
    yield _plot(material, "speed", "Speed and accuracy", time_axis, y, _points(material, time_span))
    seconds = {"label": "seconds of the fit", "log": True, "unit": "s"}
    series = [
        {"label": fit.label, "line": True, "points": [[_short(s), _short(q)] for _, s, q in fit.points if s > 0]}
        for fit in curves
    ]
    yield _plot(material, "fits", "Quality over seconds", seconds, {"label": f"{QUALITY} (training samples)"}, series)
    yield _footprints(material, y)
    samples = [{"label": row.label, "samples": _slices(run, row)} for row in material.shown]
    series = [each for each in samples if each["samples"]]
    slice_axis = {"label": f"{QUALITY} a slice"}
    yield _plot(material, "slices", "Slices by their error", slice_axis, {"label": "slices"}, series)


def _plot(
    material: MaterialRows, kind: str, title: str, x: dict[str, Any], y: dict[str, Any], series: list[Any]
) -> Plot:
    missing = [codec.label for codec in material.codecs if codec.label not in {each["label"] for each in series}]
    names = {"material": material.name, "kind": kind, "title": title}
    return names | {"x": x, "y": y, "series": series, "missing": missing}


def _footprints(material: MaterialRows, y: dict[str, Any]) -> Plot:
    curves = {codec.label: footprint_curves(codec) for codec in material.codecs}
    sides = sorted({side for curve in curves.values() for side, _ in curve})
    x = {"label": "footprint in texels a side", "log": True, "unit": "texels", "ticks": sides}
    series = [
        {"label": label, "line": True, "points": [[side, _short(psnr)] for side, psnr in curve]}
        for label, curve in curves.items()
        if len(curve) > 1
    ]
    return _plot(material, "footprints", "Level of detail", x, y, series)


def _points(material: MaterialRows, span: Callable[[Row], Span | None]) -> list[dict[str, Any]]:
    """One point a codec, the mean of its seeds; `curve` joins those of a ladder of rates."""
    points = []
    for codec in material.codecs:
        seeds = [(row.psnr, span(row)) for row in codec.measured]
        known = [(quality, at) for quality, at in seeds if quality is not None and at]
        if known:
            x, low, high = (fmean(at[i] for _, at in known) for i in range(3))
            point = [_short(x), _short(fmean(quality for quality, _ in known)), _short(low), _short(high)]
            points.append({"label": codec.label, "curve": codec.ladder, "points": [point]})
    return points


def _mean(kind: str, by_material: Sequence[Plot], materials: int) -> Plot:
    """The mean over materials of each codec that has a point on all of them."""
    chosen = [plot for plot in by_material if plot["kind"] == kind]
    by_label: dict[str, list[dict[str, Any]]] = {}
    for each in (series for plot in chosen for series in plot["series"]):
        by_label.setdefault(each["label"], []).append(each)
    series = [
        all_of[0] | {"points": [[_short(fmean(each["points"][0][i] for each in all_of)) for i in range(4)]]}
        for all_of in by_label.values()
        if len(all_of) == materials
    ]
    labels = [*by_label, *(label for plot in chosen for label in plot["missing"])]
    missing = [label for label in dict.fromkeys(labels) if len(by_label.get(label, [])) != materials]
    first = chosen[0] if chosen else {"x": {}, "y": {}, "title": ""}
    return {"material": "", "kind": kind, "title": f"{first['title']}, means over {materials} materials"} | {
        "x": first["x"],
        "y": first["y"],
        "series": series,
        "missing": missing,
    }


def _slices(run: Run, row: Row) -> list[float]:
    """The PSNR of each slice that decides, to a tenth of a dB, without slices that have no error."""
    try:
        values = decibels(run.folder, row.job)
    except InputError:  # a run's records are worth reading without its bulky parts
        return []
    return [] if values is None else [round(float(value), 1) for value in values[np.isfinite(values)]]


def _short(value: float) -> float:
    return float(f"{value:.5g}")
