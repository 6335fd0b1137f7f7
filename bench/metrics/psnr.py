"""Metrics of the squared error: PSNR in display space and of log1p radiance, and RMSE of linear radiance.

    PSNR = 10 · log10(peak² / MSE)   in dB; higher is better; ∞ if the slices are equal

MSE is the mean over texels and channels. The raw number of a slice is its MSE, so the pooled PSNR, that of the
squared error of all slices together, is exact. A slice counts as at most 48.13 dB, an error of one step of an 8-bit
display, so that exact and black slices do not decide a mean over slices. Source: Gonzalez & Woods, Digital Image
Processing.
"""

import math
from typing import ClassVar

import numpy as np

from bench.btf import Array
from bench.metrics.base import Picture, SliceMetric
from bench.metrics.display import LOG_SCALE
from bench.records import MOST_DB


def psnr(mse: Array | float, peak: float = 1.0) -> Array:
    """Decibels of a mean squared error, of any shape; ∞ where it is 0."""
    mse = np.asarray(mse, np.float64)
    safe = np.where(mse > 0, mse, 1)  # without a logarithm of 0
    # The index () makes a scalar of an array without axes.
    return np.where(mse > 0, 20 * math.log10(peak) - 10 * np.log10(safe), np.inf)[()]


def squared_error(reference: Array, test: Array) -> Array:
    """Mean over channels of the squared difference of two planar pictures (3, ..., H, W) → (..., H, W)."""
    difference = reference - test
    return np.square(difference, out=difference).mean(0)


class SquaredDifference(SliceMetric):
    """A metric of the squared error in one space of a picture: `space` names it."""

    space: ClassVar[str]

    def reference_side(self, reference: Picture) -> Array:
        """The reference (3, ..., H, W) in the metric's space."""
        planes: Array = getattr(reference, self.space)
        return planes

    def compare(self, side: Array, test: Picture) -> Array:
        return squared_error(side, getattr(test, self.space))


class DisplayPSNR(SquaredDifference):
    """PSNR of the display transform of both slices; peak 1."""

    space = "display"
    peak = 1.0

    def values(self, raw: Array) -> Array:
        return np.minimum(psnr(raw, self.peak), MOST_DB)


class LogPSNR(DisplayPSNR):
    """PSNR of log1p(8 · exposure · radiance); peak log1p(8). Highlights beyond 1 count, unlike in display space."""

    space = "log1p"
    peak = math.log1p(LOG_SCALE)


class LinearRMSE(SquaredDifference):
    """Root mean squared error of linear radiance, in the material's own unit; exposure is not used.

        RMSE = √(mean over texels and channels of (reference − test)²)   lower is better

    Divided by the mean radiance of some slices it is the relative error, which is not lower just because they are dark.
    """

    space = "linear"

    def values(self, raw: Array) -> Array:
        return np.sqrt(raw)
