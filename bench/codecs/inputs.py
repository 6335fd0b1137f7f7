"""What a network sees of two directions: coordinates in the tangent plane, or both directions and their half vector."""

from typing import Literal

import torch
from torch import Tensor
from torch.nn import functional

Directions = Literal["xy", "xyzh"]

COUNTS = {"xy": 4, "xyzh": 9}  # numbers of both directions together


def direction_inputs(wo: Tensor, wi: Tensor, kind: Directions) -> tuple[Tensor, Tensor]:
    """What a network sees of unit directions wo, wi (n, 3): of the view, and of the light with what they share.

    `xy`: x and y of each. `xyzh`: x, y and z of each, and of the half vector, around which highlights lie.
    """
    if kind == "xy":
        return wo[:, :2], wi[:, :2]
    return wo, torch.cat([wi, functional.normalize(wo + wi)], 1)
