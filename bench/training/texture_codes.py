"""The bytes of a texture's codes, of up to eight bits a number, chosen for each channel.

A texture has numbers for each texel, one a channel; codes are these numbers, rounded to the bits of their channel. The
codes of a channel are a plane.

A channel of no bits has the one code 0, and takes no bytes. All others are stored in the shortest of four ways, which
the first byte names: plane by plane, their bits alone, or LZMA's range coder, whose odds adapt to each plane, without
context or with the code before as context; or each by what its neighbours in the picture and the channels before
predict (`predicted_codes`). LZMA comes with Python.
"""

import lzma
import math
from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from bench.inputs.errors import InputError
from bench.training import predicted_codes
from bench.training.code_model import feasible

MOST_BITS = 8
MOST_CODES = 1 << 25  # of a texture, if its bytes hold no more: packed bits give up to eight a byte, LZMA any number
MOST_PREDICTED = 1 << 22  # that are predicted: more would take over three seconds to open
PACKED, PLAIN, IN_CONTEXT, PREDICTED = range(4)  # the ways; LZMA's context are the high bits of the byte before


def compress(codes: Tensor, bits: list[int], sizes: Sequence[tuple[int, int]] | None = None) -> Tensor:
    """Codes (…, C), those of each channel below 2^bits, as bytes (n,), uint8, without loss.

    They are the way, the bits of each channel, and the codes of those with bits, stored in this way. `sizes` (H, W) are
    those of the pictures whose texels codes (N, C) are; without them no neighbours predict such codes. If a channel has
    no bits, `expand` refuses more than `MOST_CODES` codes in all.
    """
    with_bits = [channel for channel, count in enumerate(bits) if count]  # the channels of one bit or more
    if with_bits:
        way, payload = _shortest(codes[..., with_bits], [bits[channel] for channel in with_bits], sizes)
    else:
        way, payload = PACKED, b""
    return torch.frombuffer(bytearray([way, *bits]) + payload, dtype=torch.uint8)


def _shortest(codes: Tensor, bits: list[int], sizes: Sequence[tuple[int, int]] | None) -> tuple[int, bytes]:
    """The way that takes the fewest bytes, and these, of channels of one bit or more."""
    planes = np.ascontiguousarray(codes.cpu().numpy().astype(np.uint8).reshape(-1, len(bits)).T)  # (C, n)
    # At the high end of each byte, so that the high bits, which are LZMA's context, are those of the code.
    shifted = planes << (MOST_BITS - np.array(bits, np.uint8))[:, None]
    # Of each channel its bits (n, bits), the highest first; the other bits of a byte are 0.
    flags = []
    for plane, count in zip(shifted, bits, strict=True):
        flags.append(np.unpackbits(plane[:, None], axis=1)[:, :count])
    ways = {
        PACKED: np.packbits(np.concatenate([each.reshape(-1) for each in flags])).tobytes(),
        PLAIN: lzma.compress(planes.tobytes(), lzma.FORMAT_RAW, filters=_coder(PLAIN, planes.size)),
        IN_CONTEXT: lzma.compress(shifted.tobytes(), lzma.FORMAT_RAW, filters=_coder(IN_CONTEXT, planes.size)),
    }
    if codes.numel() <= MOST_PREDICTED:
        pictures = _picture_sizes(codes.shape, sizes)
        if pictures:
            ways[PREDICTED] = predicted_codes.encode(planes.T, np.array(bits), pictures)
    # Of the ways from which `expand` accepts so many codes.
    readable = [way for way, payload in ways.items() if codes.numel() <= _most_codes(way, payload)]
    shortest = min(readable, key=lambda way: len(ways[way]))
    return shortest, ways[shortest]


def _picture_sizes(shape: Sequence[int], sizes: Sequence[tuple[int, int]] | None) -> Sequence[tuple[int, int]]:
    """The sizes (H, W) of the pictures that codes (…, C) are: `sizes`, or that of one picture.

    Empty if they are not known, do not add up to the codes, or would take too many steps to decode from neighbours.
    """
    if sizes is None:
        # Codes (…, H, W, C) are one picture, with all before W as its rows.
        sizes = [(math.prod(shape[:-2]), shape[-2])] if len(shape) > 2 else []
    fits = sum(height * width for height, width in sizes) == math.prod(shape[:-1])
    if sizes and fits and feasible(sizes, shape[-1]):
        return sizes
    return []


def _most_codes(way: int, payload: bytes) -> int:
    """The largest number of codes to which a payload may expand: a fixed one, or eight a byte if that is more."""
    fixed = MOST_PREDICTED if way == PREDICTED else MOST_CODES
    return max(fixed, 8 * len(payload))


def bits_of(data: Tensor, channels: int) -> Tensor:
    """The bits (C,) of each channel, from the bytes of `compress`. `InputError` if they are not there."""
    bits = data[1 : 1 + channels]
    if len(bits) < channels or (bits > MOST_BITS).any():
        raise InputError("a texture of this file does not say its bits: encode it again")
    return bits


def expand(data: Tensor, shape: Sequence[int], sizes: Sequence[tuple[int, int]] | None = None) -> Tensor:
    """The codes (…, C), as floats, from the bytes of `compress`; memory stays within that shape and `_most_codes`.

    `InputError` if the bytes hold no codes of this shape.
    """
    channels = shape[-1]
    count = math.prod(shape)
    if not len(data) or data[0] > PREDICTED:
        raise InputError("a texture of this file does not say how it is stored: encode it again")
    way = int(data[0])
    bits = bits_of(data, channels).numpy()
    payload = data[1 + channels :].numpy().tobytes()
    has_codes = bits > 0  # a mask of the channels that have codes in the payload
    inner = (*shape[:-1], int(has_codes.sum()))  # the shape of these codes
    # Channels of no bits take no bytes, so where there are some, a payload justifies only a fixed number of codes.
    most = _most_codes(way, payload) if has_codes.all() else MOST_CODES
    if min(shape) < 1 or count > most or math.prod(inner) > _most_codes(way, payload):
        raise InputError(f"a texture of this file has {len(payload)} bytes for {count} codes: encode it again")
    if has_codes.all():
        return _expanded(way, payload, bits, inner, sizes)
    codes = torch.zeros(tuple(shape))
    if has_codes.any():
        codes[..., torch.from_numpy(has_codes)] = _expanded(way, payload, bits[has_codes], inner, sizes)
    return codes


def _expanded(
    way: int, payload: bytes, bits: NDArray[np.uint8], shape: Sequence[int], sizes: Sequence[tuple[int, int]] | None
) -> Tensor:
    """The codes (…, C), as floats, of channels of one bit or more, stored in some way."""
    channels = shape[-1]
    count = math.prod(shape)
    size = count // channels
    if way == PREDICTED:
        pictures = _picture_sizes(shape, sizes)
        if not pictures:
            raise InputError("a texture of this file does not say how its codes lie: encode it again")
        codes = predicted_codes.decode(payload, bits.astype(np.int64), pictures)
        return torch.from_numpy(codes.reshape(tuple(shape)).astype(np.float32))
    planes = _unpacked(payload, bits, size) if way == PACKED else _decompressed(way, payload, count)
    if len(planes) != count:
        raise InputError(f"a texture of this file holds {len(planes)} codes, not {count}: encode it again")
    planes = planes.reshape(channels, size)
    if way != PLAIN:  # each code is at the high end of its byte
        planes = planes >> (MOST_BITS - bits)[:, None]
    return torch.from_numpy(planes.T.reshape(tuple(shape)).astype(np.float32))


def _unpacked(payload: bytes, bits: NDArray[np.uint8], size: int) -> NDArray[np.uint8]:
    """The codes of all planes, `size` in each, one plane after the other, from their bits alone: each code at the high
    end of its byte. Empty if the payload is too short."""
    flags = np.unpackbits(np.frombuffer(payload, np.uint8))
    ends = np.cumsum(bits.astype(int) * size)  # where the bits of each channel end
    if len(flags) < ends[-1]:
        return np.empty(0, np.uint8)
    parts = np.split(flags, ends)[:-1]  # the last part only fills a byte
    return np.concatenate([np.packbits(part.reshape(size, -1), axis=1)[:, 0] for part in parts])


def _decompressed(way: int, payload: bytes, count: int) -> NDArray[np.uint8]:
    """The codes of all planes, at most `count`, by LZMA; `InputError` if it cannot read the payload."""
    try:
        decoder = lzma.LZMADecompressor(lzma.FORMAT_RAW, filters=_coder(way, count))
        return np.frombuffer(decoder.decompress(payload, max_length=count), np.uint8)
    except lzma.LZMAError as error:
        raise InputError(f"a texture of this file does not expand ({error}): encode it again") from error


def _coder(way: int, count: int) -> list[dict[str, int]]:
    """LZMA's filters for `count` bytes in some way: the context is the four high bits of the byte before, or none."""
    context = 4 if way == IN_CONTEXT else 0
    size = min(max(4096, count), 1 << 24)  # of its dictionary: no more than the bytes need
    preset = 9 | lzma.PRESET_EXTREME  # the fewest bytes, whatever the time
    return [{"id": lzma.FILTER_LZMA2, "preset": preset, "lc": context, "lp": 0, "pb": 0, "dict_size": size}]
