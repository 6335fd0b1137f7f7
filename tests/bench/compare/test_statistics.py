"""Statistics of plain numbers against SciPy's, NumPy's, and closed forms."""

import math

import numpy as np
import pytest
from scipy import spatial, stats

from bench.compare.statistics import (
    ALPHA,
    Curve,
    at,
    average,
    bd_psnr,
    bd_rate,
    chance_if_equal,
    critical_difference,
    interval_over_slices,
    interval_over_surfaces,
    mean_ranks,
    student,
    student_quantile,
    told_by_holm,
    upper_hull,
)

OURS = Curve([2.0, 3.0, 5.0], [20.0, 26.0, 30.0])
THEIRS = Curve([1.0, 4.0, 6.0], [15.0, 27.0, 29.0])
RNG = np.random.default_rng


def test_the_mean_leaves_out_infinite_values_but_none_that_was_not_measured():
    assert average([1.0, math.inf, 2.0]) == 1.5
    assert average([math.inf, math.inf]) == math.inf
    assert average([1.0, None]) is average([]) is None


@pytest.mark.parametrize("seed", range(20))
def test_the_upper_hull_is_that_part_of_the_convex_one(seed):
    """The part from the smallest to the highest point, on or above the line between these two."""
    points = RNG(seed).normal(size=(3 + 2 * seed, 2))
    left, top = points[points[:, 0].argmin()], points[points[:, 1].argmax()]
    x, y = points.T
    line = np.interp(x, *np.array([left, top]).T)
    vertices = spatial.ConvexHull(points).vertices
    upper = [at for at in vertices if x[at] <= top[0] and y[at] >= line[at] - 1e-12]
    assert upper_hull(x.tolist(), y.tolist()) == sorted(upper, key=lambda at: x[at])


def test_the_hull_has_no_point_on_a_line_and_no_second_of_a_size():
    assert upper_hull([0.0, 1.0, 2.0], [0.0, 1.0, 2.0]) == [0, 2]
    assert upper_hull([1.0, 0.0, 1.0, 2.0], [3.0, 2.0, 5.0, 5.0]) == [1, 2]


def test_a_curve_is_linear_over_log_bytes_and_never_extrapolated():
    for size in np.linspace(2, 5, 13):
        assert at(OURS, size) == np.interp(size, OURS.sizes, OURS.values)
    assert at(OURS, 1.99) is at(OURS, 5.01) is None


def test_differences_of_straight_lines_are_those_of_their_middles():
    ours, theirs = Curve([0.0, 4.0], [20.0, 28.0]), Curve([1.0, 5.0], [19.0, 31.0])  # 20 + 2 s, 16 + 3 s
    assert bd_psnr(ours, theirs) == pytest.approx(20 + 2 * 2.5 - 16 - 3 * 2.5)  # both from 1 to 4
    assert bd_rate(ours, theirs) == pytest.approx(2 ** ((24 - 20) / 2 - (24 - 16) / 3) - 1)  # both from 20 to 28
    higher = Curve(OURS.sizes, [value + 1.5 for value in OURS.values])
    assert bd_psnr(higher, OURS) == pytest.approx(1.5)
    halved = Curve([size - 1 for size in OURS.sizes], OURS.values)
    assert bd_rate(halved, OURS) == pytest.approx(-0.5)


def test_differences_are_means_over_what_both_curves_reach():
    """Against sums over a fine grid: of dB from 4 to 32 bits, and of log bytes from 20 to 29 dB."""
    sizes = np.linspace(2, 5, 300_001)
    gap = np.interp(sizes, *OURS) - np.interp(sizes, *THEIRS)
    assert bd_psnr(OURS, THEIRS) == pytest.approx(gap.mean(), abs=1e-4)
    assert bd_psnr(THEIRS, OURS) == pytest.approx(-bd_psnr(OURS, THEIRS))
    values = np.linspace(20, 29, 300_001)
    gap = np.interp(values, OURS.values, OURS.sizes) - np.interp(values, THEIRS.values, THEIRS.sizes)
    assert bd_rate(OURS, THEIRS) == pytest.approx(2 ** gap.mean() - 1, abs=1e-4)


def test_bytes_that_gain_nothing_are_none_that_a_quality_takes():
    level = Curve([2.0, 4.0, 5.0], [19.0, 28.0, 28.0])
    assert bd_rate(level, level) == 0
    assert bd_rate(level, Curve([3.0, 5.0, 6.0], level.values)) == pytest.approx(-0.5)
    # Where a curve dips, its bytes jump at one height: the mean over heights, read between them, is the oracle.
    dips = Curve([0.0, 1.0, 2.0, 3.0], [28.0, 30.0, 29.9, 35.0])
    heights = np.arange(28.0005, 35.0, 0.001)
    ours = np.interp(heights, [28.0, 30.0, 30.0, 35.0], dips.sizes)
    theirs = np.interp(heights, [28.0, 35.0], [0.0, 3.0])
    expected = 2 ** (ours - theirs).mean() - 1
    assert bd_rate(dips, Curve([0.0, 3.0], [28.0, 35.0])) == pytest.approx(expected, abs=1e-4)
    assert bd_rate(dips, dips) == pytest.approx(0.0)


def test_curves_that_share_nothing_have_no_difference():
    far = Curve([7.0, 8.0], [40.0, 41.0])
    assert bd_psnr(far, OURS) is None
    # No file of the lower curve is as good as the smallest of the higher.
    assert (bd_rate(far, OURS), bd_rate(OURS, far)) == (-1.0, math.inf)
    flat = Curve([2.0, 3.0], [100.0, 100.0])
    assert bd_rate(flat, flat) is None  # level at one value, which says nothing of bytes


def bootstrap(values, level, of=np.mean):
    """SciPy's percentile interval of a statistic, from another stream of draws."""
    drawn = {"confidence_level": level, "n_resamples": 20_000, "random_state": 7}
    found = stats.bootstrap((values,), of, method="percentile", **drawn)
    return found.confidence_interval


def test_over_surfaces_it_is_a_bootstrap_of_the_median_widened_as_student_s_t_asks():
    values = RNG(0).normal(1, 2, 12)
    low, high = interval_over_surfaces(values[:, None])
    tail = stats.norm.cdf(stats.t.ppf(0.025, 11) * (12 / 11) ** 0.5)
    assert (low, high) == pytest.approx(tuple(bootstrap(values, 1 - 2 * tail, np.median)), abs=0.06)
    seeds = RNG(1).normal(size=200)  # of a single surface the seeds alone are drawn
    assert interval_over_surfaces(seeds[None]) == pytest.approx(np.percentile(seeds, [2.5, 97.5]), abs=0.15)


@pytest.mark.parametrize("freedom", [1, 2, 9, 19, 500])
def test_the_quantile_is_student_s(freedom):
    assert student_quantile(freedom) == pytest.approx(stats.t.ppf(0.975, freedom), rel=1e-6)


def test_the_interval_holds_the_truth_of_ten_surfaces_in_19_of_20_cases():
    """Percentiles of 2.5 and 97.5 of drawn means would in 178 of 200."""
    intervals = [interval_over_surfaces(values[:, None]) for values in RNG(0).standard_normal((200, 10))]
    assert 184 <= sum(low <= 0 <= high for low, high in intervals) <= 196


def test_over_slices_of_one_seed_it_is_a_plain_bootstrap():
    values = RNG(2).normal(0.5, 1, 60)
    found = interval_over_slices([values], ["a"])
    assert found == pytest.approx(tuple(bootstrap(values, 0.95)), abs=0.03)


def test_seeds_at_the_same_pairs_draw_the_same_ones():
    rng = RNG(3)
    shared = rng.normal(0, 1, 50)
    low, high = interval_over_slices([shared] * 8, ["a"] * 8)
    others = interval_over_slices([rng.permutation(shared) for _ in range(8)], [f"{seed}" for seed in range(8)])
    # Pairs alone would give √8; seeds are drawn as well, which doubles the variance of eight that differ.
    assert (high - low) / (others[1] - others[0]) == pytest.approx(2, rel=0.15)


@pytest.mark.parametrize("count", [2, 3, 9])
def test_paired_differences_have_student_s_interval_and_chance(count):
    values = RNG(count).normal(0.5, 1, count)
    expected = stats.ttest_1samp(values, 0)
    reach, chance = student(values)
    assert chance == pytest.approx(expected.pvalue)
    interval = expected.confidence_interval(0.95)
    assert (values.mean() - reach, values.mean() + reach) == pytest.approx((interval.low, interval.high))
    assert chance_if_equal(values) == (chance if count > 2 else 1.0)  # two say nothing about others
    assert student(np.ones(count)) == (0.0, 0.0)
    assert student(np.zeros(count)) == (0.0, 1.0)


def test_holm_tells_apart_what_closed_testing_by_bonferroni_does():
    """A codec is told apart if each set of codecs with it has a chance that Bonferroni's limit of that set rejects."""
    for chances in RNG(5).uniform(0, 0.06, (50, 4)):
        sets = [[i for i in range(4) if number >> i & 1] for number in range(1, 16)]
        rejected = [min(chances[each]) <= ALPHA / len(each) for each in sets]
        closed = [all(no for no, each in zip(rejected, sets, strict=True) if codec in each) for codec in range(4)]
        assert told_by_holm(chances.tolist()) == closed
    assert told_by_holm([math.nan, 0.01]) == [False, True]
    assert told_by_holm([]) == []


def test_ranks_are_means_over_materials_and_ties_share_their_places():
    scores = RNG(6).integers(0, 4, (5, 30)).astype(float)
    expected = stats.rankdata(-scores, axis=0).mean(1)
    assert mean_ranks(scores) == pytest.approx(expected)
    assert mean_ranks(scores + RNG(7).uniform(0, 0.004, scores.shape), same=0.005) == pytest.approx(expected)
    assert mean_ranks(np.array([[math.inf], [1.0], [math.inf]])).tolist() == [1.5, 3.0, 1.5]


def test_friedman_s_statistic_is_that_of_the_mean_ranks():
    scores = RNG(8).normal(size=(4, 15))
    statistic = 12 * 15 / (4 * 5) * ((mean_ranks(scores) - 2.5) ** 2).sum()
    assert statistic == pytest.approx(stats.friedmanchisquare(*scores).statistic)


@pytest.mark.parametrize(("codecs", "materials", "quantile"), [(4, 14, 2.569), (5, 30, 2.728), (10, 14, 3.164)])
def test_the_critical_difference_is_that_of_the_paper_s_table(codecs, materials, quantile):
    """Table 5(a) of Demšar (2006) lists q; its example of four learners on fourteen data sets has 1.25."""
    expected = quantile * (codecs * (codecs + 1) / (6 * materials)) ** 0.5
    assert critical_difference(codecs, materials) == pytest.approx(expected, rel=2e-4)
