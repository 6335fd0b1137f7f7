"""Root mean squared error of linear radiance, in the material's own unit: the absolute error of a slice.

    RMSE = √(mean over texels and channels of (reference − test)²)   lower is better

Exposure is not used. The raw number is the squared error, so pooling is exact. Divided by the mean radiance of a
band of slices it gives the relative error, which is not lower merely because slices are dark.
"""

import numpy as np

from bench.btf import Array
from bench.metrics.psnr import SquaredDifference


class LinearRMSE(SquaredDifference):
    """RMSE of linear radiance."""

    plane = "linear"

    def values(self, raw: Array) -> Array:
        return np.sqrt(raw)
