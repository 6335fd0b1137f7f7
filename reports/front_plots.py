"""The data of plots of quality over budgets: curves over bytes, and rungs within budgets of the time of a query.

Within a *budget* (of bits a texel, or of the time of a query) validation pairs choose one rung of a line for each
surface, and its PSNR at test pairs is drawn. The *curve* of a line on a surface joins its best rungs over bytes.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import pandas as pd

from bench.records import Run
from reports.rungs import BITS, EAGER, TIMES, Rungs, median_over, rungs_of
from reports.series import Plot, Series

FAR_DB = 8.0  # lines so far below the best at every size of a curve are left out: they would press others together
_STEPS = 8  # points of a drawn curve from one budget of bytes to the next
_SIZES = [BITS[0] * 2 ** (step / _STEPS) for step in range(_STEPS * (len(BITS) - 1) + 1)]  # bits a texel


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
        if any(on.keys() & set(surfaces) for on in rungs.hulls.values()):
            yield _front(rungs, kind, surfaces)


def _front(rungs: Rungs, kind: str, surfaces: Sequence[str]) -> Front:
    """Medians over the surfaces: curves over bytes, as far as they reach on each, and rungs within budgets of time.

    `surfaces` are the names of those of one `kind`. Lines that are far below the best everywhere are left out of both.
    The line of the highest PSNR comes first.
    """
    # By line, its median PSNR by bits a texel; by bits, the best of all lines, 0 where none reaches.
    curves = pd.DataFrame({bits: median_over(rungs.read(bits)[[*surfaces]]) for bits in _SIZES})
    medians: dict[str, Any] = {line: curves.loc[line].dropna().to_dict() for line in rungs.hulls}
    best = {bits: max(curve.get(bits, 0.0) for curve in medians.values()) for bits in _SIZES}
    near: list[str] = []
    for line in sorted(medians, key=lambda line: -max(medians[line].values(), default=0.0)):
        if any(value > best[bits] - FAR_DB for bits, value in medians[line].items()):
            near.append(line)
    sizes = {line: medians[line] for line in near}

    # By the time of a budget: the median PSNR of each line that has a rung within it on every surface.
    ranked: dict[float, Any] = {}
    for budget in rungs.limits:
        if budget.kind == EAGER:
            ranked[budget.most] = rungs.ranked(budget, surfaces).to_dict()
    times = {line: {most: lines[line] for most, lines in ranked.items() if line in lines} for line in near}

    def plot(of: str, words: str, x: dict[str, Any], lines: Mapping[str, Mapping[float, float]]) -> Plot:
        """A plot with a line for each entry: its PSNR by the cost on the axis `x`."""
        series: Series = []
        for line, values in lines.items():
            if values:
                series.append({"label": line, "line": True, "points": [[cost, psnr] for cost, psnr in values.items()]})
        return {
            "material": "",
            "kind": of,
            "title": f"{kind} surfaces: quality over {words}",
            "x": {"log": True, "less": True} | x,
            "y": {"label": "test PSNR, dB"},
            "series": series,
            "missing": [line for line in near if not lines[line]],
            "note": f"Medians over {', '.join(surfaces)}; codecs within {FAR_DB:g} dB of the best.",
        }

    by_size = {"label": "bits of the file a texel", "unit": "bits", "ticks": BITS}
    by_time = {"label": "budget: time of a query, × floor", "unit": "× floor", "ticks": TIMES}
    return Front(
        kind,
        surfaces,
        plot("size", "bytes", by_size, sizes),
        plot("time", "time", by_time, times),
    )
