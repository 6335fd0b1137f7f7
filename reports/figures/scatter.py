"""Quality against bytes, and quality against time: one mark a codec and setting, one line a ladder of rates."""

from collections.abc import Callable, Iterator
from statistics import fmean
from typing import Any

from bench.records import Run
from reports.figures.canvas import Figure, legend, log_ticks, plots, png, style
from reports.rows import MaterialRows, Row, materials
from reports.styles import Styles


def rate_distortion(run: Run) -> Iterator[Figure]:
    """Pooled display PSNR against the bytes of the file, for each material."""
    for material in materials(run):
        axis = "size of the file (smaller is better)"
        yield from _scatter(material, "rate", "rate and distortion", axis, _bytes, Styles(run))


def speed_accuracy(run: Run) -> Iterator[Figure]:
    """Pooled display PSNR against the time of a sample with its 95 % interval, for each material."""
    for material in materials(run):
        yield from _scatter(
            material,
            "speed",
            "speed and accuracy",
            "ns a sample, median and 95 % interval (less is better)",
            _nanoseconds,
            Styles(run),
        )


Place = tuple[float, tuple[float, float]]  # where a job stands on the x axis, and the interval about it


def _bytes(row: Row) -> Place | None:
    total = row.job["bytes"]["total"]
    return total, (total, total)


def _nanoseconds(row: Row) -> Place | None:
    if row.timing is None or row.timing_obstacle:
        return None
    low, high = row.timing["interval95_ns"]
    median = row.timing["ns_per_sample"]
    return median, (min(low, median), max(high, median))


def _scatter(
    material: MaterialRows, kind: str, about: str, axis: str, place: Callable[[Row], Place | None], styles: Styles
) -> Iterator[Figure]:
    curves, absent = _curves(material, place)
    if not curves:
        return
    title = f"{material.name}: {about}"
    with style():
        drawing, (axes,) = plots(8.2, max(4.2, 1.6 + 0.2 * len(curves)))
        handles = [_draw(axes, styles.of_codec(name), points) for name, points in curves.items()]
        axes.set_xscale("log")
        log_ticks(axes.xaxis, "B" if kind == "rate" else "")
        axes.set(xlabel=axis, ylabel=f"display PSNR, dB ({material.deciding}; higher is better)")
        axes.set_title(f"{title}\n{material.split}", loc="left")
        axes.margins(0.08)
        if absent:
            drawing.supxlabel("not drawn, without any error: " + ", ".join(absent), fontsize=8)
        legend(axes, handles, list(curves))
        yield Figure(material.name, kind, title, png(drawing))


Point = tuple[Place, float]


def _curves(material: MaterialRows, place: Callable[[Row], Place | None]) -> tuple[dict[str, list[Point]], list[str]]:
    """Points by ladder, and the labels of what is exact: infinitely far up."""
    curves: dict[str, list[Point]] = {}
    absent = []
    for codec in material.codecs:
        rows = [(row.psnr, place(row)) for row in codec.measured]
        points = [(where, quality) for quality, where in rows if quality is not None and where]
        if codec.measured and codec.exact:
            absent.append(codec.label)
        elif points:
            curves.setdefault(codec.ladder, []).append(_mean(points))
    return curves, absent


def _mean(seeds: list[Point]) -> Point:
    """The mean over seeds; the interval holds those of all."""
    lows, highs = zip(*(interval for (_, interval), _ in seeds), strict=True)
    x, y = (fmean(values) for values in zip(*((at, quality) for (at, _), quality in seeds), strict=True))
    return (x, (min(x, *lows), max(x, *highs))), y


def _draw(axes: Any, look: dict[str, Any], points: list[Point]) -> Any:
    points = sorted(points)
    x, y = [where[0] for where, _ in points], [quality for _, quality in points]
    spans = [[where[0] - where[1][0] for where, _ in points], [where[1][1] - where[0] for where, _ in points]]
    axes.errorbar(x, y, xerr=spans, fmt="none", ecolor=look["color"], elinewidth=1, capsize=2)
    return axes.plot(x, y, **look, markersize=6, linewidth=1, alpha=0.9)[0]
