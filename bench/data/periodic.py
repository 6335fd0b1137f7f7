"""Periodic pictures: measures the seam at the borders, and blends it away."""

import numpy as np

from bench.btf import Array
from bench.inputs.errors import InputError


def make_periodic(picture: Array, overlap: tuple[int, int]) -> Array:
    """A picture (H, W) or (H, W, C) cut by `overlap` (rows, columns), its far margins blended into its near ones.

    The blend's deviation from the mean is scaled by 1 / √(w² + (1 − w)²), which keeps the contrast of texture; it may
    leave the range of the picture. Raises `InputError` if a margin is more than half of a side.
    """
    if any(not 0 <= 2 * width <= side for width, side in zip(overlap, picture.shape[:2], strict=True)):
        margins, sides = (f"{width} × {height}" for height, width in (overlap, picture.shape[:2]))
        raise InputError(f"margins of {margins} do not fit twice into a picture of {sides}")
    mean = picture.mean((0, 1))
    for axis, width in enumerate(overlap):
        moved = np.moveaxis(picture - mean, axis, 0)
        size = len(moved) - width
        weight = 0.5 - 0.5 * np.cos(np.pi * (np.arange(width) + 0.5) / max(width, 1))
        weight = weight.reshape(-1, *(1,) * (moved.ndim - 1))
        blend = weight * moved[:width] + (1 - weight) * moved[size:]
        blend /= np.sqrt(weight**2 + (1 - weight) ** 2)
        picture = np.moveaxis(np.concatenate([blend, moved[width:size]]), 0, axis) + mean
    return picture


def seams(picture: Array) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """The seams at the left–right and the top–bottom border of a picture (H, W, C): three gradients each.

    They are the mean |difference| across the border, the mean |difference| of neighbours inside, and the largest mean
    inside between two whole columns (or rows). A side below 4 is too short to measure, and gives (0, 1, 1).
    """
    return _seam(picture), _seam(picture.swapaxes(0, 1))


def _seam(picture: Array) -> tuple[float, float, float]:
    if picture.shape[1] < 4:
        return 0.0, 1.0, 1.0
    steps = np.abs(np.diff(picture, axis=1)).mean((0, 2))
    return float(np.abs(picture[:, 0] - picture[:, -1]).mean()), float(steps.mean()), float(steps.max())
