"""The precision of a stored height, and how a fit keeps it smooth."""

import torch
from torch import Tensor

from baselines.relief.geometry import LOWEST

STEP = 2 / 3  # texels by which a step of the height moves a look-up at the steepest slope; rounding moves half of it
MOST_CODES = 256


def stepped(height: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The codes of a height (H, W) from 0, the lowest height and the step (2,), and the height as read back.

    Steps are counted from z = 0, so a height that moves slightly keeps most of its codes.
    """
    low, high = height.aminmax()
    step = torch.maximum(height.new_tensor(STEP * LOWEST / height.shape[1]), (high - low) / (MOST_CODES - 2))
    codes = (height / step).round()
    least = codes.min()
    return codes - least, torch.stack([least * step, step]), restored(codes - least, torch.stack([least * step, step]))


def restored(codes: Tensor, extent: Tensor) -> Tensor:
    """The height (H, W) of its codes, and of its lowest value and step (2,)."""
    return codes * extent[1] + extent[0]


def smoothed(picture: Tensor) -> Tensor:
    """A periodic picture (H, W) blurred with σ = 1 texel, so that neighbours share the few samples that move a
    height."""
    for axis in (0, 1, 0, 1):
        picture = (picture.roll(1, axis) + 2 * picture + picture.roll(-1, axis)) / 4
    return picture
