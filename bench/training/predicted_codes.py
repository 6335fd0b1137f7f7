"""Codes as bytes by a model of each: see `code_model`, which also says what codes, channels and terms are.

Interleaved range coders (rANS: Duda 2013; Giesen 2014, "Interleaved entropy coders") take a step's symbols in turn. A
decoder ends in the state in which its encoder began, or it has read other symbols than were stored. Only the encoder
chooses a model, and the file holds it, so its floats may be rounded otherwise on another machine.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from bench.inputs.errors import InputError
from bench.training.code_model import (
    AROUND,
    MOST_TERMS,
    ONE,
    OWN,
    SHAPES,
    TOTAL,
    USUAL,
    Canvas,
    CodeModel,
    Curve,
    Ints,
    Size,
)

Codes = NDArray[np.uint8]
Ranges = list[tuple[NDArray[np.int32], NDArray[np.int32]]]  # of symbols (n,): frequencies below each, and its own
Step = Callable[[Ints, Ints, Curve], Ints]  # the codes (n,) of texels and channels with some distributions

CHOOSING_TEXELS = 1 << 13  # of a larger texture: those by whose codes its model is chosen
TRIED_BACK = 16  # channels before a channel, whose codes are tried as its terms; a file could have `MOST_BACK`
COST = 17.0  # bits of a term
NUDGE = 1e-6  # of a variance, so that terms that are alike can be told apart
FIRST = 8, 4, 4, 2  # the mixture where the search starts


def encode(codes: Codes, bits: Ints, sizes: Sequence[Size]) -> bytes:
    """The bytes of codes (N, C) of pictures of some sizes, one after the other; those of each channel are below 2^bits
    (C,). They are the model, the last states of the coders, and the words that the coders handed on."""
    canvas = Canvas.of(sizes)
    model = _fit_model(codes, bits, canvas)
    ranges: Ranges = []

    def note_ranges(texel: Ints, channel: Ints, curve: Curve) -> Ints:
        """The codes of a step, which are known; `ranges` takes the range of frequencies of each for the coders."""
        code = codes[texel, channel].astype(np.int64)
        below = curve.below(code)
        share = curve.below(code + 1) - below
        ranges.append((below.astype(np.int32), share.astype(np.int32)))
        return code

    _walk(model, canvas, note_ranges)
    state, words = _encode_ranges(ranges, _lanes(codes.size))
    return model.to_bytes() + state.astype("<u4").tobytes() + words.astype("<u2").tobytes()


def _encode_ranges(ranges: Ranges, lanes: int) -> tuple[Ints, Ints]:
    """The last states (lanes,) of so many coders that took the symbols of all steps, and the words that they handed on,
    in the order in which the decoder needs them."""
    state = np.full(lanes, TOTAL)
    words: list[Ints] = []
    rounds: Ranges = []
    for below, share in ranges:
        for part in _rounds(len(below), lanes):
            rounds.append((below[part], share[part]))
    # The last symbol first, because a state gives back first what it took last. A state takes a symbol by growing by
    # 2^16 / share, and its low 16 bits then lie in the symbol's range of frequencies, which tells the decoder.
    for below, short_share in reversed(rounds):
        share = short_share.astype(np.int64)  # because the shifts overflow 32 bits
        before = state[: len(below)]
        is_full = before >= (share << 16)  # these would grow beyond 32 bits, and first hand on their low 16
        words.append(before[is_full] & (TOTAL - 1))
        lowered = np.where(is_full, before >> 16, before)
        state[: len(below)] = ((lowered // share) << 16) + lowered % share + below
    # The decoder takes symbols in the opposite order, and so needs the last words first.
    return state, np.concatenate(words[::-1])


def decode(data: bytes, bits: Ints, sizes: Sequence[Size]) -> Codes:
    """The codes (N, C) that `encode` stored. `InputError` if the bytes are not of such codes."""
    model, start = CodeModel.from_bytes(data, bits)
    canvas = Canvas.of(sizes)
    count = len(canvas.cells) * len(bits)
    reader = _Reader(model, data[start:], _lanes(count))
    codes = np.zeros((len(canvas.cells), len(bits)), np.uint8)

    def read(texel: Ints, channel: Ints, curve: Curve) -> Ints:
        """The codes of a step, read by the coders in turn, and noted in `codes`."""
        codes_of_rounds = []
        for part in _rounds(len(texel), len(reader.state)):
            curve_of_round = Curve(*(numbers[part] for numbers in curve))
            codes_of_rounds.append(reader.codes(curve_of_round))
        codes_of_step = np.concatenate(codes_of_rounds)
        codes[texel, channel] = codes_of_step
        return codes_of_step

    _walk(model, canvas, read)
    reader.close()
    return codes


def _lanes(count: int) -> int:
    """The number of coders that share so many codes: many are fast in NumPy, but each costs bytes, so one in 1,024."""
    return max(1, min(1024, count >> 10))


def _rounds(count: int, lanes: int) -> list[slice]:
    """The parts of the `count` symbols of a step that the coders take in each round, one each."""
    return [slice(start, start + lanes) for start in range(0, count, lanes)]


def _walk(model: CodeModel, canvas: Canvas, code_step: Step) -> None:
    """Visit all codes in their order: `code_step` is given their distributions, and gives the codes.

    Encoder and decoder both do this, and know the same of each code: what came before it.
    """
    channels = len(model.bits)
    plane = canvas.plane
    offsets, weights = model.taps(canvas)
    values = np.zeros(channels * plane, np.int32)
    activity = np.full((1 + channels) * plane, USUAL, np.uint8)  # the first plane is before all channels
    for texel, channel in canvas.steps(channels):
        cell = channel * plane + canvas.cells[texel]
        near = values.take(cell[:, None] + offsets.take(channel, 0))  # (n, T)
        weighted = np.einsum("ij,ij->i", near, weights.take(channel, 0))  # the sum over each row's terms
        guess = model.guess(weighted.astype(np.int64))
        # The activity of a channel lies a plane further than its values, so `cell` is the channel before.
        before = activity[cell].astype(np.int64)
        around = canvas.around(activity, cell + plane)
        deviation = model.deviation(channel, around, before)
        code = code_step(texel, channel, model.curve(channel, guess, deviation))
        value = model.value(channel, code)
        now = model.activity(channel, value, guess, before)
        shadow = canvas.shadows[texel]  # 0 inside, where the same is written twice
        for there in (cell, cell + shadow):
            values[there] = value
            activity[there + plane] = now


class _Reader:
    """The coders of some bytes: their states (lanes,), and the words that are still to be read."""

    def __init__(self, model: CodeModel, data: bytes, lanes: int):
        """Split the data into the states of so many coders and the words. `InputError` if they are too short."""
        self.model = model
        self.words_read = 0
        if len(data) < 4 * lanes or len(data) % 2:
            raise InputError(f"a texture of this file has {len(data)} bytes for {lanes} coders: encode it again")
        self.state = np.frombuffer(data, "<u4", lanes).astype(np.int64)
        self.words = np.frombuffer(data, "<u2", offset=4 * lanes).astype(np.int64)
        self.least_bits = int(model.bits.min())
        self.most_bits = int(model.bits.max())

    def codes(self, curve: Curve) -> Ints:
        """The next code (n,) of as many coders: that whose share of the frequencies holds the state's low bits."""
        state = self.state[: len(curve.start)]
        slot = state & (TOTAL - 1)  # the low 16 bits
        code = np.zeros_like(slot)
        # The largest code whose share begins at the slot or below it, bit by bit from the highest. No code tried here
        # is 0, and those above the last are left out, so the faster `inside` does for `below`.
        for bit in reversed(range(self.most_bits)):
            tried = code + (1 << bit)
            is_reached = curve.inside(tried) <= slot
            if bit >= self.least_bits:  # a channel of fewer bits has no such code
                is_reached &= tried < curve.codes
            code += is_reached * (1 << bit)
        below, above = curve.below(code), curve.below(code + 1)
        # Undoes the step of `_encode_ranges`, which made of a state s: TOTAL · (s // share) + s % share + below.
        state = (above - below) * (state >> 16) + slot - below
        has_handed_on = state < TOTAL  # 16 bits, which are a word
        end = self.words_read + int(has_handed_on.sum())
        if end > len(self.words):
            raise InputError("a texture of this file ends before its codes: encode it again")
        state[has_handed_on] = (state[has_handed_on] << 16) | self.words[self.words_read : end]
        self.words_read = end
        self.state[: len(state)] = state
        return code

    def close(self) -> None:
        """Raise `InputError` unless every word is read and every state is as an encoder begins."""
        if self.words_read != len(self.words) or (self.state != TOTAL).any():
            raise InputError("a texture of this file holds other codes than were stored: encode it again")


def _fit_model(codes: Codes, bits: Ints, canvas: Canvas) -> CodeModel:
    """The model of codes (N, C): of each channel the terms, then the spread of what remains, then the mixture."""
    count, channels = codes.shape
    middle = codes.mean(0).round().astype(np.int64)
    mixture = np.tile(np.array(FIRST, np.int64), (channels, 1))
    model = CodeModel(bits, middle, spread=np.zeros_like(bits), mixture=mixture, terms=[])
    values = np.zeros(channels * canvas.plane, np.int32)
    for channel in range(channels):
        canvas.fill(values, channel, model.value(channel, codes[:, channel].astype(np.int64)))
    # About `CHOOSING_TEXELS`, evenly. The step is rounded up, and made odd by its lowest bit, because an even one could
    # share factors with the width, and all would lie in a few columns.
    every = math.ceil(count / CHOOSING_TEXELS) | 1
    choosing = np.arange(0, count, every)
    activity = np.full((1 + channels) * canvas.plane, USUAL, np.uint8)
    for channel in range(channels):
        cell = canvas.cells + channel * canvas.plane
        step = float(1 << (8 - bits[channel]))
        model.terms.append(_terms(values, cell[choosing], channel, count, step, canvas))
        weighted = np.zeros_like(cell)
        for term, weight in model.terms[-1]:
            weighted = weighted + values[cell + canvas.offset(term)] * weight
        guess = model.guess(weighted)
        error = (ONE * values[cell] - guess)[choosing].astype(np.float64)
        model.spread[channel] = _spread(error)
        # A channel's activity is in the plane after that of its values, so `cell` is the channel before.
        before = activity[cell].astype(np.int64)
        canvas.fill(activity, channel + 1, model.activity(channel, values[cell], guess, before))
        around = canvas.around(activity, cell + canvas.plane)
        code = codes[choosing, channel].astype(np.int64)
        model.mixture[channel] = _mixture(model, channel, code, guess[choosing], around[choosing], before[choosing])
    return model


def _spread(error: NDArray[np.float64]) -> int:
    """The spread of errors (n,), times `ONE`: their root mean square as the number that `CodeModel.scale` reads."""
    deviation = max(8, int(np.sqrt(np.square(error).mean())))
    exponent = deviation.bit_length() - 4  # four significant bits, the first of which is always 1
    return (exponent << 3) | ((deviation >> exponent) & 7)


def _terms(values: Ints, cell: Ints, channel: int, count: int, step: float, canvas: Canvas) -> list[tuple[int, int]]:
    """Choose the terms that predict a channel of `count` codes: pairs of a term's number and its weight.

    A term is one neighbour of a code, in its channel or an earlier one; the code is predicted as the weighted sum of
    its terms. They are chosen one at a time (forward selection, by least squares): always the one that explains most,
    until the next would save fewer bits than it takes.

    `values` are the planes of all channels, `cell` (n,) the places in them of the texels that choose, `step` the value
    from a code of the channel to the next.
    """
    candidates = np.arange(len(OWN) + len(AROUND) * min(channel, TRIED_BACK))
    offsets = np.array([canvas.offset(int(term)) for term in candidates])  # from a place to its neighbour's
    near = values[cell[:, None] + offsets].astype(np.float64)  # (n, candidates)
    target = values[cell].astype(np.float64)  # (n,)
    # The normal equations of least squares, and the squared error without any term.
    gram = near.T @ near  # (candidates, candidates)
    right_side = near.T @ target  # (candidates,)
    energy = float(target @ target)
    error_left = energy  # with the chosen terms
    gram += np.diag(NUDGE * (gram.diagonal() + len(cell)))
    floor = len(cell) * step**2 / 12  # the squared error of codes alone: below it, better guesses save nothing
    chosen: list[int] = []
    weights = np.zeros(0)
    while len(chosen) < MOST_TERMS:
        if chosen:
            # Of each candidate and of the target only that counts which the chosen terms do not explain.
            by_chosen = gram[chosen]  # (chosen, candidates)
            solved = np.linalg.solve(by_chosen[:, chosen], by_chosen)  # each candidate as a sum of the chosen terms
            new_part = gram.diagonal() - (by_chosen * solved).sum(0)  # (candidates,), squared
            new_right_side = right_side - solved.T @ right_side[chosen]
        else:
            new_part = gram.diagonal()
            new_right_side = right_side
        # By how much each candidate would lower the squared error.
        gain = np.square(new_right_side) / np.maximum(new_part, 1e-3 * len(cell))
        gain[chosen] = 0
        best = int(gain.argmax())
        # A code takes log2 of its deviation in bits and a constant, so half of log2 of the ratio of squared errors.
        saved = count / 2 * np.log2((error_left + floor) / (max(error_left - gain[best], 0) + floor))
        if saved < COST:
            break
        chosen.append(best)
        weights = np.linalg.solve(gram[np.ix_(chosen, chosen)], right_side[chosen])
        error_left = max(energy - float(weights @ right_side[chosen]), 0.0)
    whole_weights = np.clip(np.rint(ONE * weights), -128, 127).astype(int)
    terms = zip(chosen, whole_weights.tolist(), strict=True)
    return [(term, weight) for term, weight in terms if weight]


def _mixture(model: CodeModel, channel: int, code: Ints, guess: Ints, around: Ints, before: Ints) -> Ints:
    """The mixture (4,) with which codes (n,) of a channel take the fewest bits, searched for by changing one number at
    a time, while that helps. The other arguments (n,) are what `CodeModel` predicts the codes from."""

    def length(mixture: tuple[int, ...]) -> float:
        """The bits of the codes by a mixture, which the model then has."""
        model.mixture[channel] = mixture
        deviation = model.deviation(channel, around, before)
        curve = model.curve(channel, guess, deviation)
        share = curve.below(code + 1) - curve.below(code)
        return -float(np.log2(share / TOTAL).sum())

    best: tuple[int, ...] = FIRST
    lengths = {best: length(best)}
    improved = True
    while improved:
        improved = False
        for place, count in enumerate((16, 16, 16, len(SHAPES))):  # how many values each number may have
            for number in range(count):
                tried = (*best[:place], number, *best[place + 1 :])
                if tried in lengths:  # no better than the best, then as now
                    continue
                lengths[tried] = length(tried)
                if lengths[tried] < lengths[best]:
                    best = tried
                    improved = True
    return np.array(best)
