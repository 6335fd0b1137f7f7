"""Codes as bytes by a model of each: see `code_model`.

Interleaved range coders (rANS: Duda 2013; Giesen 2014, "Interleaved entropy coders") take a step's symbols in turn. One
that ends otherwise than it began read others.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from bench.inputs.errors import InputError
from bench.training.code_fit import fitted
from bench.training.code_model import TOTAL, USUAL, Canvas, CodeModel, Curve, Ints, Size

Codes = NDArray[np.uint8]
Step = Callable[[Ints, Ints, Curve], Ints]  # the codes (n,) of texels and channels with some distributions


def encode(codes: Codes, bits: Ints, sizes: Sequence[Size]) -> bytes:
    """Codes (N, C) of pictures of some sizes, one after the other, those of each channel below 2^bits (C,)."""
    canvas = Canvas.of(sizes)
    model = fitted(codes, bits, canvas)
    taken = list[tuple[NDArray[np.int32], NDArray[np.int32]]]()

    def known(texel: Ints, channel: Ints, curve: Curve) -> Ints:
        code = codes[texel, channel].astype(np.int64)
        below = curve.below(code)
        taken.append((below.astype(np.int32), (curve.below(code + 1) - below).astype(np.int32)))
        return code

    _walk(model, canvas, known)
    state, words = np.full(_lanes(codes.size), TOTAL), list[Ints]()
    rounds = [(below[each], share[each]) for below, share in taken for each in _rounds(len(below), len(state))]
    for below, share in reversed(rounds):
        used = state[: len(below)]
        share = share.astype(np.int64)
        full = used >= share << 16
        words.append(used[full] & TOTAL - 1)
        used = np.where(full, used >> 16, used)
        state[: len(below)] = (used // share << 16) + used % share + below
    tail = np.concatenate(words[::-1]).astype("<u2").tobytes()
    return model.to_bytes() + state.astype("<u4").tobytes() + tail


def decode(data: bytes, bits: Ints, sizes: Sequence[Size]) -> Codes:
    """The codes (N, C) that `encode` stored. `InputError` if the bytes are not of such codes."""
    model, start = CodeModel.from_bytes(data, bits)
    canvas = Canvas.of(sizes)
    count = len(canvas.cells) * len(bits)
    reader = _Reader(model, data[start:], _lanes(count))
    codes = np.zeros((len(canvas.cells), len(bits)), np.uint8)

    def read(texel: Ints, channel: Ints, curve: Curve) -> Ints:
        parts = (Curve(*(x[each] for x in curve)) for each in _rounds(len(texel), len(reader.state)))
        found = np.concatenate(list(map(reader.codes, parts)))
        codes[texel, channel] = found
        return found

    _walk(model, canvas, read)
    reader.close()
    return codes


def _lanes(count: int) -> int:
    """Coders that share so many codes: enough for NumPy, but each takes two bytes."""
    return max(1, min(1024, count >> 10))


def _rounds(count: int, lanes: int) -> list[slice]:
    """The symbols of a step by round of the coders."""
    return [slice(at, at + lanes) for at in range(0, count, lanes)]


def _walk(model: CodeModel, canvas: Canvas, code_step: Step) -> None:
    """Visit all codes in their order, each with its guess and the steepness of its distribution."""
    channels, plane = len(model.bits), canvas.plane
    offsets, weights = model.taps(canvas)
    values = np.zeros(channels * plane, np.int32)
    activity = np.full((1 + channels) * plane, USUAL, np.uint8)  # the first plane is before all channels
    for texel, channel in canvas.steps(channels):
        cell = channel * plane + canvas.cells[texel]
        near = values.take(cell[:, None] + offsets.take(channel, 0))
        guess = model.guess(np.einsum("ij,ij->i", near, weights.take(channel, 0)).astype(np.int64))
        before, around = activity[cell].astype(np.int64), canvas.around(activity, cell + plane)
        deviation = model.deviation(channel, around, before)
        code = code_step(texel, channel, model.curve(channel, guess, (1 << 26) // deviation))
        value = model.value(channel, code)
        now = model.activity(channel, value, guess, before)
        shadow = canvas.shadows[texel]
        for there in (cell, cell + shadow):
            values[there], activity[there + plane] = value, now


class _Reader:
    """The coders of some bytes: their states (lanes,), and the words that are still to be read."""

    def __init__(self, model: CodeModel, data: bytes, lanes: int):
        self.model, self.at = model, 0
        if len(data) < 4 * lanes or len(data) % 2:
            raise InputError(f"a texture of this file has {len(data)} bytes for {lanes} coders: encode it again")
        self.state = np.frombuffer(data, "<u4", lanes).astype(np.int64)
        self.words = np.frombuffer(data, "<u2", offset=4 * lanes).astype(np.int64)
        self.least, self.most = int(model.bits.min()), int(model.bits.max())

    def codes(self, curve: Curve) -> Ints:
        """The next code (n,) of as many coders: that whose share of the frequencies holds the state's low bits."""
        state = self.state[: len(curve.start)]
        slot = state & TOTAL - 1
        code = np.zeros_like(slot)
        for bit in reversed(range(self.most)):
            tried = code + (1 << bit)
            up = curve.inside(tried) <= slot
            if bit >= self.least:
                up &= tried < curve.codes
            code += up * (1 << bit)
        below, above = curve.below(code), curve.below(code + 1)
        state = (above - below) * (state >> 16) + slot - below
        empty = state < TOTAL
        end = self.at + int(empty.sum())
        if end > len(self.words):
            raise InputError("a texture of this file ends before its codes: encode it again")
        state[empty] = state[empty] << 16 | self.words[self.at : end]
        self.at, self.state[: len(state)] = end, state
        return code

    def close(self) -> None:
        if self.at != len(self.words) or (self.state != TOTAL).any():
            raise InputError("a texture of this file holds other codes than were stored: encode it again")
