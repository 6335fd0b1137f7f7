"""The plots that the page also draws, as pictures: rate, speed, fits and level of detail."""

from collections.abc import Iterator

from matplotlib.ticker import NullLocator

from bench.records import Run
from reports.figures.canvas import Figure, legend, log_ticks, plots, png, style
from reports.fits import GOALS_DB
from reports.rows import MaterialRows, materials
from reports.series import Plot, plots_of
from reports.styles import Styles


def plot_figures(run: Run, kind: str) -> Iterator[Figure]:
    """One kind of plot for each material; plots of fits show the goals as grey lines."""
    styles, by_name = Styles(run), {material.name: material for material in materials(run)}
    for plot in plots_of(run):
        if plot["kind"] == kind and plot["material"]:
            with style():
                yield _figure(plot, by_name[plot["material"]], styles)


def _figure(plot: Plot, material: MaterialRows, styles: Styles) -> Figure:
    fits, curves = plot["kind"] == "fits", dict[str, list[list[float]]]()
    for series in plot["series"]:  # of each codec, or of a whole ladder of rates
        curves.setdefault(series.get("curve", series["label"]), []).extend(series["points"])
    title = f"{material.name}: {'how soon a fit is good' if fits else plot['title'].lower()}"
    drawing, (axes,) = plots(8.2, max(4.4, 1.6 + 0.2 * len(curves)))
    look = {"markersize": 3} if fits else {"markersize": 6, "alpha": 0.9}
    handles = []
    for name, points in curves.items():
        x, y, *ends = zip(*sorted(points), strict=True)
        drawn = styles.of_codec(name) | look
        if ends:
            axes.hlines(y, *ends, color=drawn["color"], linewidth=1)
        handles += axes.plot(x, y, **drawn, linewidth=1)
    low, high = axes.get_ylim()
    for goal in GOALS_DB if fits else ():
        if low < goal < high:
            axes.axhline(goal, color="0.6", linewidth=0.8, zorder=0)
    if marks := plot["x"].get("ticks"):
        axes.set_xscale("log", base=2)
        axes.set_xticks(marks, list(map(str, marks)))
        axes.xaxis.set_minor_locator(NullLocator())
    else:
        axes.set_xscale("log")
        log_ticks(axes.xaxis, "B" if plot["x"]["unit"] == "B" else "")
    xlabel = plot["x"]["label"] + ("" if marks else " (less is better)")
    axes.set(xlabel=xlabel, ylabel=plot["y"]["label"].replace("pairs)", "pairs; higher is better)"))
    axes.set_title(title if fits else f"{title}\n{material.split}", loc="left")
    if absent := [] if fits else [codec.label for codec in material.codecs if codec.exact and codec.measured]:
        drawing.supxlabel("not drawn, because they have no error: " + ", ".join(absent), fontsize=8)
    legend(axes, handles, list(curves))
    return Figure(material.name, plot["kind"], title, png(drawing), drawing)
