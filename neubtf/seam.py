"""Measures the seam of a material: how much more neighbours differ across its border than inside, in displayed slices.

The autoencoder has one cell for `STRIDE` texels, so differences are larger from one cell to the next than inside one. A
border lies between two cells, and is compared with others that do.
"""

from typing import NamedTuple

import numpy as np

from bench.metrics.display import LOG_SCALE, to_display
from neubtf.autoencoder import STRIDE
from neubtf.renderer import Decoded

Array = np.ndarray
FRONTAL = np.array([[[0.0, 0, 1], [0, 0, 1]]])  # only the pair along the normal


class Seam(NamedTuple):
    """The mean gradient across a border over the mean, and over the largest, of those between the cells inside.

    Both are infinite if there is no gradient inside.
    """

    of_mean: float
    of_largest: float


def seam_of(material: Decoded, pairs: Array) -> tuple[Seam, Seam]:
    """The seam at the left–right, and at the top–bottom border of a material.

    `pairs` (n, 2, 3) are wo and wi of the slices over which gradients are means.
    """
    exposure = material.gain / LOG_SCALE  # the gain of log radiance is LOG_SCALE · exposure
    slices = []
    for wo, wi in pairs:
        radiance = material.slice(wo.tolist(), wi.tolist()).numpy()
        slices.append(to_display(radiance, exposure))
    left_right = np.mean([_steps(picture, axis=1) for picture in slices], 0)
    top_bottom = np.mean([_steps(picture, axis=0) for picture in slices], 0)
    return _seam(left_right), _seam(top_bottom)


def _steps(picture: Array, axis: int) -> Array:
    """The mean |difference| of each row of a picture (H, W, 3) from the next, (H,), the last from the first.

    Those are the rows for axis 0; for axis 1 they are the columns, (W,).
    """
    rows = np.moveaxis(picture, axis, 0)
    return np.abs(np.diff(rows, axis=0, append=rows[:1])).mean((1, 2))


def _seam(steps: Array) -> Seam:
    """The seam of differences (n,) of rows or columns from the next, the last of which crosses the border."""
    across_border = steps[-1]
    between_cells = steps[STRIDE - 1 : -1 : STRIDE]  # from the last texel of a cell to the first of the next
    if not between_cells.any():
        return Seam(np.inf, np.inf)
    return Seam(float(across_border / between_cells.mean()), float(across_border / between_cells.max()))
