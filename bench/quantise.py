"""Textures and weights at the precision that a file stores, with their true bytes.

Eight bits are affine a channel: value = offset + scale · code. Latents lose ≤ 0.01 dB by it; see docs/decisions.
"""

from typing import Literal

import torch
from torch import Tensor

Precision = Literal["float32", "half", "int8"]
WeightPrecision = Literal["float32", "half"]


def pack(name: str, values: Tensor, precision: Precision) -> dict[str, Tensor]:
    """Values (…, C) as named tensors; with eight bits `name` is uint8, and `name.scale`, `name.offset` are (C,)."""
    values = values.detach().cpu()
    if precision != "int8":
        return {name: values.half() if precision == "half" else values.float()}
    flat = values.reshape(-1, values.shape[-1]).float()
    low, high = flat.amin(0), flat.amax(0)
    # A constant channel needs some scale that is not 0.
    scale = ((high - low) / 255).clamp_min(1e-12)
    codes = (values - low).div_(scale).round_().clamp_(0, 255).to(torch.uint8)
    return {name: codes, f"{name}.scale": scale, f"{name}.offset": low}


def unpack(name: str, tensors: dict[str, Tensor]) -> Tensor:
    """The float32 values of what `pack` gave."""
    values = tensors[name].float()
    return values * tensors[f"{name}.scale"] + tensors[f"{name}.offset"] if f"{name}.scale" in tensors else values
