"""The exposure of a material, the display transform, and the log curve."""

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from bench.btf import BTF, Array
from bench.records import MOST_DB

LUMA = np.array([0.2126, 0.7152, 0.0722])  # Rec. 709, as the primaries of every BTF here
LOG_SCALE = 8.0  # of log1p(8 · exposure · x), the curve that learned codecs predict

MOST_OF_BLACK = 20.0  # dB: a material on which an all-black answer scores more is badly exposed
LEAST_CODE = 40  # of 255: one whose median slice has a lower mean display code is, too
SAMPLE_VALUES = 1_000_000  # number of values that the exposure is computed from
SAMPLE_SLICES = 1_000  # the most slices that they are of


def exposure_of(slices: Array) -> float:
    """The exposure of a material from the radiance of slices, (slices, …), or of a sample of each; of one picture, from
    `picture[None]`.

    It is 0.8 over the 90th percentile, over slices, of a slice's 99th percentile: so neither a few mirror pairs nor a
    few bright texels own it. If that is 0, it is 0.8 over the maximum; if that is 0 too, 1. Negative values count as 0.
    """
    values = np.maximum(slices, 0).reshape(len(slices), -1)
    bright_of_slices = np.percentile(values, 99, axis=1)
    bright = float(np.percentile(bright_of_slices, 90))
    if bright == 0:
        bright = float(values.max())
    return 0.8 / bright if bright > 0 else 1.0


def sample(btf: BTF, seed: int = 0) -> Array:
    """A seeded sample (slices, n, 3) of linear radiance: n texels of each slice, or of each of `SAMPLE_SLICES` if there
    are more; about 1 M values in all. All values if there are fewer."""
    height, width = btf.shape
    if len(btf) * height * width * 3 <= SAMPLE_VALUES:
        return np.stack([picture.reshape(-1, 3) for picture in btf])
    rng = np.random.default_rng(seed)
    slices = min(len(btf), SAMPLE_SLICES)
    texels = math.ceil(SAMPLE_VALUES / 3 / slices)  # of each slice, drawn anew for each
    pair = rng.choice(len(btf), slices, replace=False)
    row = rng.integers(0, height, (slices, texels))
    col = rng.integers(0, width, (slices, texels))
    values = btf.gather(np.repeat(pair, texels), row.ravel(), col.ravel())
    return values.reshape(slices, texels, 3)


def exposure(btf: BTF, seed: int = 0) -> float:
    """The exposure of a material, from `sample`; see `exposure_of`."""
    return exposure_of(sample(btf, seed))


class Exposed(NamedTuple):
    """How well an exposure shows some slices."""

    exposure: float
    code: float  # the median over slices of their mean display code, of 255
    black: float  # the display PSNR of an all-black answer, in dB, mean over slices

    @property
    def fault(self) -> str:
        """A sentence if nearly all is dark, so that scores tell codecs hardly apart; "" if all is well."""
        if self.black > MOST_OF_BLACK:
            return f"black scores {self.black:.0f} dB at this exposure, {self.exposure:.3g}: nearly all slices are dark"
        if self.code < LEAST_CODE:
            shown = f"the median slice has a mean code of {self.code:.0f} of 255 at this exposure, {self.exposure:.3g}"
            return f"{shown}: it is dark, so decibels are high"
        return ""


def exposed(slices: Iterable[Array], exposure: float) -> Exposed:
    """How well an exposure shows slices, each linear radiance of any shape."""
    codes = []
    scores = []  # dB of an all-black answer
    for values in slices:
        display = to_display(values, exposure)
        codes.append(255 * display.mean())
        error = max(float(np.square(display).mean()), 1e-10)  # 0 has no logarithm
        scores.append(min(MOST_DB, -10 * math.log10(error)))
    return Exposed(exposure, float(np.median(codes)), float(np.mean(scores)))


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
    light = np.multiply(radiance, exposure, dtype=np.float64)
    return encode_srgb(np.clip(light, 0, 1))


def display_error(radiance: Array, other: Array, exposure: float) -> float:
    """The mean squared difference of two pictures of equal shape after the display transform."""
    return float(np.square(to_display(radiance, exposure) - to_display(other, exposure)).mean())


def to_log1p(radiance: Array, exposure: float) -> Array:
    """log1p(8 · exposure · radiance), negative radiance counting as 0; any shape, float64."""
    scaled = np.multiply(radiance, LOG_SCALE * exposure, dtype=np.float64)
    return np.log1p(np.maximum(scaled, 0))
