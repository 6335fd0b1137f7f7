"""Quality over cost: curves over bytes, rungs within budgets of time, and the choices of `trade.json`.

And the plots that the page also draws, as pictures: rate, speed, fits and level of detail.

A *surface* is a material of the run. A *line* is a codec, or a codec as published. A *rung* is one setting of it, such
as `components=8`, that was measured; within a *budget* (of bits a texel, or of the time of a query) validation pairs
choose one rung of a line for each surface, and its PSNR at test pairs is drawn. The *curve* of a line on a surface
joins its best rungs over bytes. The *floor* is the time of one bilinear colour fetch. A *choice* is a codec with its
settings, execution and precision, as `neubtf-bench trade` timed it. A *goal* is a PSNR that a fit should reach soon.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from matplotlib.ticker import NullLocator

from bench.compare.choosing.budgets import BITS, EAGER, TIMES, Budgets, budgets
from bench.compare.choosing.curves import Point, hulls, mean_at
from bench.records import Run, TradeChoice, by_kind, grouped, load_trade
from reports.figures.canvas import Figure, legend, log_ticks, plots, png, style
from reports.fits import GOALS_DB
from reports.rows import MaterialRows, materials
from reports.series import Plot, plots_of
from reports.styles import Styles

FAR_DB = 8.0  # lines so far below the best at every size of a curve are left out: they would press others together
_STEPS = 8  # points of a drawn curve from one budget of bytes to the next
_SIZES = [BITS[0] * 2 ** (step / _STEPS) for step in range(_STEPS * (len(BITS) - 1) + 1)]  # bits a texel


def fronts(run: Run) -> Iterator[Figure]:
    """One figure for each kind of surface (measured, rendered, …), if a line has a curve on one of that kind."""
    result = budgets(run)
    styles = Styles(run)
    for kind, surfaces in by_kind(result.surfaces).items():
        if hulls(result, surfaces):
            with style():
                title = f"Quality over bytes and time, {kind} surfaces"
                drawing = _drawn(result, surfaces, kind, styles)
                yield Figure("", f"fronts-{kind}", title, png(drawing), drawing)


def _drawn(result: Budgets, surfaces: Sequence[str], kind: str, styles: Styles) -> Any:
    """Means over the surfaces: curves over bytes, as far as they reach on each, and rungs within budgets of time.

    `surfaces` are the names of those of one `kind`. Lines that are far below the best everywhere are left out of both
    axes. Returns the drawing.
    """
    drawing, (by_size, by_time) = plots(11.5, 5.4, count=2)
    handles: dict[str, Any] = {}  # by line: its curve, for the legend
    # By line, its mean PSNR by bits a texel; by bits, the best of all lines, 0 where none reaches.
    means = {line: _mean_curve(curves, surfaces) for line, curves in hulls(result, surfaces).items()}
    best = {bits: max(curve.get(bits, 0.0) for curve in means.values()) for bits in _SIZES}
    # The legend lists the lines in this order.
    most_first = sorted(means, key=lambda line: -max(means[line].values(), default=0.0))
    for line in most_first:
        curve = means[line]
        is_near = any(value > best[bits] - FAR_DB for bits, value in curve.items())
        if not is_near:
            continue
        look = _look(styles, line)
        marked = [place for place, bits in enumerate(curve) if bits in BITS]  # the budgets, among the points of a curve
        (handles[line],) = by_size.plot(curve.keys(), curve.values(), **look, markersize=5, markevery=marked)
    # By the time of a budget: the mean PSNR of each line that has a rung within it on every surface.
    ranked = {budget.most: result.ranked(budget, surfaces) for budget in result.limits if budget.kind == EAGER}
    for line in handles:
        by_limit = {most: lines[line] for most, lines in ranked.items() if line in lines}
        look = _look(styles, line)
        by_time.plot(by_limit.keys(), by_limit.values(), **look, markersize=5)
    labels = {by_size: (BITS, "bits of the file a texel"), by_time: (TIMES, "budget: time of a query, × floor")}
    for axes, (ticks, label) in labels.items():
        axes.set_xscale("log", base=2)
        axes.set_xticks(ticks, list(map(str, ticks)))
        axes.set(xlabel=label, xlim=(ticks[0] * 0.8, ticks[-1] * 1.25))  # with a margin, on a logarithmic axis
    by_size.set_ylabel("test PSNR, dB (higher is better)")
    by_size.set_title(f"{kind} surfaces: {', '.join(surfaces)}; within {FAR_DB:g} dB of the best", loc="left")
    legend(by_time, list(handles.values()), list(handles))
    return drawing


def _look(styles: Styles, line: str) -> dict[str, Any]:
    """How a line of budgets, "codec" or "codec, as published", is drawn: as its codec, and not dashed.

    These are arguments of Matplotlib's `plot`.
    """
    codec = line.partition(",")[0]
    return styles.of_codec(codec) | {"linestyle": "-", "linewidth": 1.2}


def _mean_curve(curves: Mapping[str, Sequence[Point]], surfaces: Sequence[str]) -> dict[float, float]:
    """The mean PSNR in dB over surfaces of a line's curves by bits a texel, for those of `_SIZES` that each reaches.

    `curves` has the points of the line's curve by surface.
    """
    mean_of = {}
    for bits in _SIZES:
        mean = mean_at(curves, surfaces, bits)
        if mean is not None:
            mean_of[bits] = mean
    return mean_of


def trade_fronts(run: Run) -> Iterator[Figure]:
    """One figure for each material whose choices were measured, from the file `trade.json` of the run's folder."""
    trade = load_trade(run.folder)
    choices = trade["choices"] if trade else []  # most runs have no trade
    for material in dict.fromkeys(row["material"] for row in choices):
        # A choice without a PSNR, such as the floor, has no place on the axis of quality; one that failed has no time.
        rows = []
        for row in choices:
            if row["material"] == material and "error" not in row and row.get("psnr") is not None:
                rows.append(row)
        if rows:
            with style():
                drawing = _fronts(material, rows, Styles(run))
                yield Figure(material, "trade", f"{material}: speed, accuracy and bytes", png(drawing), drawing)


def _fronts(material: str, rows: Sequence[TradeChoice], styles: Styles) -> Any:
    """PSNR over time and over bytes, a mark a choice. White marks are of another execution or precision than usual.

    `rows` are the choices on one material. Returns the drawing.
    """
    groups = grouped(rows, lambda row: row["codec"] + _how(row))  # choices by the words of the legend
    height = max(5.0, 1.4 + 0.2 * len(groups))  # inches; the legend has a line for each group
    drawing, (speed, rate) = plots(11.5, height, count=2)
    handles = []
    for name, group in groups.items():
        is_default = not _how(group[0])  # all of a group have one execution and precision
        look = styles.of_codec(name) | {"linestyle": "none"}
        if not is_default:
            look["markerfacecolor"] = "white"
        psnr = [row["psnr"] for row in group]
        handles += speed.plot([row["ns_per_sample"] for row in group], psnr, **look, markersize=6)
        if is_default:  # executions do not change bytes
            rate.plot([row["bytes"] for row in group], psnr, **look, markersize=6)
    # The choices on each front, as the trade found them: no other is as good in less time, or in fewer bytes.
    fastest = [(row["ns_per_sample"], row["psnr"]) for row in rows if row["fastest"]]
    smallest = [(row["bytes"], row["psnr"]) for row in rows if row["smallest"]]
    _front(speed, fastest, "ns a sample (less is better)", "")
    _front(rate, smallest, "size of the file (less is better)", "B")
    speed.set_ylabel("display PSNR, dB (held-out pairs; higher is better)")
    speed.set_title(f"{material}: speed and accuracy", loc="left")
    rate.set_title("rate and accuracy; grey: no other is as good for less", loc="left")
    legend(rate, handles, list(groups))
    return drawing


def _how(row: TradeChoice) -> str:
    """The execution and precision of a row in words, "" for the default ones."""
    how = row["execution"], row["precision"]
    return "" if how == ("eager", "float32") else f" [{' '.join(how)}]"


def _front(axes: Any, best: Sequence[tuple[float, float | None]], label: str, unit: str) -> None:
    """Draw a front, points of cost and PSNR, as a stair, and label the axis of its cost, whose unit is `unit` or "".

    A step stays level to the next point, because more cost buys nothing until there.
    """
    stair = sorted(best)
    axes.plot([x for x, _ in stair], [y for _, y in stair], color="0.4", linewidth=1, drawstyle="steps-post", zorder=0)
    axes.set_xscale("log")
    log_ticks(axes.xaxis, unit)
    axes.set_xlabel(label)
    axes.margins(0.08)


def plot_figures(run: Run, kind: str) -> Iterator[Figure]:
    """A figure for each material that has a plot of this kind: "rate", "speed", "fits" or "footprints".

    Plots of means over materials, which the page also has, are left out.
    """
    styles = Styles(run)
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
    low, high = axes.get_ylim()
    if is_of_fits:
        for goal in GOALS_DB:
            if low < goal < high:  # a goal elsewhere would stretch the axis
                axes.axhline(goal, color="0.6", linewidth=0.8, zorder=0)
    marks = plot["x"].get("ticks")
    if marks:  # footprints, which double from one to the next
        axes.set_xscale("log", base=2)
        axes.set_xticks(marks, list(map(str, marks)))
        axes.xaxis.set_minor_locator(NullLocator())
    else:
        axes.set_xscale("log")
        log_ticks(axes.xaxis, "B" if plot["x"]["unit"] == "B" else "")
    xlabel = plot["x"]["label"]
    if not marks:  # without marks, x is a cost
        xlabel += " (less is better)"
    axes.set(xlabel=xlabel, ylabel=plot["y"]["label"].replace("pairs)", "pairs; higher is better)"))
    axes.set_title(title if is_of_fits else f"{title}\n{material.split_in_words}", loc="left")
    absent = [codec.label for codec in material.codecs if codec.exact and codec.measured]
    if absent and not is_of_fits:
        drawing.supxlabel("not drawn, because they have no error: " + ", ".join(absent), fontsize=8)
    legend(axes, handles, list(curves))
    return Figure(material.name, plot["kind"], title, png(drawing), drawing)
