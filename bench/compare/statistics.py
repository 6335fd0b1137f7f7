"""Statistics on plain arrays of numbers: curves and their differences, tests, intervals, ranks.

A *curve* has values in dB, or of another metric, over log2 of bits a texel. Two curves are compared over the range that
both have, by Bjøntegaard's differences (VCEG-M33, 2001): BD-PSNR is the mean gap in dB over log bytes, BD-rate the mean
gap in log bytes over dB.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from statistics import NormalDist, fmean
from typing import NamedTuple

import numpy as np

from bench.records import grouped

ALPHA = 0.05  # the largest chance that equal codecs are told apart: any of a table, by Holm's correction or ranks
FEWEST = 3  # materials on which codecs may be told apart
DRAWS = 2000  # of seeds and slices
RESAMPLES = 10_000  # of surfaces
SEED = 0

_Line = tuple[Sequence[float], Sequence[float]]  # a piecewise linear function: x, which does not descend, and y


class Curve(NamedTuple):
    """Values over sizes, which ascend: log2 of bits a texel, and a metric."""

    sizes: Sequence[float]
    values: Sequence[float]


def average(values: Sequence[float | None]) -> float | None:
    """The mean of the finite values; infinite if all are exact, None if one was not measured or there are none.

    Infinite ones are left out, because a mean with them would be infinite whatever the others are.
    """
    measured = [value for value in values if value is not None]
    if not measured or len(measured) < len(values):
        return None
    finite = [value for value in measured if math.isfinite(value)]
    return fmean(finite) if finite else math.inf


def upper_hull(sizes: Sequence[float], scores: Sequence[float]) -> list[int]:
    """The numbers of the points (n,) on the upper convex hull, up to the highest score, by ascending size.

    Of points on a line only its ends are on the hull; of those of one size, the best.
    """
    hull: list[int] = []
    for new in sorted(range(len(sizes)), key=lambda point: (sizes[point], -scores[point])):
        if hull and scores[new] <= scores[hull[-1]]:
            continue  # no better than a smaller one
        while len(hull) > 1:
            first, middle = hull[-2:]
            # Compares the slopes from `first` to the other two. Both are multiplied by both differences of size, so
            # that nothing is divided.
            slope_to_middle = (scores[middle] - scores[first]) * (sizes[new] - sizes[first])
            slope_to_new = (scores[new] - scores[first]) * (sizes[middle] - sizes[first])
            if slope_to_middle > slope_to_new:
                break
            hull.pop()  # the new one hides those that it leaves on or below the hull
        hull.append(new)
    return hull


def at(curve: Curve, size: float) -> float | None:
    """The value at a size, log2 of bits a texel; None where the curve does not reach: it is never extrapolated."""
    if not curve.sizes[0] <= size <= curve.sizes[-1]:
        return None
    return float(np.interp(size, curve.sizes, curve.values))


def bd_psnr(ours: Curve, theirs: Curve) -> float | None:
    """The mean of our values minus theirs, over the log bytes that both curves have; None if they share none."""
    return _mean_gap(ours, theirs)


def bd_rate(ours: Curve, theirs: Curve) -> float | None:
    """By which share our bytes differ from theirs, a mean over the values that both curves have: −0.2 is 20 % fewer.

    A point of test pairs below that of a smaller file counts as high as this one. Where they share no values, no number
    of bytes makes the lower curve as good as the higher: the share is −1 if ours is the higher, and else infinite. None
    if all that they share is one value, such as the most that a slice counts.
    """
    lines = []  # of log bytes over values
    for curve in (ours, theirs):
        highest = np.maximum.accumulate(curve.values).tolist()
        count = highest.index(highest[-1]) + 1  # from this point on, more bytes add nothing
        lines.append((highest[:count], curve.sizes[:count]))
    (our_values, _), (their_values, _) = lines
    if our_values[0] > their_values[-1]:
        return -1.0
    if their_values[0] > our_values[-1]:
        return math.inf
    gap = _mean_gap(*lines)
    if gap is None:
        return None
    return float(2**gap - 1)  # from log2 of the ratio of bytes


def _mean_gap(ours: _Line, theirs: _Line) -> float | None:
    """The mean of one piecewise linear function minus another over the x that both have; None if they share none.

    Each jumps where two of its points have the same x.
    """
    (our_x, our_y), (their_x, their_y) = ours, theirs
    low, high = max(our_x[0], their_x[0]), min(our_x[-1], their_x[-1])
    if low >= high:
        return None
    inner = sorted(x for x in (*our_x, *their_x) if low < x < high)
    # Both are linear between these places, so the midpoint rule is exact. It asks no function where it may jump.
    places = np.array([low, *inner, high])
    middles = (places[1:] + places[:-1]) / 2
    gap = np.interp(middles, our_x, our_y) - np.interp(middles, their_x, their_y)
    areas = np.diff(places) * gap
    return float(areas.sum() / (high - low))


def interval_over_surfaces(drawn: np.ndarray) -> tuple[float, float]:
    """The 95 % interval of a median over surfaces; `drawn` (surfaces, draws) has a value for each draw of their seeds.

    Surfaces and seeds are drawn with replacement. Draws of a few surfaces scatter less than new surfaces would, so the
    percentiles lie further out than 2.5 and 97.5: as far as Student's t does (Hesterberg, "What teachers should know
    about the bootstrap", The American Statistician 69(4), 2015, the expanded percentile interval).
    """
    count, draws = drawn.shape
    medians = np.median(drawn[_draws_of_surfaces_and_seeds(count, draws)], 1)
    tail = 2.5  # per cent below and above the interval; of a single surface, whose seeds alone are drawn
    if count > 1:
        tail = 100 * NormalDist().cdf(-student_quantile(count - 1) * math.sqrt(count / (count - 1)))
    low, high = np.percentile(medians, [tail, 100 - tail])
    return float(low), float(high)


@lru_cache(maxsize=4)  # the intervals of a table are mostly over as many surfaces, by kind and over all
def student_quantile(freedom: int) -> float:
    """The quantile 0.975 of Student's t with so many degrees of freedom, within 1e-6 of itself: its density summed up.

    SciPy has it, too, but takes a sixth of the time of a whole table to import.
    """
    places = np.linspace(0, 16, 16_001)  # that of one degree, the largest, is 12.7
    scale = math.exp(math.lgamma((freedom + 1) / 2) - math.lgamma(freedom / 2)) / math.sqrt(freedom * math.pi)
    density = scale * (1 + places**2 / freedom) ** (-(freedom + 1) / 2)
    areas = (density[1:] + density[:-1]) / 2 * np.diff(places)
    return float(np.interp(0.475, np.cumsum(areas), places[1:]))  # half of the distribution lies below 0


@lru_cache(maxsize=4)  # the intervals of a table mostly draw from as many surfaces and seeds, by kind and over all
def _draws_of_surfaces_and_seeds(count: int, draws: int) -> tuple[np.ndarray, np.ndarray]:
    """The numbers of `count` drawn surfaces for each resample, and for each of these one of `draws` draws of its seeds;
    both (RESAMPLES, count)."""
    rng = np.random.default_rng(SEED)
    surfaces = rng.integers(0, count, (RESAMPLES, count))
    return surfaces, rng.integers(0, draws, surfaces.shape)


def interval_over_slices(differences: Sequence[np.ndarray], pairs: Sequence[str]) -> tuple[float, float]:
    """The 95 % interval of the mean over seeds of the means of `differences`, (slices,) of each seed.

    Seeds, and slices of each, are drawn with replacement; seeds with the same `pairs` draw the same slices.
    """
    # The numbers of seeds that are scored at the same pairs, and so draw the same ones.
    alike = grouped(range(len(pairs)), lambda seed: (pairs[seed], len(differences[seed])))
    shares, chosen_seeds = _draws_of_slices_and_seeds(tuple(count for _, count in alike), len(pairs))
    means = np.empty((len(pairs), DRAWS))  # of each seed, over the slices of each draw
    for shares_of_group, seeds in zip(shares, alike.values(), strict=True):
        means[seeds] = np.stack([differences[seed] for seed in seeds]) @ shares_of_group.T
    # In each draw, the mean over the seeds that it chooses.
    means_of_draws = means[chosen_seeds, np.arange(DRAWS)].mean(0)
    low, high = np.percentile(means_of_draws, [2.5, 97.5])
    return float(low), float(high)


@lru_cache(maxsize=1)  # the intervals of a table mostly draw from as many slices and seeds
def _draws_of_slices_and_seeds(counts: tuple[int, ...], seeds: int) -> tuple[list[np.ndarray], np.ndarray]:
    """How often each slice of each group is drawn, as shares (DRAWS, count) of `counts`, and the numbers of the drawn
    seeds, (seeds, DRAWS)."""
    rng = np.random.default_rng(SEED)
    shares = []
    for count in counts:  # counting drawn numbers takes a seventh of the time of NumPy's `multinomial`
        # Draws are counted together: slice s of draw d has the number d · count + s.
        drawn = rng.integers(0, count, (DRAWS, count)) + count * np.arange(DRAWS)[:, None]
        shares.append(np.bincount(drawn.ravel(), minlength=DRAWS * count).reshape(DRAWS, count) / count)
    return shares, rng.integers(0, seeds, (seeds, DRAWS))


def student(values: np.ndarray) -> tuple[float, float]:
    """Half the 95 % interval of the mean of two values (n,) or more, and the chance of so large a mean if the true one
    is 0: by Student's t."""
    from scipy.special import stdtr, stdtrit  # slow to import, and needed only here

    mean = abs(values.mean())
    error = values.std(ddof=1) / math.sqrt(len(values))
    freedom = len(values) - 1
    half_interval = float(stdtrit(freedom, 0.975) * error)
    if error > 0:
        return half_interval, float(2 * stdtr(freedom, -mean / error))  # of both tails
    # All values are equal. If they are 0, equal codecs give them for certain, and else never.
    return half_interval, float(mean == 0)


def chance_if_equal(differences: np.ndarray) -> float:
    """The probability that equal codecs differ as much in the mean over materials; `differences` (materials,) in dB.

    By Student's t; 1 for fewer than `FEWEST` materials, which say nothing about others.
    """
    return student(differences)[1] if len(differences) >= FEWEST else 1.0


def told_by_holm(chances: Sequence[float]) -> list[bool]:
    """Which of several are told apart, by Holm's correction (1979), from the probability of each if all were equal."""
    told = [False] * len(chances)
    for before, place in enumerate(np.argsort(chances, kind="stable")):
        limit = ALPHA / (len(chances) - before)  # after Holm: over the number of those not yet told apart
        if not chances[place] <= limit:  # also if the chance is NaN
            break  # none with a larger chance is told apart either
        told[place] = True
    return told


def mean_ranks(scores: np.ndarray, same: float = 0.0) -> np.ndarray:
    """The mean rank (codecs,) over materials, 1 for the best, by `scores` (codecs, materials), of which more is better.

    Scores that differ by no more than `same` share the mean of their places.
    """
    better = scores[:, None] > scores + same  # (codecs, codecs, materials): the first of two is better than the second
    # A codec takes the mean of the places from behind the better ones to before the worse ones.
    places = (len(scores) + 1 + better.sum(0) - better.sum(1)) / 2
    means: np.ndarray = places.mean(1)
    return means


def critical_difference(codecs: int, materials: int) -> float:
    """Nemenyi's: two mean ranks that differ by less are not told apart.

    It is q · sqrt(k (k + 1) / 6 N) over N materials and k codecs, where q is the quantile of the studentised range of k
    groups divided by sqrt(2) (Demšar, "Statistical comparisons of classifiers over multiple data sets", JMLR 7, 2006).
    """
    from scipy.stats import studentized_range  # slow to import

    quantile = studentized_range.ppf(1 - ALPHA, codecs, np.inf) / math.sqrt(2)
    return float(quantile) * math.sqrt(codecs * (codecs + 1) / (6 * materials))
