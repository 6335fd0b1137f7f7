"""Packs textures and weights at the precision that a file stores.

Eight bits are affine per channel: value = offset + scale · code. Latents lose ≤ 0.01 dB by it; see docs/decisions.
Halves can hold numbers of any size: values too large or too small for a half are scaled by a power of two.
"""

import math
from typing import Literal

import torch
from torch import Tensor

Precision = Literal["float32", "half", "int8"]
WeightPrecision = Literal["float32", "half"]

HALF_PEAKS = (2.0**-4, 65504.0)  # range of the largest magnitude that halves hold unscaled


def half_scale(peak: float) -> float:
    """The divisor of numbers up to ±`peak` before they become halves: 1, or a power of two.

    Half precision ends at 65,504 and loses digits below 6e-5; division by a power of two is exact.
    """
    if peak == 0 or HALF_PEAKS[0] <= peak <= HALF_PEAKS[1]:
        return 1.0
    return 2.0 ** max(-126, math.ceil(math.log2(peak)) - 15)


def pack(name: str, values: Tensor, precision: Precision) -> dict[str, Tensor]:
    """Values (…, C) as named tensors; with eight bits `name` is uint8, and `name.scale`, `name.offset` are (C,).

    Scaled halves store their power of two in `name.scale`, (1,).
    """
    values = values.detach().cpu()
    if precision == "float32":
        return {name: values.float()}
    if precision == "half":
        scale = half_scale(float(values.abs().max())) if values.numel() else 1.0
        return {name: (values / scale).half()} | ({f"{name}.scale": torch.tensor([scale])} if scale != 1 else {})
    flat = values.flatten(0, -2).float()
    low, high = flat.amin(0), flat.amax(0)
    # The scale of a constant channel must not be 0.
    step = ((high - low) / 255).clamp_min(1e-12)
    codes = (values - low).div_(step).round_().clamp_(0, 255).to(torch.uint8)
    return {name: codes, f"{name}.scale": step, f"{name}.offset": low}


def unpack(name: str, tensors: dict[str, Tensor]) -> Tensor:
    """Restore the float32 values that `pack` stored."""
    values = tensors[name].float()
    if f"{name}.scale" in tensors:
        values = values * tensors[f"{name}.scale"]
    return values + tensors[f"{name}.offset"] if f"{name}.offset" in tensors else values
