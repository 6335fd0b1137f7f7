"""Structural similarity: Wang, Bovik, Sheikh, Simoncelli, IEEE Trans. Image Processing 13(4), 2004, eq. 13.

    SSIM = (2 μx μy + C1)(2 σxy + C2) / ((μx² + μy² + C1)(σx² + σy² + C2)),   C1 = 0.01², C2 = 0.03²

on the Rec. 709 luma of the display transform, range 1; local means, variances and covariance under a Gaussian window of
11 × 11, σ = 1.5, that sums to 1 (population, not sample, moments); no downsampling. The number of a slice is the mean
over the windows that lie completely inside it, as in the authors' code and in scikit-image. The periodic variant wraps
the window around and takes the mean over all texels.
"""

import numpy as np
from scipy.ndimage import correlate1d

from bench.btf import Array
from bench.metrics.base import Picture, SliceMetric

RADIUS = 5
SIGMA = 1.5
C1, C2 = 0.01**2, 0.03**2

_WINDOW = np.exp(-0.5 * (np.arange(-RADIUS, RADIUS + 1) / SIGMA) ** 2)
_WINDOW /= _WINDOW.sum()


class SSIM(SliceMetric):
    """Mean structural similarity of display luma, at most 1; higher is better. Raises `InputError` for a picture
    smaller than the window, unless periodic."""

    perfect = 1.0

    def __init__(self, periodic: bool = False):
        self.periodic = periodic
        self.smallest = 1 if periodic else len(_WINDOW)

    def reference_side(self, reference: Picture) -> tuple[Array, Array, Array]:
        """The reference's luma (..., H, W), and its local mean and variance where the window fits."""
        x = reference.luma
        mean = self._local_mean(x)
        return x, mean, self._local_mean(x * x) - mean * mean

    def compare(self, side: tuple[Array, Array, Array], test: Picture) -> Array:
        """The map of similarity (..., H, W); unless periodic, without the five outer texels at each border."""
        x, mean_x, variance_x = side
        y = test.luma
        mean_y = self._local_mean(y)
        product = mean_x * mean_y
        covariance = self._local_mean(x * y) - product
        variance_y = self._local_mean(y * y) - mean_y * mean_y
        return ((2 * product + C1) * (2 * covariance + C2)) / (
            (mean_x * mean_x + mean_y * mean_y + C1) * (variance_x + variance_y + C2)
        )

    def _local_mean(self, plane: Array) -> Array:
        """The Gaussian mean around each texel whose window fits, or around all if the picture wraps."""
        mode = "wrap" if self.periodic else "nearest"
        smooth = correlate1d(correlate1d(plane, _WINDOW, -2, mode=mode), _WINDOW, -1, mode=mode)
        return smooth if self.periodic else smooth[..., RADIUS:-RADIUS, RADIUS:-RADIUS]
