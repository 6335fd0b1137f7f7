"""Curves of quality over bytes: their hull, what is read off them, and differences at equal bytes and at equal dB."""

import numpy as np
import pytest

from bench.compare.choosing.budgets import budgets
from bench.compare.choosing.curves import (
    DRAWS,
    Curve,
    bd_psnr,
    bd_rate,
    curve_of,
    differences,
    hulls,
    summarised,
)
from bench.records import FLIP, MOST_DB, PSNR
from tests.bench.compare.choosing.test_budgets import SIDE, job, run_of

OURS = Curve([2.0, 3.0, 5.0], [20.0, 26.0, 30.0])
THEIRS = Curve([1.0, 4.0, 6.0], [15.0, 27.0, 29.0])


def at_bits(label, bits, validation, test, **more):
    return job(label, round(bits * SIDE * SIDE / 8), validation, test, **more)


def points_of(run, line, material="satin"):
    return hulls(budgets(run), [material])[line][material]


def test_a_curve_has_the_rungs_on_the_hull_of_validation_pairs_with_their_scores_of_test_pairs(tmp_path):
    run = run_of(
        tmp_path / "run",
        at_bits("a x=1", 4, 20.0, 19.0),
        at_bits("a x=2", 8, 21.0, 99.0),  # below the line from 4 to 16 bits, whatever test pairs say
        at_bits("a x=3", 16, 30.0, 28.0),
        at_bits("a x=4", 32, 29.0, 99.0),  # larger and worse
        at_bits("a x=5", 64, 31.0, 30.5),
        at_bits("b x=1", 4, 20.0, 19.0),
        at_bits("b x=2", 8, 21.0, 20.0),  # two rungs are no curve
    )
    assert list(hulls(budgets(run), ["satin"])) == ["a"]
    curve = curve_of(points_of(run, "a"))
    assert curve.sizes == pytest.approx([2, 4, 6])
    assert curve.values == [19.0, 28.0, 30.5]


def test_a_curve_goes_on_level_from_its_best_rung_to_the_largest(tmp_path):
    """A file of 16 bits may be used where 32 are allowed; beyond the largest rung nothing is known."""
    run = run_of(
        tmp_path / "run",
        at_bits("a x=1", 4, 20.0, 19.0),
        at_bits("a x=2", 16, 30.0, 28.0),
        at_bits("a x=3", 32, 29.0, 27.0),
    )
    points = points_of(run, "a")
    curve = curve_of(points)
    assert curve.sizes == pytest.approx([2, 4, 5])
    assert curve.values == [19.0, 28.0, 28.0]
    assert curve.at(32) == 28.0
    assert curve.at(33) is None
    # Bytes that gain nothing do not count as bytes that a quality takes.
    assert bd_rate(curve, curve) == 0
    assert bd_rate(Curve([2, 4, 5], [19.0, 28.0, 28.0]), Curve([3, 5, 6], [19.0, 28.0, 28.0])) == pytest.approx(-0.5)


def test_a_curve_is_linear_over_log_bytes_and_never_extrapolated():
    assert OURS.at(4) == 20.0
    assert OURS.at(2**2.5) == pytest.approx(23.0)
    assert OURS.at(32) == 30.0
    assert OURS.at(3.99) is None
    assert OURS.at(33) is None


def test_seeds_count_by_their_mean(tmp_path):
    rungs = ((4, 20.0, 40.0), (8, 24.0, 56.0), (16, 26.0, 60.0))
    jobs = [at_bits(f"a x={bits}", bits, validation, test) for bits, validation, test in rungs]
    jobs.append(at_bits("a x=4", 4, 20.0, 44.0, seed=1))
    run = run_of(tmp_path / "run", *jobs)
    points = points_of(run, "a")
    curve = curve_of(points)
    assert curve.values == [42.0, 56.0, 60.0]
    assert [curve.at(bits) for bits in (4, 8, 16)] == [42.0, 56.0, 60.0]
    assert curve_of(points, FLIP) is None  # a metric that a job lacks
    drawn = {curve_of(points, PSNR, np.random.default_rng(seed)).values[0] for seed in range(30)}
    assert drawn == {40.0, 42.0, 44.0}


def test_differences_are_means_over_what_both_curves_reach():
    """Against sums over a fine grid: of dB from 4 to 32 bits, and of log bytes from 20 to 29 dB."""
    sizes = np.linspace(2, 5, 300_001)
    gap = np.interp(sizes, OURS.sizes, OURS.values) - np.interp(sizes, THEIRS.sizes, THEIRS.values)
    assert bd_psnr(OURS, THEIRS) == pytest.approx(gap.mean(), abs=1e-4)
    assert bd_psnr(THEIRS, OURS) == pytest.approx(-bd_psnr(OURS, THEIRS))
    values = np.linspace(20, 29, 300_001)
    gap = np.interp(values, OURS.values, OURS.sizes) - np.interp(values, THEIRS.values, THEIRS.sizes)
    assert bd_rate(OURS, THEIRS) == pytest.approx(2 ** gap.mean() - 1, abs=1e-4)


def test_a_curve_that_is_higher_or_half_as_large_everywhere_is_so_by_that():
    higher = Curve(OURS.sizes, [value + 1.5 for value in OURS.values])
    assert bd_psnr(higher, OURS) == pytest.approx(1.5)
    halved = Curve([size - 1 for size in OURS.sizes], OURS.values)
    assert bd_rate(halved, OURS) == pytest.approx(-0.5)
    dips = Curve([2.0, 3.0, 4.0, 5.0], [20.0, 26.0, 25.0, 30.0])  # test pairs may fall where validation pairs rise
    assert bd_rate(dips, dips) == pytest.approx(0.0)
    # Where a curve dips, its bytes jump at one height: the mean over heights, read between them, is the oracle.
    dips = Curve([0.0, 1.0, 2.0, 3.0], [28.0, 30.0, 29.9, 35.0])
    heights = np.arange(28.0005, 35.0, 0.001)
    ours = np.interp(heights, [28.0, 30.0, 30.0, 35.0], dips.sizes)
    theirs = np.interp(heights, [28.0, 35.0], [0.0, 3.0])
    expected = 2 ** (ours - theirs).mean() - 1
    assert bd_rate(dips, Curve([0.0, 3.0], [28.0, 35.0])) == pytest.approx(expected, abs=1e-4)
    far = Curve([7.0, 8.0], [40.0, 41.0])
    assert bd_psnr(far, OURS) is None
    # No file of the lower curve is as good as the smallest of the higher.
    assert (bd_rate(far, OURS), bd_rate(OURS, far)) == (-1.0, float("inf"))
    at_the_limit = Curve([2.0, 3.0], [MOST_DB, MOST_DB])
    assert bd_rate(at_the_limit, at_the_limit) is None  # level at one value, which says nothing of bytes


def test_a_summary_has_an_interval_over_surfaces_and_tells_apart_only_with_enough_of_them(tmp_path):
    steady = {str(number): [1.0] * (1 + DRAWS) for number in range(12)}
    found = summarised(steady)
    assert found[:4] == (1.0, 1.0, 12, 12)
    assert (found.low, found.high) == (1.0, 1.0)
    assert found.apart
    assert not summarised(dict(list(steady.items())[:9])).apart
    mixed = {str(number): [float(number % 2) - 0.4] * (1 + DRAWS) for number in range(12)}
    found = summarised(mixed)
    assert found.low < 0 < found.high
    assert not found.apart
    # Student's t of 11 degrees of freedom is 2.2, of the standard error 0.52 / √12. Means of 12 such values have steps
    # of 1/12.
    assert found.high - found.mean == pytest.approx(2.2 * 0.52 / 12**0.5, abs=1 / 24)
    assert found.won == 6


def test_the_interval_holds_the_truth_of_ten_surfaces_in_19_of_20_cases():
    """Percentiles of 2.5 and 97.5 of drawn means would in 178 of 200."""
    rng = np.random.default_rng(0)
    held = 0
    for _ in range(200):
        found = summarised({str(number): [value, value] for number, value in enumerate(rng.standard_normal(10))})
        held += found.low <= 0 <= found.high
    assert 184 <= held <= 196


def test_the_interval_of_one_surface_comes_from_draws_of_its_seeds(tmp_path):
    jobs = []
    for bits in (4, 8, 16):
        jobs += [at_bits(f"a x={bits}", bits, 20.0 + bits, 30.0)]
        jobs += [at_bits(f"b x={bits}", bits, 20.0 + bits, 30.0 + seed, seed=seed) for seed in (0, 2)]
    found = hulls(budgets(run_of(tmp_path / "run", *jobs)), ["satin"])
    gaps = differences(found["b"], found["a"])["satin"]
    assert gaps[0] == pytest.approx(1.0)
    assert len(gaps) == 1 + DRAWS
    assert (min(gaps), max(gaps)) == pytest.approx((0.0, 2.0))
    summary = summarised({"satin": gaps})
    assert summary.low < summary.mean < summary.high
