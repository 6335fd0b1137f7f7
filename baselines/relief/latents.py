"""Textures in one to eight bits a number: which channel takes how many, the steps of each, and the bytes of a file.

Codes are stored plane by plane in the shortest of three ways, which the first byte names: their bits alone, or LZMA's
range coder, whose odds adapt to each plane, without context or with the code before as context. LZMA comes with Python.
"""

import lzma

import numpy as np
import torch
from torch import Tensor

from bench.errors import InputError

MOST_BITS = 8
MOST_CODES = (
    1 << 25
)  # of a texture, where its bytes hold no more: packed bits are up to eight a byte, LZMA's any number
RANGES = 29  # shares of a channel's range, from 0.3 to all of it, that are tried: rounding finer, clipping more
PACKED, PLAIN, IN_CONTEXT = range(3)  # the ways; LZMA's context are the high bits of the byte before


def steps_for(values: Tensor, bits: Tensor) -> tuple[Tensor, Tensor]:
    """Lowest value and step (C,) of values (n, C) that round them to bits (C,) with the least squared error of each."""
    values = values.detach()
    low, high = values.amin(0), values.amax(0)
    middle, half, top = (low + high) / 2, (high - low) / 2, 2**bits - 1
    best = torch.full_like(middle, torch.inf)
    chosen = low.clone(), (2 * half / top).clamp_min(1e-12)
    for share in torch.linspace(0.3, 1, RANGES).tolist():
        tried = middle - share * half, (2 * share * half / top).clamp_min(1e-12)
        error = (rounded(values, *tried, bits) - values).square().mean(0)
        better = error < best
        best = torch.where(better, error, best)
        chosen = torch.where(better, tried[0], chosen[0]), torch.where(better, tried[1], chosen[1])
    return chosen


def shared_out(noise: Tensor, total: int, bearable: float) -> Tensor:
    """The bits (C,) of each channel, 1 to `MOST_BITS`, of what rounding it to 1, 2 … bits adds to an error (C, 8).

    Each bit goes to the channel that adds most, until all together add no more than is bearable, or `total` are spent.
    """
    bits = torch.ones(len(noise), dtype=torch.long)
    while bits.sum() < min(total, MOST_BITS * len(noise)):
        added = noise.gather(1, bits[:, None] - 1)[:, 0]
        if added.sum() <= bearable:
            break
        bits[torch.where(bits < MOST_BITS, added, -torch.inf).argmax()] += 1
    return bits


def codes_of(values: Tensor, low: Tensor, step: Tensor, bits: Tensor) -> Tensor:
    """Codes, as floats, of values (…, C)."""
    return ((values - low) / step).round().clamp_min(0).minimum(2.0**bits - 1)


def rounded(values: Tensor, low: Tensor, step: Tensor, bits: Tensor) -> Tensor:
    """Values (…, C) as they come back from a file; the gradient passes as if they were not rounded."""
    with torch.no_grad():
        change = low + step * codes_of(values, low, step, bits) - values
    return values + change


def compress(codes: Tensor, bits: list[int]) -> Tensor:
    """Codes (H, W, C), those of each channel below 2^bits, as bytes (n,), uint8, without loss."""
    planes = np.ascontiguousarray(codes.cpu().numpy().astype(np.uint8).transpose(2, 0, 1)).reshape(len(bits), -1)
    shifted = planes << (MOST_BITS - np.array(bits, np.uint8))[:, None]
    flags = [np.unpackbits(plane[:, None], axis=1)[:, :each] for plane, each in zip(shifted, bits, strict=True)]
    ways = {
        PACKED: np.packbits(np.concatenate([each.reshape(-1) for each in flags])).tobytes(),
        PLAIN: lzma.compress(planes.tobytes(), lzma.FORMAT_RAW, filters=_coder(PLAIN, planes.size)),
        IN_CONTEXT: lzma.compress(shifted.tobytes(), lzma.FORMAT_RAW, filters=_coder(IN_CONTEXT, planes.size)),
    }
    way = min((each for each in ways if codes.numel() <= _most(ways[each])), key=lambda each: len(ways[each]))
    return torch.frombuffer(bytearray([way, *bits]) + ways[way], dtype=torch.uint8)


def _most(payload: bytes) -> int:
    """How many codes some bytes may expand to."""
    return max(MOST_CODES, 8 * len(payload))


def expand(data: Tensor, shape: tuple[int, int, int]) -> Tensor:
    """The codes (H, W, C), as floats, of what `compress` gave; memory stays within that shape and `_most`."""
    height, width, channels = shape
    count, size = height * width * channels, height * width
    if not len(data) or data[0] > IN_CONTEXT:
        raise InputError("a texture of this file does not say how it is stored: encode it again")
    way, bits, payload = int(data[0]), data[1 : 1 + channels].numpy(), data[1 + channels :].numpy().tobytes()
    if len(bits) < channels or not ((bits >= 1) & (bits <= MOST_BITS)).all():
        raise InputError("a texture of this file does not say its bits: encode it again")
    if not 0 < count <= _most(payload):
        raise InputError(f"a texture of this file has {len(payload)} bytes for {count} codes: encode it again")
    if way == PACKED:
        flags = np.unpackbits(np.frombuffer(payload, np.uint8))
        ends = np.cumsum(bits.astype(int) * size)
        parts = np.split(flags, ends)[:-1] if len(flags) >= ends[-1] else []
        each = [np.packbits(part.reshape(size, -1), axis=1)[:, 0] for part in parts]
        planes = np.concatenate(each) if each else np.empty(0, np.uint8)
    else:
        try:
            decoder = lzma.LZMADecompressor(lzma.FORMAT_RAW, filters=_coder(way, count))
            planes = np.frombuffer(decoder.decompress(payload, max_length=count), np.uint8)
        except lzma.LZMAError as error:
            raise InputError(f"a texture of this file does not expand ({error}): encode it again") from error
    if len(planes) != count:
        raise InputError(f"a texture of this file holds {len(planes)} codes, not {count}: encode it again")
    planes = planes.reshape(channels, -1)
    if way != PLAIN:
        planes = planes >> (MOST_BITS - bits)[:, None]
    return torch.from_numpy(planes.reshape(channels, height, width).transpose(1, 2, 0).astype(np.float32))


def _coder(way: int, count: int) -> list[dict[str, int]]:
    context = 4 if way == IN_CONTEXT else 0
    size = min(max(4096, count), 1 << 24)
    preset = 9 | lzma.PRESET_EXTREME
    return [{"id": lzma.FILTER_LZMA2, "preset": preset, "lc": context, "lp": 0, "pb": 0, "dict_size": size}]
