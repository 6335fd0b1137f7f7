"""What each codec reaches within a budget: on a surface, as a mean over surfaces, and as a rank.

A *line* is a codec, or a codec as published; a *rung* is one setting of it. Within a size a line has what its curve has
there, so that no step of a ladder decides. A curve that ends below the size counts by its end, because a smaller file
meets a larger limit, too. Within a time, and for a line without curves, it is the rung that validation pairs choose.
"""

from collections.abc import Sequence
from statistics import fmean
from typing import NamedTuple

import numpy as np

from bench.compare.choosing import NEAR_DB
from bench.compare.choosing.budgets import BYTES, ENOUGH, Budget, Budgets, best_first, mean_test_score
from bench.compare.choosing.curves import Point, Points, curve_of
from bench.compare.ranks import Ranks, ranks
from bench.compare.statistics import at
from bench.records import PSNR


class Reached(NamedTuple):
    """What a line reaches on a surface, at test pairs, and the size of its file there in bits a texel."""

    value: float
    bits: float


def reached(
    result: Budgets, points: Points, budget: Budget, surfaces: Sequence[str], family: str = PSNR
) -> dict[str, dict[str, Reached]]:
    """By line and surface: what it reaches within a budget, of the lines that reach something on each surface.

    `points` are those of curves, as `hulls` gives them.
    """
    found: dict[str, dict[str, Reached]] = {}
    for line, rungs in result.picks(budget, surfaces).items():
        of_rungs: dict[str, Reached] = {}
        for surface, rung in rungs.items():
            score = mean_test_score(rung, family)
            if score is not None:  # None: the metric was not measured
                of_rungs[surface] = Reached(score, rung.size)
        if len(of_rungs) == len(surfaces):
            found[line] = of_rungs
    if budget.kind != BYTES:  # no curve leads from one time to another
        return found
    for line, by_surface in points.items():
        of_curves: dict[str, Reached] = {}
        for surface in surfaces:
            read = _read(by_surface.get(surface, ()), budget.most, family)
            if read is not None:
                of_curves[surface] = read
        if len(of_curves) == len(surfaces):
            found[line] = of_curves
    return found


def _read(points: Sequence[Point], bits: float, family: str) -> Reached | None:
    """A curve at so many bits a texel, or at its end if it ends before.

    None if it begins after that, without points, and where the metric was not measured.
    """
    curve = curve_of(points, family)
    if curve is None:
        return None
    size = min(float(np.log2(bits)), curve.sizes[-1])
    value = at(curve, size)
    return None if value is None else Reached(value, min(bits, float(2**size)))


def ranked(
    result: Budgets, points: Points, budget: Budget, surfaces: Sequence[str], family: str = PSNR
) -> dict[str, float]:
    """By line: the mean over surfaces of what it reaches within a budget, the best first."""
    means: dict[str, float] = {}
    for line, by_surface in reached(result, points, budget, surfaces, family).items():
        means[line] = fmean(each.value for each in by_surface.values())
    return best_first(means, family)


def fewest_bytes(result: Budgets, points: Points) -> tuple[Budget, dict[str, float]] | None:
    """The smallest budget of bytes at which a line is within `NEAR_DB` of the best of all these budgets, and the mean
    PSNR of its lines that are so near; None without any line."""
    by_budget: dict[Budget, dict[str, float]] = {}
    for budget in result.limits:  # the budgets of bytes ascend
        if budget.kind == BYTES:
            by_budget[budget] = ranked(result, points, budget, list(result.surfaces))
    best = max((value for means in by_budget.values() for value in means.values()), default=0.0)
    for budget, means in by_budget.items():
        near = {line: value for line, value in means.items() if value >= best - NEAR_DB}
        if near:
            return budget, near
    return None


def mean_ranks(result: Budgets, points: Points) -> Ranks | None:
    """The mean ranks of lines within `ENOUGH`; None for fewer than two lines or three surfaces."""
    scores = {}
    for line, by_surface in reached(result, points, ENOUGH, list(result.surfaces)).items():
        scores[line] = [each.value for each in by_surface.values()]
    return ranks(scores)
