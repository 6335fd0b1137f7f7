import flip_evaluator
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.errors import InputError
from bench.metrics.display import decode_srgb
from bench.metrics.flip import LDR, PPD

PPDS = (20.0, PPD, 120.0)
COLOURS = {"black": (0, 0, 0), "white": (1, 1, 1), "red": (1, 0, 0), "green": (0, 1, 0), "blue": (0, 0, 1)}
FLAT = {name: np.zeros((6, 7, 3)) + rgb for name, rgb in COLOURS.items()}
# Float32 inside the oracle: the 0.7 power lifts its rounding where a difference is small, and on flat pictures the
# rounding of filters that should give 0 passes through a square root.
TEXTURED, FLAT_PICTURE = 2e-5, 2e-4


def flip_map(reference, test, ppd=PPD, periodic=False):
    metric = LDR(ppd, periodic)
    return metric.error_map(metric.prepare(decode_srgb(reference), 1.0), decode_srgb(test))


def oracle(reference, test, ppd=PPD):
    pictures = (np.ascontiguousarray(picture, np.float32) for picture in (reference, test))
    options = {"applyMagma": False, "computeMeanError": False, "parameters": {"ppd": ppd}}
    return flip_evaluator.evaluate(*pictures, "LDR", **options)[0][..., 0]


def textured(seed, height, width):
    rng = np.random.default_rng(seed)
    reference = rng.random((height, width, 3), dtype=np.float32)
    noise = rng.standard_normal(reference.shape, dtype=np.float32)
    return reference, np.clip(reference + np.float32(10 ** rng.uniform(-2.5, 0)) * noise, 0, 1)


sizes = st.integers(1, 45)
seeds = st.integers(0, 2**32 - 1)


@pytest.mark.parametrize("ppd", PPDS)
@settings(derandomize=True, max_examples=25, deadline=None)
@given(seeds, sizes, sizes, st.booleans())
def test_every_texel_agrees_with_the_oracle(ppd, seed, height, width, flat):
    reference, test = textured(seed, height, width)
    if flat:
        reference, test = (np.zeros_like(picture) + picture[0, 0] for picture in (reference, test))
    tolerance = FLAT_PICTURE if flat or height * width == 1 else TEXTURED
    np.testing.assert_allclose(flip_map(reference, test, ppd), oracle(reference, test, ppd), rtol=0, atol=tolerance)


@pytest.mark.parametrize(
    ("one", "other", "mean"),
    [("black", "white", 0.96738), ("green", "blue", 1.0), ("red", "green", 0.98666), ("black", "blue", 0.95833)],
)
def test_flat_colours(one, other, mean):
    np.testing.assert_allclose(flip_map(FLAT[one], FLAT[other]), mean, atol=5e-6)


@pytest.mark.parametrize("ppd", PPDS)
@pytest.mark.parametrize(("height", "width"), [(40, 33), (12, 5), (3, 1)])
def test_the_periodic_variant_is_flip_of_the_wrap_padded_picture(ppd, height, width):
    reference, test = textured(0, height, width)
    radius = 20  # of the widest filter, at 120 pixels per degree: 17
    pad = ((radius, radius), (radius, radius), (0, 0))
    padded = oracle(np.pad(reference, pad, "wrap"), np.pad(test, pad, "wrap"), ppd)[radius:-radius, radius:-radius]
    np.testing.assert_allclose(flip_map(reference, test, ppd, periodic=True), padded, rtol=0, atol=TEXTURED)


def test_exposure_scales_before_the_clip():
    reference, test = (decode_srgb(picture) for picture in textured(0, 20, 30))
    metric = LDR()
    scaled = metric.score(metric.prepare(reference * 4, 0.25), test * 4)
    assert scaled == pytest.approx(metric.score(metric.prepare(reference, 1.0), test), abs=5e-8)


@pytest.mark.parametrize("ppd", [0.0, -3.0, np.nan, np.inf])
def test_pixels_per_degree_must_be_positive(ppd):
    with pytest.raises(InputError, match="ppd"):
        LDR(ppd)
