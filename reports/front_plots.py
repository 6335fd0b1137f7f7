"""The data of plots of quality over budgets: curves over bytes, and rungs within budgets of the time of a query.

A *surface* is a material of the run. A *line* is a codec, or a codec as published. A *rung* is one setting of it, such
as `components=8`, that was measured; within a *budget* (of bits a texel, or of the time of a query) validation pairs
choose one rung of a line for each surface, and its PSNR at test pairs is drawn. The *curve* of a line on a surface
joins its best rungs over bytes. The *floor* is the time of one bilinear colour fetch.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from bench.compare.choosing.budgets import BITS, EAGER, TIMES, Budgets, budgets
from bench.compare.choosing.curves import Point, hulls, mean_at
from bench.records import Run, by_kind
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
    result = budgets(run)
    for kind, surfaces in by_kind(result.surfaces).items():
        if hulls(result, surfaces):
            yield _front(result, kind, surfaces)


def _front(result: Budgets, kind: str, surfaces: Sequence[str]) -> Front:
    """Means over the surfaces: curves over bytes, as far as they reach on each, and rungs within budgets of time.

    `surfaces` are the names of those of one `kind`. Lines that are far below the best everywhere are left out of both.
    The line of the highest PSNR comes first.
    """
    # By line, its mean PSNR by bits a texel; by bits, the best of all lines, 0 where none reaches.
    means = {line: _mean_curve(curves, surfaces) for line, curves in hulls(result, surfaces).items()}
    best = {bits: max(curve.get(bits, 0.0) for curve in means.values()) for bits in _SIZES}
    near: list[str] = []
    for line in sorted(means, key=lambda line: -max(means[line].values(), default=0.0)):
        if any(value > best[bits] - FAR_DB for bits, value in means[line].items()):
            near.append(line)
    sizes = {line: means[line] for line in near}

    # By the time of a budget: the mean PSNR of each line that has a rung within it on every surface.
    ranked = {budget.most: result.ranked(budget, surfaces) for budget in result.limits if budget.kind == EAGER}
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
            "note": f"Means over {', '.join(surfaces)}; codecs within {FAR_DB:g} dB of the best.",
        }

    by_size = {"label": "bits of the file a texel", "unit": "bits", "ticks": BITS}
    by_time = {"label": "budget: time of a query, × floor", "unit": "× floor", "ticks": TIMES}
    return Front(
        kind,
        surfaces,
        plot("size", "bytes", by_size, sizes),
        plot("time", "time", by_time, times),
    )


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
