"""Packs weights, and textures that are stored as floats, at the precision of a file.

Halves can hold numbers of any size: values too large or too small for a half are scaled by a power of two.
"""

import math
from typing import Literal

import numpy as np
import torch
from torch import Tensor

FloatPrecision = Literal["float32", "half"]

# Range of the largest magnitude that halves hold unscaled. The upper end is their largest number. From the lower end
# on, a thousandth of the largest magnitude still has all bits of a half, whose numbers lose bits below 2^-14.
HALF_PEAKS = (2.0**-4, 65504.0)


def half_scale(peak: float) -> float:
    """The divisor of numbers up to ±`peak` before they become halves: 1, or a power of two, which is exact."""
    if peak == 0 or HALF_PEAKS[0] <= peak <= HALF_PEAKS[1]:
        return 1.0
    exponent = math.ceil(math.log2(peak)) - 15  # brings the peak to 2^14 to 2^15, well within halves
    return 2.0 ** max(-126, exponent)  # −126 is the least exponent of a normal float32


def pack(name: str, values: Tensor, precision: FloatPrecision) -> dict[str, Tensor]:
    """Values as named tensors. Scaled halves store their power of two in `name.scale`, (1,)."""
    values = values.detach().cpu()
    if precision == "float32":
        return {name: values.float()}
    scale = half_scale(float(values.abs().max())) if values.numel() else 1.0
    packed = {name: (values / scale).half()}
    if scale != 1:
        packed[f"{name}.scale"] = torch.tensor([scale])
    return packed


def unpack(name: str, tensors: dict[str, Tensor]) -> Tensor:
    """Restore the float32 values that `pack` stored."""
    values = tensors[name].float()
    if f"{name}.scale" in tensors:
        return values * tensors[f"{name}.scale"]
    return values


def pack_bits(codes: Tensor, bits: int) -> Tensor:
    """Whole numbers (n,) below 2^bits as bytes, uint8: their bits one after the other, each number's lowest first."""
    shifted = codes.cpu().numpy()[:, None] >> np.arange(bits)  # (n, bits)
    flags = shifted & 1  # bit k of each number in column k
    return torch.from_numpy(np.packbits(flags.astype(np.uint8)))


def unpack_bits(packed: Tensor, count: int, bits: int) -> Tensor:
    """The numbers (count,), int64, that `pack_bits` packed."""
    flags = np.unpackbits(packed.numpy(), count=count * bits).reshape(count, bits).astype(np.int64)
    return torch.from_numpy((flags << np.arange(bits)).sum(1))
