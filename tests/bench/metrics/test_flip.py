import flip_evaluator
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.inputs.errors import InputError
from bench.metrics.display import decode_srgb
from bench.metrics.flip import HDR, LDR, PPD, Hable, Range, Reinhard

PPDS = (20.0, PPD, 120.0)
CURVES = {"aces": HDR, "hable": Hable, "reinhard": Reinhard}
COLOURS = {"black": (0, 0, 0), "white": (1, 1, 1), "red": (1, 0, 0), "green": (0, 1, 0), "blue": (0, 0, 1)}
# Float32 inside the oracle: the 0.7 power lifts its rounding where a difference is small, and on flat pictures the
# rounding of filters that should give 0 passes through a square root.
TEXTURED, FLAT_PICTURE = 2e-5, 2e-4


def flip_map(metric, reference, test):
    return metric.error_map(metric.prepare(reference, 1.0), test)


def oracle(reference, test, **parameters):
    """NVIDIA's own implementation: of HDR where a curve is named."""
    kind = "HDR" if "tonemapper" in parameters else "LDR"
    pictures = (np.ascontiguousarray(picture, np.float32) for picture in (reference, test))
    options = {"applyMagma": False, "computeMeanError": False, "parameters": parameters}
    theirs, _, used = flip_evaluator.evaluate(*pictures, kind, **options)
    return theirs[..., 0], used


def textured(seed, height, width):
    """sRGB codes of a picture and of a noisier one."""
    rng = np.random.default_rng(seed)
    reference = rng.random((height, width, 3), dtype=np.float32)
    noise = rng.standard_normal(reference.shape, dtype=np.float32)
    return reference, np.clip(reference + np.float32(10 ** rng.uniform(-2.5, 0)) * noise, 0, 1)


def bright(seed, height, width):
    """Radiance far above 1, and with noise."""
    rng = np.random.default_rng(seed)
    noise = 1 + np.float32(10 ** rng.uniform(-2, 0)) * rng.standard_normal((height, width, 3), dtype=np.float32)
    reference = 30 * rng.random((height, width, 3), dtype=np.float32) ** 3 + np.float32(0.01)
    return reference, reference * np.abs(noise)


sizes = st.integers(1, 45)


@pytest.mark.parametrize("ppd", PPDS)
@pytest.mark.parametrize("hdr", [False, True])
@settings(derandomize=True, max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), sizes, sizes, st.sampled_from(sorted(CURVES)), st.booleans())
def test_every_texel_agrees_with_the_oracle(ppd, hdr, seed, height, width, curve, flat):
    pictures = bright(seed, height, width) if hdr else textured(seed, height, width)
    if flat:
        pictures = [np.zeros_like(picture) + picture[0, 0] for picture in pictures]
    theirs, _ = oracle(*pictures, ppd=ppd, **({"tonemapper": curve} if hdr else {}))
    ours = flip_map(CURVES[curve](ppd), *pictures) if hdr else flip_map(LDR(ppd), *map(decode_srgb, pictures))
    tolerance = FLAT_PICTURE if flat or height * width == 1 else TEXTURED
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=tolerance)


@pytest.mark.parametrize(
    ("one", "other", "mean"),
    [("black", "white", 0.96738), ("green", "blue", 1.0), ("red", "green", 0.98666), ("black", "blue", 0.95833)],
)
def test_flat_colours(one, other, mean):
    pictures = (np.zeros((6, 7, 3)) + COLOURS[name] for name in (one, other))
    np.testing.assert_allclose(flip_map(LDR(), *pictures), mean, atol=5e-6)


@pytest.mark.parametrize("ppd", PPDS)
@pytest.mark.parametrize(("height", "width"), [(40, 33), (12, 5), (3, 1)])
def test_the_periodic_variant_is_flip_of_the_wrap_padded_picture(ppd, height, width):
    pictures = textured(0, height, width)
    radius = 20  # of the widest filter, at 120 pixels per degree: 17
    pad = ((radius, radius), (radius, radius), (0, 0))
    padded = oracle(*(np.pad(picture, pad, "wrap") for picture in pictures), ppd=ppd)[0]
    ours = flip_map(LDR(ppd, periodic=True), *map(decode_srgb, pictures))
    np.testing.assert_allclose(ours, padded[radius:-radius, radius:-radius], rtol=0, atol=TEXTURED)


def test_exposure_scales_before_the_clip():
    reference, test = (decode_srgb(picture) for picture in textured(0, 20, 30))
    metric = LDR()
    scaled = metric.score(metric.prepare(reference * 4, 0.25), test * 4)
    assert scaled == pytest.approx(metric.score(metric.prepare(reference, 1.0), test), abs=5e-8)


@pytest.mark.parametrize(("stop", "count"), [(1.5, 7), (-4.9, 2), (-3.0, 2), (-2.99, 3)])
@pytest.mark.parametrize("curve", sorted(CURVES))
def test_a_fixed_range_agrees_with_the_oracle(curve, stop, count):
    reference, test = bright(0, 48, 64)
    metric = CURVES[curve](start=-5.0, stop=stop)
    steps = Range(-5.0, stop).steps()
    assert (len(steps), steps[0], steps[-1]) == (count, -5, stop)
    theirs, used = oracle(reference, test, tonemapper=curve, startExposure=-5.0, stopExposure=stop)
    assert used["numExposures"] == count
    np.testing.assert_allclose(flip_map(metric, reference, test), theirs, rtol=0, atol=TEXTURED)
    beyond = np.full((5, 5, 3), 1e30, np.float32)  # every display
    assert metric.score(metric.prepare(beyond, 1.0), beyond * 2) == 0


def test_a_reference_that_is_mostly_black_needs_a_range():
    reference, test = bright(0, 48, 64)
    metric = HDR(start=-3.0, stop=0.0)
    for black in (np.where(np.arange(48)[:, None, None] < 30, 0, reference), np.zeros_like(reference)):
        with pytest.raises(InputError, match=r"black.*start.*stop"):
            HDR().prepare(black, 1.0)
        assert 0 < metric.score(metric.prepare(black, 1.0), test) <= 1
        assert metric.score(metric.prepare(black, 1.0), black) == 0


def test_a_reference_that_is_half_black_has_a_range():
    HDR().prepare(np.repeat([0.0, 1.0], 8 * 3).reshape(4, 4, 3), 1.0)


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


@pytest.mark.parametrize("ppd", [0.0, -3.0, np.nan, np.inf])
def test_pixels_per_degree_must_be_positive(ppd):
    with pytest.raises(InputError, match="ppd"):
        LDR(ppd)


@pytest.mark.parametrize(("start", "stop"), [(1.0, 0.0), (None, 0.0), (0.0, None), (np.nan, 0.0), (0.0, np.inf)])
def test_start_and_stop_go_together_and_in_order(start, stop):
    with pytest.raises(InputError, match="start"):
        HDR(start=start, stop=stop)
