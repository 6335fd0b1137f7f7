"""Quality against bytes, and quality against time: one mark a codec and setting, one line a ladder of rates."""

from collections.abc import Callable, Iterator
from statistics import fmean
from typing import Any

from bench.records import Run
from reports.figures.canvas import Figure, legend, log_ticks, plots, png, style
from reports.rows import MaterialRows, Row, Span, byte_span, materials, time_span
from reports.styles import Styles


def rate_distortion(run: Run) -> Iterator[Figure]:
    """Pooled display PSNR against the bytes of the file, for each material."""
    for material in materials(run):
        axis = "size of the file (smaller is better)"
        yield from _scatter(material, "rate", "rate and distortion", axis, byte_span, Styles(run))


def speed_accuracy(run: Run) -> Iterator[Figure]:
    """Pooled display PSNR against the time of a sample with its 95 % interval, for each material."""
    for material in materials(run):
        axis = "ns a sample, median and 95 % interval (less is better)"
        yield from _scatter(material, "speed", "speed and accuracy", axis, time_span, Styles(run))


def _scatter(
    material: MaterialRows, kind: str, about: str, axis: str, span: Callable[[Row], Span | None], styles: Styles
) -> Iterator[Figure]:
    curves, absent = _curves(material, span)
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
        yield Figure(material.name, kind, title, png(drawing), drawing)


Point = tuple[Span, float]  # on the x axis, and the quality


def _curves(material: MaterialRows, span: Callable[[Row], Span | None]) -> tuple[dict[str, list[Point]], list[str]]:
    """Points by ladder, and the labels of what is exact: infinitely far up."""
    curves: dict[str, list[Point]] = {}
    absent = []
    for codec in material.codecs:
        rows = [(span(row), row.psnr) for row in codec.measured]
        points = [(x, quality) for x, quality in rows if x and quality is not None]
        if codec.measured and codec.exact:
            absent.append(codec.label)
        elif points:
            curves.setdefault(codec.ladder, []).append(_mean(points))
    return curves, absent


def _mean(seeds: list[Point]) -> Point:
    """The mean over seeds; the interval holds those of all."""
    middles, lows, highs = zip(*(span for span, _ in seeds), strict=True)
    x = fmean(middles)
    return (x, min(x, *lows), max(x, *highs)), fmean(quality for _, quality in seeds)


def _draw(axes: Any, look: dict[str, Any], points: list[Point]) -> Any:
    spans, y = zip(*sorted(points), strict=True)
    x = [middle for middle, _, _ in spans]
    errors = [[middle - low for middle, low, _ in spans], [high - middle for middle, _, high in spans]]
    axes.errorbar(x, y, xerr=errors, fmt="none", ecolor=look["color"], elinewidth=1, capsize=2)
    return axes.plot(x, y, **look, markersize=6, linewidth=1, alpha=0.9)[0]
