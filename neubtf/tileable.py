"""Tileable textures: a periodic guidance image gives one, because the encoder is periodic, too."""

from typing import NamedTuple

import numpy as np

from bench.data.periodic import make_periodic
from bench.metrics.display import LOG_SCALE, to_display
from neubtf.autoencoder import STRIDE
from neubtf.renderer import NeuBTFMaterial

Array = np.ndarray
FRONTAL = np.array([[[0.0, 0, 1], [0, 0, 1]]])  # only the pair along the normal


def blended(picture: Array, margin: float) -> Array:
    """A linear picture (H, W, 3), ≥ 0; its far margins, a share of each side, are blended into its near ones.

    The picture loses the margins, and up to three more texels, so that the autoencoder's cells fit the period.
    """
    overlap = (_overlap(picture.shape[0], margin), _overlap(picture.shape[1], margin))
    return np.maximum(make_periodic(picture, overlap), 0).astype(np.float32) if any(overlap) else picture


def _overlap(side: int, margin: float) -> int:
    least = round(side * margin)
    fitting = least + (side - least) % STRIDE
    return fitting if least and 2 * fitting <= side else least


class Seam(NamedTuple):
    """The mean gradient across a border, over the mean and over the largest of those inside."""

    of_mean: float
    of_largest: float


def seam_of(material: NeuBTFMaterial, pairs: Array) -> tuple[Seam, Seam]:
    """The seam at the left–right, and at the top–bottom border of a material, in displayed slices.

    `pairs` (n, 2, 3) are wo and wi; gradients are means over their slices. The border is compared with steps between
    two of the autoencoder's cells, larger than those within a cell; the ratios are infinite if there is no such step.
    """
    exposure = material.gain / LOG_SCALE
    slices = [to_display(material.slice(wo.tolist(), wi.tolist()).numpy(), exposure) for wo, wi in pairs]
    left_right, top_bottom = (_seam(np.mean([_steps(each, axis) for each in slices], 0)) for axis in (1, 0))
    return left_right, top_bottom


def _steps(picture: Array, axis: int) -> Array:
    """The mean |difference| between each column (or row) and the next, the last with the first."""
    along = np.moveaxis(picture, axis, 0)
    steps: Array = np.abs(np.diff(along, axis=0, append=along[:1])).mean((1, 2))
    return steps


def _seam(steps: Array) -> Seam:
    inside = steps[STRIDE - 1 : -1 : STRIDE]
    if not inside.any():
        return Seam(np.inf, np.inf)
    return Seam(float(steps[-1] / inside.mean()), float(steps[-1] / inside.max()))
