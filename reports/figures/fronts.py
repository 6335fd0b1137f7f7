"""Quality within budgets: dB over bits a texel, and over the time of a query, of each codec's chosen rungs."""

from collections.abc import Iterator, Sequence
from typing import Any

from bench.compare.choosing.budgets import BITS, BYTES, EAGER, TIMES, Budgets, budgets
from bench.records import KINDS, Run, kind_of
from reports.figures.canvas import Figure, legend, plots, png, style
from reports.styles import Styles

_COSTS = {BYTES: "bits of the file a texel", EAGER: "time of a query, × floor"}


def fronts(run: Run) -> Iterator[Figure]:
    """One figure for each kind of surface, if budgets have a rung."""
    result, styles = budgets(run), Styles(run)
    for kind in KINDS:
        surfaces = [name for name, job in result.surfaces.items() if kind_of(job) == kind]
        if surfaces:
            with style():
                drawing = _drawn(result, surfaces, kind, styles)
                yield Figure("", f"fronts-{kind}", f"Quality within budgets, {kind} surfaces", png(drawing), drawing)


def _drawn(result: Budgets, surfaces: Sequence[str], kind: str, styles: Styles) -> Any:
    """The mean over the surfaces at each budget; a line ends where its codec has nothing for less."""
    drawing, panels = plots(11.5, 5.4, 2)
    handles: dict[str, Any] = {}
    for axes, (cost, label) in zip(panels, _COSTS.items(), strict=True):
        points: dict[str, list[tuple[float, float]]] = {}
        for budget in (each for each in result.picks if each.kind == cost):
            for line, value in result.ranked(budget, surfaces).items():
                points.setdefault(line, []).append((budget.most, value))
        for line, at in points.items():
            look = styles.of_codec(line.partition(",")[0]) | {"linestyle": "-", "linewidth": 1.2}
            handles.setdefault(line, axes.plot(*zip(*at, strict=True), **look, markersize=5)[0])
        ticks = BITS if cost == BYTES else TIMES
        axes.set_xscale("log", base=2)
        axes.set_xticks(ticks, list(map(str, ticks)))
        axes.set(xlabel=f"budget: {label}", xlim=(ticks[0] * 0.8, ticks[-1] * 1.25))
    panels[0].set_ylabel("test PSNR, dB (higher is better)")
    panels[0].set_title(f"{kind} surfaces: {', '.join(surfaces)}", loc="left")
    legend(panels[1], list(handles.values()), list(handles))
    return drawing
