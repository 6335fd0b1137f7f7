"""HDR FLIP against NVIDIA's own implementation, and the range of exposures."""

import flip_evaluator
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.errors import InputError
from bench.metrics.flip import PPD
from bench.metrics.flip_hdr import HDR, Hable, Range, Reinhard

PPDS = (20.0, PPD, 120.0)
CURVES = {"aces": HDR, "hable": Hable, "reinhard": Reinhard}
TEXTURED, FLAT_PICTURE = 2e-5, 2e-4  # as for LDR: float32 inside the oracle


def golden():
    u, v = np.meshgrid(np.arange(64) / 63, np.arange(48) / 47)
    reference = np.stack([u, v, 0.5 + 0.5 * np.sin(12 * np.pi * u * v)], -1)
    test = np.stack([u**1.2, v, 0.5 + 0.5 * np.sin(12 * np.pi * u * v + 0.4)], -1)
    return [20 * picture.astype(np.float32) ** 2 + np.float32(0.01) for picture in (reference, test)]


def textured(seed, height, width):
    rng = np.random.default_rng(seed)
    noise = 1 + np.float32(10 ** rng.uniform(-2, 0)) * rng.standard_normal((height, width, 3), dtype=np.float32)
    reference = 30 * rng.random((height, width, 3), dtype=np.float32) ** 3 + np.float32(0.01)
    return reference, reference * np.abs(noise)


def oracle(reference, test, **parameters):
    theirs, _, used = flip_evaluator.evaluate(
        reference, test, "HDR", applyMagma=False, computeMeanError=False, parameters=parameters
    )
    return theirs[..., 0], used


def flip_map(metric, reference, test):
    return metric.error_map(metric.prepare(reference, 1.0), test)


sizes = st.integers(1, 35)
broad = st.integers(2, 35)  # a picture of one texel is flat
seeds = st.integers(0, 2**32 - 1)


@pytest.mark.parametrize("ppd", PPDS)
@settings(derandomize=True, max_examples=20, deadline=None)
@given(seeds, broad, broad, st.sampled_from(sorted(CURVES)))
def test_every_texel_agrees_with_the_oracle(ppd, seed, height, width, curve):
    reference, test = textured(seed, height, width)
    theirs, _ = oracle(reference, test, ppd=ppd, tonemapper=curve)
    np.testing.assert_allclose(flip_map(CURVES[curve](ppd), reference, test), theirs, rtol=0, atol=TEXTURED)


@pytest.mark.parametrize("ppd", PPDS)
@settings(derandomize=True, max_examples=10, deadline=None)
@given(seeds, sizes, sizes)
def test_every_texel_of_flat_pictures_agrees_with_the_oracle(ppd, seed, height, width):
    colours = np.random.default_rng(seed).uniform(0.01, 20, (2, 3)).astype(np.float32)
    reference, test = (np.zeros((height, width, 3), np.float32) + colour for colour in colours)
    theirs, _ = oracle(reference, test, ppd=ppd)
    np.testing.assert_allclose(flip_map(HDR(ppd), reference, test), theirs, rtol=0, atol=FLAT_PICTURE)


@pytest.mark.parametrize("curve", sorted(CURVES))
def test_a_fixed_range_agrees_with_the_oracle(curve):
    reference, test = golden()
    theirs, used = oracle(reference, test, tonemapper=curve, startExposure=-5.0, stopExposure=1.5)
    assert used["numExposures"] == 7
    metric = CURVES[curve](start=-5.0, stop=1.5)
    np.testing.assert_allclose(flip_map(metric, reference, test), theirs, rtol=0, atol=TEXTURED)


def test_golden_mean_and_range():
    reference, test = golden()
    metric = HDR()
    state = metric.prepare(reference, 1.0)
    np.testing.assert_allclose(state.side[0], [-3.164224, -1.411208], atol=2e-6)
    assert metric.score(state, test) == pytest.approx(0.2344757, abs=1e-7)


@pytest.mark.parametrize(("curve", "root"), [("aces", 2.1188723), ("hable", 3.1277493), ("reinhard", 5.6666667)])
def test_the_radiance_that_maps_to_0_85(curve, root):
    exposures = CURVES[curve]().range_of(np.array([1.0, 1.0]))
    assert 2**exposures.start == pytest.approx(root, abs=5e-8)


def test_the_range_uses_the_upper_median_and_the_maximum():
    exposures = HDR().range_of(np.array([4.0, 1, 2, 8]))
    assert exposures.stop - exposures.start == pytest.approx(1)  # log2(8 / 4)


@pytest.mark.parametrize(("width", "count"), [(0.0, 2), (1.5, 2), (2.0, 2), (2.01, 3), (6.5, 7)])
def test_one_exposure_a_stop_and_two_at_least(width, count):
    steps = Range(-1.0, -1.0 + width).steps()
    assert len(steps) == count
    assert steps[0] == -1
    assert steps[-1] == -1 + width


def test_a_reference_that_is_mostly_black_needs_a_range():
    reference, test = golden()
    dark = reference.copy()
    dark[:30] = 0
    for black in (dark, np.zeros_like(reference)):
        with pytest.raises(InputError, match=r"reference is black.*start and stop"):
            HDR().prepare(black, 1.0)
        metric = HDR(start=-3.0, stop=0.0)
        error = metric.score(metric.prepare(black, 1.0), test)
        assert 0 < error <= 1
        assert metric.score(metric.prepare(black, 1.0), black) == 0


def test_a_material_fixes_one_range_for_all_its_slices():
    rng = np.random.default_rng(0)
    sample = np.concatenate([np.zeros((900, 3)), rng.random((100, 3)) + 0.5])
    metric = HDR(120.0, periodic=True).for_material(sample)
    assert metric.range == HDR().range_of(np.maximum(sample[900:], 0) @ [0.2126, 0.7152, 0.0722])
    assert (metric.ppd, metric.periodic) == (120.0, True)
    assert Hable().for_material(np.zeros((5, 3))).range == (0, 0)
    stack = rng.random((2, 9, 9, 3))
    assert metric.score(metric.prepare(stack, 1.0), stack).tolist() == [0, 0]


def test_a_stack_without_a_range_is_refused():
    with pytest.raises(InputError, match="stack"):
        HDR().prepare(np.ones((2, 9, 9, 3)), 1.0)


@pytest.mark.parametrize(("start", "stop"), [(1.0, 0.0), (None, 0.0), (0.0, None), (np.nan, 0.0), (0.0, np.inf)])
def test_start_and_stop_go_together_and_in_order(start, stop):
    with pytest.raises(InputError, match="start"):
        HDR(start=start, stop=stop)


def test_radiance_beyond_every_display_stays_finite():
    bright = np.full((5, 5, 3), 1e30, np.float32)
    for curve in CURVES.values():
        metric = curve(start=-2.0, stop=8.0)
        assert metric.score(metric.prepare(bright, 1.0), bright * 2) == 0
