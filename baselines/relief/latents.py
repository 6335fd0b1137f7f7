"""Textures in two to eight bits a number: the steps they are rounded to, and the bytes that a file holds.

Codes are written plane by plane, each as the high bits of a byte, and compressed by LZMA, whose range coder then sees
the code before as its context. It comes with Python, and takes a quarter off the bytes of latents.
"""

import lzma

import numpy as np
import torch
from torch import Tensor

from bench.errors import InputError

RANGES = 29  # shares of a channel's range, from 0.3 to all of it, that are tried: rounding finer, clipping more
_CODER = {"id": lzma.FILTER_LZMA2, "preset": 9 | lzma.PRESET_EXTREME, "lc": 4, "lp": 0, "pb": 0}


def steps_for(values: Tensor, bits: int) -> tuple[Tensor, Tensor]:
    """Lowest value and step (C,) of values (n, C) that round them with the least squared error, range by range."""
    values = values.detach()
    low, high = values.amin(0), values.amax(0)
    middle, half, top = (low + high) / 2, (high - low) / 2, 2**bits - 1
    best = torch.full_like(middle, torch.inf)
    found = low.clone(), (2 * half / top).clamp_min(1e-12)
    for share in torch.linspace(0.3, 1, RANGES).tolist():
        tried = middle - share * half, (2 * share * half / top).clamp_min(1e-12)
        error = (rounded(values, *tried, bits) - values).square().mean(0)
        better = error < best
        best = torch.where(better, error, best)
        found = torch.where(better, tried[0], found[0]), torch.where(better, tried[1], found[1])
    return found


def codes_of(values: Tensor, low: Tensor, step: Tensor, bits: int) -> Tensor:
    """Codes, as floats, of values (…, C)."""
    return ((values - low) / step).round().clamp(0, 2**bits - 1)


def rounded(values: Tensor, low: Tensor, step: Tensor, bits: int) -> Tensor:
    """Values (…, C) as they come back from a file; the gradient passes as if they were not rounded."""
    with torch.no_grad():
        change = low + step * codes_of(values, low, step, bits) - values
    return values + change


def compress(codes: Tensor, bits: int) -> Tensor:
    """Codes (H, W, C) below 2^bits as bytes (n,), uint8, without loss."""
    planes = np.ascontiguousarray(codes.cpu().numpy().astype(np.uint8).transpose(2, 0, 1)) << (8 - bits)
    data = lzma.compress(planes.tobytes(), lzma.FORMAT_RAW, filters=[_filter(planes.size)])
    return torch.frombuffer(bytearray(data), dtype=torch.uint8)


def expand(data: Tensor, shape: tuple[int, int, int], bits: int) -> Tensor:
    """The codes (H, W, C), as floats, of what `compress` gave; memory stays within that shape."""
    height, width, channels = shape
    count = height * width * channels
    decoder = lzma.LZMADecompressor(lzma.FORMAT_RAW, filters=[_filter(count)])
    try:
        planes = decoder.decompress(data.numpy().tobytes(), max_length=count)
    except lzma.LZMAError as error:
        raise InputError(f"a texture of this file does not expand ({error}): encode it again") from error
    if len(planes) != count:
        raise InputError(f"a texture of this file holds {len(planes)} codes, not {count}: encode it again")
    found = np.frombuffer(planes, np.uint8).reshape(channels, height, width) >> (8 - bits)
    return torch.from_numpy(found.transpose(1, 2, 0).astype(np.float32))


def _filter(count: int) -> dict[str, int]:
    return _CODER | {"dict_size": min(max(4096, count), 1 << 24)}
