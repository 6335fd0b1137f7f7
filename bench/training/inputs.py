"""Network inputs of two directions: coordinates in the tangent plane, or both directions and their half vector."""

from typing import Literal

import torch
from torch import Tensor
from torch.nn import functional

Directions = Literal["xy", "xyzh"]

COUNTS = {"xy": 4, "xyzh": 9}  # count of inputs for both directions together


def direction_inputs(wo: Tensor, wi: Tensor, kind: Directions) -> tuple[Tensor, Tensor]:
    """Network inputs of unit directions wo, wi (n, 3): those of the view, then those of the light and the half vector.

    `xy`: x and y of each. `xyzh`: x, y and z of each, and of the half vector, around which highlights lie.
    """
    if kind == "xy":
        return wo[:, :2], wi[:, :2]
    return wo, torch.cat([wi, functional.normalize(wo + wi)], 1)
