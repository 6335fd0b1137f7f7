"""Root mean squared error of linear radiance, in the material's own unit: the absolute error of a slice.

    RMSE = √(mean over texels and channels of (reference − test)²)   lower is better

Exposure is not used. The raw number is the squared error, so pooling is exact. Divided by the mean radiance of a
band of slices it gives the relative error, which is not lower merely because slices are dark.
"""

import numpy as np

from bench.metrics.base import SliceMetric
from bench.metrics.picture import Picture
from bench.metrics.psnr import squared_error

Array = np.ndarray


class LinearRMSE(SliceMetric):
    """RMSE of linear radiance."""

    def reference_side(self, reference: Picture) -> Array:
        return reference.linear

    def compare(self, side: Array, test: Picture) -> Array:
        return squared_error(side, test.linear)

    def values(self, raw: Array) -> Array:
        return np.sqrt(raw)
