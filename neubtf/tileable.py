"""Textures that repeat without a seam: a guidance image that wraps around gives one, since the encoder wraps around."""

from typing import NamedTuple

import numpy as np

from bench.metrics.display import LOG_SCALE, to_display
from bench.periodic import make_periodic, seams
from neubtf.renderer import NeuBTFMaterial

Array = np.ndarray
FRONTAL = np.array([[[0.0, 0, 1], [0, 0, 1]]])  # the pair of the normal alone


def blended(picture: Array, margin: float) -> Array:
    """A linear picture (H, W, 3) whose far margins, that share of each side, are blended into its near ones.

    It loses them. What the blend's contrast takes below 0 becomes 0.
    """
    overlap = (round(picture.shape[0] * margin), round(picture.shape[1] * margin))
    return np.maximum(make_periodic(picture, overlap), 0).astype(np.float32) if any(overlap) else picture


class Seam(NamedTuple):
    """The mean gradient across a border, over the mean and over the largest of those inside."""

    of_mean: float
    of_largest: float


def seam_of(material: NeuBTFMaterial, pairs: Array) -> tuple[Seam, Seam]:
    """The seam at the left–right, and at the top–bottom border of a material, where slices of it are displayed.

    `pairs` (n, 2, 3) are wo and wi; the ratios are of means over their slices.
    """
    exposure = material.gain / LOG_SCALE
    slices = (material.slice(wo.tolist(), wi.tolist()).numpy() for wo, wi in pairs)
    means = np.mean([seams(to_display(each, exposure)) for each in slices], 0)
    beside, below = (Seam(across / mean, across / largest) for across, mean, largest in np.maximum(means, 1e-12))
    return beside, below
