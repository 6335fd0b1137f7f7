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
seeds = st.integers(0, 2**32 - 1)


@pytest.mark.parametrize("ppd", PPDS)
@settings(derandomize=True, max_examples=25, deadline=None)
@given(seeds, sizes, sizes, st.sampled_from(sorted(CURVES)), st.booleans())
def test_every_texel_agrees_with_the_oracle(ppd, seed, height, width, curve, flat):
    reference, test = textured(seed, height, width)
    if flat:
        reference, test = (np.zeros_like(picture) + picture[0, 0] for picture in (reference, test))
    theirs, _ = oracle(reference, test, ppd=ppd, tonemapper=curve)
    tolerance = FLAT_PICTURE if flat or height * width == 1 else TEXTURED
    np.testing.assert_allclose(flip_map(CURVES[curve](ppd), reference, test), theirs, rtol=0, atol=tolerance)


@pytest.mark.parametrize(("stop", "count"), [(1.5, 7), (-4.9, 2), (-3.0, 2), (-2.99, 3)])
@pytest.mark.parametrize("curve", sorted(CURVES))
def test_a_fixed_range_agrees_with_the_oracle(curve, stop, count):
    reference, test = textured(0, 48, 64)
    metric = CURVES[curve](start=-5.0, stop=stop)
    steps = Range(-5.0, stop).steps()
    assert (len(steps), steps[0], steps[-1]) == (count, -5, stop)
    theirs, used = oracle(reference, test, tonemapper=curve, startExposure=-5.0, stopExposure=stop)
    assert used["numExposures"] == count
    np.testing.assert_allclose(flip_map(metric, reference, test), theirs, rtol=0, atol=TEXTURED)
    bright = np.full((5, 5, 3), 1e30, np.float32)  # beyond every display
    assert metric.score(metric.prepare(bright, 1.0), bright * 2) == 0


def test_a_reference_that_is_mostly_black_needs_a_range():
    reference, test = textured(0, 48, 64)
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
    with pytest.raises(InputError, match="stack"):
        HDR().prepare(stack, 1.0)
    assert metric.score(metric.prepare(stack, 1.0), stack).tolist() == [0, 0]


@pytest.mark.parametrize(("start", "stop"), [(1.0, 0.0), (None, 0.0), (0.0, None), (np.nan, 0.0), (0.0, np.inf)])
def test_start_and_stop_go_together_and_in_order(start, stop):
    with pytest.raises(InputError, match="start"):
        HDR(start=start, stop=stop)
