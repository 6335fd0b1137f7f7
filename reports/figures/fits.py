"""PSNR over the seconds of a fit: how soon each codec is good."""

from collections.abc import Iterator
from typing import Any

from bench.records import Run
from reports.figures.canvas import Figure, legend, log_ticks, plots, png, style
from reports.fits import GOALS_DB, FitCurve, curves_by_material
from reports.styles import Styles


def fit_curves(run: Run) -> Iterator[Figure]:
    """One figure for each material whose fits left curves; the goals are the grey lines."""
    for name, curves in curves_by_material(run).items():
        with style():
            title = f"{name}: how soon a fit is good"
            drawing = _drawn(title, curves, Styles(run))
            yield Figure(name, "fits", title, png(drawing), drawing)


def _drawn(title: str, curves: list[FitCurve], styles: Styles) -> Any:
    drawing, (axes,) = plots(8.2, max(4.4, 1.6 + 0.2 * len(curves)))
    handles = []
    for fit in curves:
        _, seconds, psnr = zip(*fit.points, strict=True)
        handles += axes.plot(seconds, psnr, **styles.of_codec(fit.label), markersize=3, linewidth=1)
    low, high = axes.get_ylim()
    for goal in GOALS_DB:
        if low < goal < high:
            axes.axhline(goal, color="0.6", linewidth=0.8, zorder=0)
    axes.set_xscale("log")
    log_ticks(axes.xaxis)
    axes.set(xlabel="seconds of the fit (less is better)", ylabel="display PSNR, dB (training samples)")
    axes.set_title(title, loc="left")
    legend(axes, handles, [fit.label for fit in curves])
    return drawing
