"""Curves of quality over bytes from records: their rungs, seeds and surfaces."""

import numpy as np
import pytest

from bench.compare.choosing.budgets import budgets
from bench.compare.choosing.curves import (
    DRAWS,
    curve_of,
    differences,
    hulls,
    mean_at,
    summarised,
)
from bench.records import FLIP, PSNR
from tests.bench.compare.choosing.test_budgets import SIDE, job, run_of


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
    by_surface = {"satin": points}
    assert mean_at(by_surface, ["satin"], 32) == 28.0
    assert (
        mean_at(by_surface, ["satin"], 33) is mean_at(by_surface, ["rock"], 32) is mean_at(by_surface, [], 32) is None
    )


def test_seeds_count_by_their_mean(tmp_path):
    rungs = ((4, 20.0, 40.0), (8, 24.0, 56.0), (16, 26.0, 60.0))
    jobs = [at_bits(f"a x={bits}", bits, validation, test) for bits, validation, test in rungs]
    jobs.append(at_bits("a x=4", 4, 20.0, 44.0, seed=1))
    run = run_of(tmp_path / "run", *jobs)
    points = points_of(run, "a")
    curve = curve_of(points)
    assert curve.values == [42.0, 56.0, 60.0]
    assert curve_of(points, FLIP) is None  # a metric that a job lacks
    drawn = {curve_of(points, PSNR, np.random.default_rng(seed)).values[0] for seed in range(30)}
    assert drawn == {40.0, 42.0, 44.0}


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
    assert found.won == 6


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
