"""Quality over cost: curves over bytes, and rungs within budgets of time.

And the plots that the page also draws, as pictures: rate, speed, fits and level of detail.

A *goal* is a PSNR that a fit should reach soon.
"""

from collections.abc import Iterator
from textwrap import fill
from typing import Any

from matplotlib.figure import Figure as Drawing
from matplotlib.ticker import NullLocator

from bench.records import Run
from reports.figures.canvas import Figure, legend, log_ticks, plots, png, style
from reports.fits import GOALS_DB
from reports.front_plots import FAR_DB, Front, front_plots
from reports.rows import MaterialRows, materials
from reports.series import Plot, plots_of
from reports.styles import Styles

_NOTE = 115  # characters in a line of a note


def fronts(run: Run) -> Iterator[Figure]:
    """One figure for each kind of surface (measured, rendered, …), if a line has a curve on one of that kind."""
    styles = Styles(run.jobs)
    for front in front_plots(run):
        with style():
            title = f"Quality over bytes and time, {front.kind} surfaces"
            drawing = _drawn_front(front, styles)
            yield Figure("", f"fronts-{front.kind}", title, png(drawing), drawing)


def _drawn_front(front: Front, styles: Styles) -> Drawing:
    """Curves over bytes, and rungs within budgets of time, side by side."""
    drawing, panels = plots(11.5, 5.4, count=2)
    handles: dict[str, Any] = {}  # by line: its curve, for the legend
    for axes, plot in zip(panels, (front.by_size, front.by_time), strict=True):
        ticks = plot["x"]["ticks"]
        for entry in plot["series"]:
            costs, values = zip(*entry["points"], strict=True)
            marked = [place for place, cost in enumerate(costs) if cost in ticks]  # the budgets, among the points
            look = styles.of_line(entry["label"])
            (handle,) = axes.plot(costs, values, **look, linewidth=1.2, markersize=5, markevery=marked)
            handles.setdefault(entry["label"], handle)
        axes.set_xscale("log", base=2)
        axes.set_xticks(ticks, list(map(str, ticks)))
        # With a margin, on a logarithmic axis.
        axes.set(xlabel=plot["x"]["label"], xlim=(ticks[0] * 0.8, ticks[-1] * 1.25))
    by_size, by_time = panels
    by_size.set_ylabel("test PSNR, dB (higher is better)")
    surfaces = ", ".join(front.surfaces)
    by_size.set_title(f"{front.kind} surfaces: {surfaces}; within {FAR_DB:g} dB of the best", loc="left")
    legend(by_time, list(handles.values()), list(handles))
    return drawing


def plot_figures(run: Run, kind: str) -> Iterator[Figure]:
    """A figure for each material that has a plot of this kind: "rate", "speed", "fits" or "footprints".

    Plots of means over materials, which the page also has, are left out.
    """
    styles = Styles(run.jobs)
    by_name = {material.name: material for material in materials(run)}
    for plot in plots_of(run):
        if plot["kind"] == kind and plot["material"]:
            with style():
                yield _figure(plot, by_name[plot["material"]], styles)


def _figure(plot: Plot, material: MaterialRows, styles: Styles) -> Figure:
    """A plot of the page as a figure; a point is (x, PSNR), or (x, PSNR, low, high) with the interval of x.

    Plots of fits show the goals as grey lines. `reports.series` says which keys a plot has.
    """
    is_of_fits = plot["kind"] == "fits"
    # Points by the name of their line: a codec with its settings or, for several settings that one line joins, `curve`.
    curves: dict[str, list[list[float]]] = {}
    for series in plot["series"]:
        curves.setdefault(series.get("curve", series["label"]), []).extend(series["points"])
    subject = "how soon a fit is good" if is_of_fits else plot["title"].lower()
    title = f"{material.name}: {subject}"
    height = max(4.4, 1.6 + 0.2 * len(curves))  # inches; the legend has a line for each curve
    drawing, (axes,) = plots(8.2, height)
    look = {"markersize": 3} if is_of_fits else {"markersize": 6, "alpha": 0.9}
    handles = []
    for name, points in curves.items():
        x, y, *ends = zip(*sorted(points), strict=True)  # all x, all y and, if there are intervals, both their ends
        of_codec = styles.of_codec(name) | look
        if ends:
            axes.hlines(y, *ends, color=of_codec["color"], linewidth=1)
        handles += axes.plot(x, y, **of_codec, linewidth=1)
    if is_of_fits:
        _draw_goals(axes)
    _set_x_axis(axes, plot["x"])
    axes.set_ylabel(plot["y"]["label"].replace("pairs)", "pairs; higher is better)"))
    below_title = fill(plot["note"], _NOTE) if is_of_fits else material.split_in_words
    axes.set_title(f"{title}\n{below_title}".rstrip(), loc="left")
    absent = [codec.label for codec in material.codecs if codec.exact and codec.measured]
    if absent and not is_of_fits:
        drawing.supxlabel("not drawn, because they have no error: " + ", ".join(absent), fontsize=8)
    legend(axes, handles, list(curves))
    return Figure(material.name, plot["kind"], title, png(drawing), drawing)


def _draw_goals(axes: Any) -> None:
    """Draw a grey line at each goal within the y axis: one elsewhere would stretch it."""
    low, high = axes.get_ylim()
    for goal in GOALS_DB:
        if low < goal < high:
            axes.axhline(goal, color="0.6", linewidth=0.8, zorder=0)


def _set_x_axis(axes: Any, x: dict[str, Any]) -> None:
    """Set scale, ticks and label of the x axis by that of a plot: footprints, which have `ticks`, or a cost."""
    if "ticks" in x:  # footprints double from one to the next
        axes.set_xscale("log", base=2)
        axes.set_xticks(x["ticks"], list(map(str, x["ticks"])))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.set_xlabel(x["label"])
    else:
        axes.set_xscale("log")
        log_ticks(axes.xaxis, "B" if x["unit"] == "B" else "")
        axes.set_xlabel(f"{x['label']} (less is better)")
