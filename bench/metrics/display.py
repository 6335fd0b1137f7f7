"""The exposure of a material, the display transform, and the log curve."""

import math
from collections.abc import Iterable

import numpy as np

from bench.btf import BTF, Array

LUMA = np.array([0.2126, 0.7152, 0.0722])  # Rec. 709, as the primaries of every BTF here
LOG_SCALE = 8.0  # of log1p(8 · exposure · x), the curve that learned codecs predict

MOST_OF_BLACK = 20.0  # dB: a material on which an all-black answer scores more is badly exposed
SAMPLE_VALUES = 1_000_000  # number of values that the exposure is computed from


def exposure_of(values: Array) -> float:
    """The exposure of a material from a sample of its radiance, of any shape. It is 0.8 over the 99th percentile; if
    that is 0, over the maximum; if that is 0 too, 1. Negative values count as 0."""
    values = np.maximum(values, 0)
    bright = float(np.percentile(values, 99))
    if bright == 0:
        bright = float(values.max())
    return 0.8 / bright if bright > 0 else 1.0


def sample(btf: BTF, seed: int = 0) -> Array:
    """A seeded sample (n, 3) of linear radiance: about 1 M values over all pairs, or all if there are fewer."""
    height, width = btf.shape
    if len(btf) * height * width * 3 <= SAMPLE_VALUES:
        return np.concatenate([picture.reshape(-1, 3) for picture in btf])
    rng = np.random.default_rng(seed)
    count = math.ceil(SAMPLE_VALUES / 3)  # of three values each, rounded up
    pair = rng.integers(0, len(btf), count)
    row = rng.integers(0, height, count)
    col = rng.integers(0, width, count)
    return btf.gather(pair, row, col)


def exposure(btf: BTF, seed: int = 0) -> float:
    """The exposure of a material: 0.8 over the 99th percentile of `sample`; see `exposure_of`."""
    return exposure_of(sample(btf, seed))


def black_fault(pictures: Iterable[Array], exposure: float) -> str:
    """A sentence where an all-black answer is better than `MOST_OF_BLACK` dB over slices, each of any shape; else "".

    Then a few bright pairs own the exposure, all others are nearly black, and scores tell codecs hardly apart.
    """
    errors = [max(display_error(picture, np.zeros_like(picture), exposure), 1e-10) for picture in pictures]
    black = float(np.mean([-10 * math.log10(error) for error in errors]))
    if black <= MOST_OF_BLACK:
        return ""
    return f"black scores {black:.0f} dB at this exposure, {exposure:.3g}: a few bright pairs own it, others are dark"


def encode_srgb(linear: Array) -> Array:
    """Linear values in [0, 1] → sRGB in [0, 1] (IEC 61966-2-1), float64, any shape."""
    encoded = np.power(linear, 1 / 2.4, dtype=np.float64)
    encoded *= 1.055
    encoded -= 0.055
    # Near 0 the curve is a line, which replaces the power.
    np.multiply(linear, 12.92, out=encoded, where=linear <= 0.0031308)
    return encoded


def decode_srgb(encoded: Array) -> Array:
    """sRGB in [0, 1] → linear values in [0, 1] (IEC 61966-2-1), float64, any shape."""
    encoded = np.asarray(encoded, np.float64)
    linear = ((encoded + 0.055) / 1.055) ** 2.4
    # Near 0 the curve is a line, which replaces the power.
    np.divide(encoded, 12.92, out=linear, where=encoded <= 0.04045)
    return linear


def to_display(radiance: Array, exposure: float) -> Array:
    """The display transform: sRGB of exposure × radiance clipped to [0, 1]; any shape, float64."""
    exposed = np.multiply(radiance, exposure, dtype=np.float64)
    return encode_srgb(np.clip(exposed, 0, 1))


def display_error(radiance: Array, other: Array, exposure: float) -> float:
    """The mean squared difference of two pictures of equal shape after the display transform."""
    return float(np.square(to_display(radiance, exposure) - to_display(other, exposure)).mean())


def to_log1p(radiance: Array, exposure: float) -> Array:
    """log1p(8 · exposure · radiance), negative radiance counting as 0; any shape, float64."""
    scaled = np.multiply(radiance, LOG_SCALE * exposure, dtype=np.float64)
    return np.log1p(np.maximum(scaled, 0))
