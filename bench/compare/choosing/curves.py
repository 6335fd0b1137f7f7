"""Curves of quality over bytes: what a codec reaches at a size, and by how much it is ahead of another at equal sizes.

A line is a codec, or a codec as published; a rung is one setting of it, with the size of its file and its scores. A
curve is of one line on one surface. Its points are the rungs on the upper convex hull that validation pairs leave over
the logarithm of bytes; they are shown with their scores of test pairs, and joined linearly over log bytes. From the
best rung a curve goes on level to the largest that was measured, since a file may be smaller than it may be; it is
never extrapolated.
"""

from collections.abc import Iterable, Mapping, Sequence
from statistics import fmean
from typing import NamedTuple

import numpy as np

from bench.compare.choosing import Rung
from bench.compare.choosing.budgets import Budget, Budgets, mean_test_score, rung_of
from bench.compare.statistics import Curve, at, average, bd_psnr, interval_over_surfaces, upper_hull
from bench.metrics import stats_of
from bench.records import PSNR, Job

LEAST_RUNGS = 3  # of a codec on a surface, or it has no curve there
DRAWS = 200  # draws of the seeds of each rung, of those that have several
FEWEST = 10  # surfaces below which nothing is told apart


class Point(NamedTuple):
    """A rung of a curve: log2 of its bits a texel, and its jobs, one a seed."""

    size: float
    jobs: Sequence[Job]


Points = Mapping[str, Mapping[str, Sequence[Point]]]  # by line and surface


class Reading(NamedTuple):
    """A line's mean at a size: read off its curves; or, without curves, that of its best rungs within that size."""

    value: float
    lower_bound: bool  # of rungs at a size: with a rung of just this size, the codec might reach more


class Summary(NamedTuple):
    """A difference over surfaces: mean, median, on how many it is above 0, and the 95 % interval of the mean."""

    mean: float
    median: float
    won: int
    surfaces: int
    low: float
    high: float

    @property
    def apart(self) -> bool:
        """Whether there are enough surfaces, and the interval leaves out 0."""
        return self.surfaces >= FEWEST and not self.low <= 0 <= self.high


def hulls(result: Budgets, surfaces: Iterable[str]) -> dict[str, dict[str, Sequence[Point]]]:
    """By line and surface: the rungs on the hull that validation pairs leave, where there are enough for a curve."""
    points_of: dict[str, dict[str, Sequence[Point]]] = {}
    for line, by_label in result.rungs.items():
        for surface in surfaces:
            rungs = [rung_of(jobs[surface], {}) for jobs in by_label.values() if surface in jobs]
            if len(rungs) < LEAST_RUNGS:
                continue
            points = _hull(rungs)
            if len(points) > 1:  # a single point is no curve
                points_of.setdefault(line, {})[surface] = points
    return points_of


def _hull(rungs: Sequence[Rung]) -> list[Point]:
    """The rungs on the upper convex hull of validation scores over log bytes; sizes ascend.

    The best rung stands once more at the size of the largest, if that is another.
    """
    sizes = [float(np.log2(rung.size)) for rung in rungs]
    points = [Point(sizes[number], rungs[number].of) for number in upper_hull(sizes, [rung.score for rung in rungs])]
    largest = max(sizes)
    if largest > points[-1].size:
        points.append(Point(largest, points[-1].jobs))
    return points


def curve_of(
    points: Sequence[Point],
    family: str = PSNR,
    draw: np.random.Generator | None = None,
    footprint: str = "",
    statistic: str = "mean",
) -> Curve | None:
    """The curve of a metric's family over test pairs, means over seeds; of seeds drawn with replacement, if asked.

    With a `footprint` in texels, of PSNR averaged over boxes of that side. The `statistic` is the mean over slices, or
    `pooled`, of the error of all slices together. None if a job lacks the metric, and without points.
    """
    values = list[float]()
    for place, point in enumerate(points):
        jobs = point.jobs
        # The level end of a curve is the best rung again: the same number, not a draw of its own.
        is_level_end = place > 0 and jobs is points[place - 1].jobs
        if is_level_end:
            values.append(values[-1])
            continue
        if draw is not None and len(jobs) > 1:
            jobs = [jobs[seed] for seed in draw.integers(0, len(jobs), len(jobs))]
        mean = average([_mean_of(job, family, footprint, statistic) for job in jobs])
        if mean is None:
            return None
        values.append(mean)
    return Curve([point.size for point in points], values) if points else None


def _mean_of(job: Job, family: str, footprint: str, statistic: str) -> float | None:
    """The mean, or another statistic, of a job over test slices; None if it was not measured.

    It is that of the metric of a `family`, such as SSIM; or, with a footprint, always of PSNR, of boxes of that side.
    """
    if footprint:
        return job.get("footprints", {}).get(footprint, {}).get("mean")
    return stats_of(job, family).get(statistic)


def mean_at(
    by_surface: Mapping[str, Sequence[Point]],
    surfaces: Iterable[str],
    bits: float,
    family: str = PSNR,
    footprint: str = "",
    statistic: str = "mean",
) -> float | None:
    """The mean over surfaces of a line's curves at so many bits a texel; None if one of them does not reach that size,
    or there is no surface. See `curve_of` for the metric, the footprint and the statistic."""
    size = float(np.log2(bits))
    curves = [curve_of(by_surface.get(each, ()), family, footprint=footprint, statistic=statistic) for each in surfaces]
    return average([curve and at(curve, size) for curve in curves])


def readings(result: Budgets, points: Points, budget: Budget, surfaces: Sequence[str]) -> dict[str, Reading]:
    """By line: its mean PSNR over surfaces at a budget of bytes, the best first; without lines that do not reach it."""
    reading_of: dict[str, Reading] = {}
    for line, value in result.ranked(budget, surfaces).items():
        has_curve = any(surface in points.get(line, {}) for surface in surfaces)
        if not has_curve:
            reading_of[line] = Reading(value, lower_bound=True)
    for line, by_surface in points.items():
        mean = mean_at(by_surface, surfaces, budget.most)
        if mean is not None:
            reading_of[line] = Reading(mean, lower_bound=False)
    return dict(sorted(reading_of.items(), key=lambda item: -item[1].value))


def gaps_of_rungs(result: Budgets, line: str, anchor: Mapping[str, Sequence[Point]]) -> dict[str, list[float]]:
    """By surface: the mean gap in dB of a line's rungs to another line's curve, at their bytes.

    It stands for `differences` where the line has no curves, and has its form: seeds are not drawn, so the number is
    repeated in place of each draw. `anchor` has the points of the other line by surface.
    """
    gaps_on: dict[str, list[float]] = {}  # by surface
    for surface in sorted(anchor):
        curve = curve_of(anchor[surface])
        if curve is None:
            continue
        rungs = [rung_of(jobs[surface], {}) for jobs in result.rungs[line].values() if surface in jobs]
        gaps = []
        for rung in rungs:
            ours = mean_test_score(rung, PSNR)
            theirs = at(curve, float(np.log2(rung.size)))  # None where the curve does not reach
            if ours is not None and theirs is not None:
                gaps.append(ours - theirs)
        if gaps:
            gaps_on[surface] = [fmean(gaps)] * (1 + DRAWS)
    return gaps_on


def differences(points: Mapping[str, Sequence[Point]], anchor: Mapping[str, Sequence[Point]]) -> dict[str, list[float]]:
    """By surface on which both lines have curves: BD-PSNR of one to the other, then the same for `DRAWS` draws of the
    seeds of each. `points` and `anchor` have the points of the two lines by surface."""
    gaps_on: dict[str, list[float]] = {}
    rng = np.random.default_rng(0)
    for surface in sorted(points.keys() & anchor.keys()):
        ours, theirs = points[surface], anchor[surface]
        gap = _difference(ours, theirs)
        if gap is None:  # their curves share no bytes
            continue
        gaps_of_draws = [gap] * DRAWS  # with one seed there is nothing to draw
        if any(len(point.jobs) > 1 for point in (*ours, *theirs)):
            differences_of_draws = [_difference(ours, theirs, rng) for _ in range(DRAWS)]
            gaps_of_draws = [difference for difference in differences_of_draws if difference is not None]
        gaps_on[surface] = [gap, *gaps_of_draws]
    return gaps_on


def _difference(
    ours: Sequence[Point], theirs: Sequence[Point], draw: np.random.Generator | None = None
) -> float | None:
    """BD-PSNR of two lists of points; None if they have no curves, or none in common."""
    our_curve = curve_of(ours, PSNR, draw)
    their_curve = curve_of(theirs, PSNR, draw)
    if our_curve is None or their_curve is None:
        return None
    return bd_psnr(our_curve, their_curve)


def summarised(by_surface: dict[str, list[float]]) -> Summary:
    """The summary of what `differences` gives by surface."""
    values = np.array(list(by_surface.values()))  # (surfaces, 1 + DRAWS)
    measured = values[:, 0]
    low, high = interval_over_surfaces(values[:, 1:])
    won = int((measured > 0).sum())
    return Summary(float(measured.mean()), float(np.median(measured)), won, len(values), low, high)
