"""The data of plots of quality over budgets: curves over bytes, and rungs within budgets of the time of a query.

What is drawn is PSNR at test pairs; `reports.rungs` explains the terms.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import pandas as pd

from bench.records import Run
from reports.rungs import BITS, EAGER, TIMES, Rungs, median_over, rungs_of
from reports.series import Plot, Series

FAR_DB = 8.0  # lines so far below the best at every size of a curve are left out: they would press others together
_POINTS = 8  # points of a drawn curve from one budget of bytes to the next
_SIZES = [BITS[0] * 2 ** (point / _POINTS) for point in range(_POINTS * (len(BITS) - 1) + 1)]  # bits a texel

_Curves = dict[str, dict[float, float]]  # by line, PSNR in dB by cost


class Front(NamedTuple):
    """The two plots of one kind of surface, as `reports.series` describes them; both have the same lines."""

    kind: str
    surfaces: Sequence[str]
    by_size: Plot
    by_time: Plot


def front_plots(run: Run) -> Iterator[Front]:
    """The plots of each kind of surface (measured, rendered, …), if a line has a curve on one of that kind."""
    rungs = rungs_of(run)
    for kind, surfaces in rungs.kinds.items():
        if any(by_surface.keys() & set(surfaces) for by_surface in rungs.hulls.values()):
            yield _front(rungs, kind, surfaces)


def _front(rungs: Rungs, kind: str, surfaces: Sequence[str]) -> Front:
    """Medians over the surfaces: curves over bytes, as far as they reach on each, and rungs within budgets of time.

    `surfaces` are the names of those of one `kind`. Lines that are far below the best everywhere are left out of both.
    The line of the highest PSNR comes first.
    """
    curves = _near(_curves(rungs, surfaces))
    by_size = {"label": "bits of the file a texel", "unit": "bits", "ticks": BITS}
    by_time = {"label": "budget: time of a query, × floor", "unit": "× floor", "ticks": TIMES}
    return Front(
        kind,
        surfaces,
        _plot("size", f"{kind} surfaces: quality over bytes", by_size, curves, surfaces),
        _plot("time", f"{kind} surfaces: quality over time", by_time, _within_times(rungs, surfaces, curves), surfaces),
    )


def _curves(rungs: Rungs, surfaces: Sequence[str]) -> _Curves:
    """By line with curves, its median PSNR by bits a texel, where it has a value on each surface."""
    medians = pd.DataFrame({bits: median_over(rungs.read(bits)[[*surfaces]]) for bits in _SIZES})
    curves: dict[str, Any] = {line: medians.loc[line].dropna().to_dict() for line in rungs.hulls}
    return curves


def _near(curves: _Curves) -> _Curves:
    """The curves that come within `FAR_DB` of the best at some size, the highest first."""
    best = {bits: max(curve.get(bits, 0.0) for curve in curves.values()) for bits in _SIZES}
    near = {}
    for line, curve in curves.items():
        if any(value > best[bits] - FAR_DB for bits, value in curve.items()):
            near[line] = curve
    return dict(sorted(near.items(), key=lambda item: -max(item[1].values())))


def _within_times(rungs: Rungs, surfaces: Sequence[str], lines: Iterable[str]) -> _Curves:
    """By line, its median PSNR by the budget of time, × floor, where it has a rung within that on each surface."""
    budgets = [budget for budget in rungs.limits if budget.kind == EAGER]
    psnr_within: dict[float, Any] = {budget.most: rungs.ranked(budget, surfaces).to_dict() for budget in budgets}
    return {line: {most: psnr[line] for most, psnr in psnr_within.items() if line in psnr} for line in lines}


def _plot(kind: str, title: str, x: dict[str, Any], curves: _Curves, surfaces: Sequence[str]) -> Plot:
    """A plot of a kind, "size" or "time", with a line for each of the `curves` that has points: its PSNR by the cost on
    the axis `x`."""
    series: Series = []
    for line, values in curves.items():
        if values:
            series.append({"label": line, "line": True, "points": [[cost, psnr] for cost, psnr in values.items()]})
    return {
        "material": "",
        "kind": kind,
        "title": title,
        "x": {"log": True, "less": True} | x,
        "y": {"label": "test PSNR, dB"},
        "series": series,
        "missing": [line for line, values in curves.items() if not values],
        "note": f"Medians over {', '.join(surfaces)}; codecs within {FAR_DB:g} dB of the best.",
    }
