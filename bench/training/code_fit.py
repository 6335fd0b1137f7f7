"""Chooses the model that codes a texture: see `code_model`. Only the encoder calls it, so its floats decide nothing."""

import numpy as np
from numpy.typing import NDArray

from bench.training.code_model import AROUND, MOST_TERMS, ONE, OWN, SHAPES, TOTAL, USUAL, Canvas, CodeModel, Ints

Floats = NDArray[np.float64]

FITTED = 1 << 13  # texels of a larger texture that choose
BACK = 16  # channels that terms reach back
COST = 17.0  # bits of a term
NUDGE = 1e-6  # of a variance, so that terms that are alike can be told apart
FIRST = 8, 4, 4, 2  # the mixture where the search starts


def fitted(codes: NDArray[np.uint8], bits: Ints, canvas: Canvas) -> CodeModel:
    """The model of codes (N, C)."""
    count, channels = codes.shape
    middle = codes.mean(0).round().astype(np.int64)
    model = CodeModel(bits, middle, np.zeros_like(bits), np.tile(np.array(FIRST, np.int64), (channels, 1)), [])
    values = np.zeros(channels * canvas.plane, np.int32)
    for channel in range(channels):
        canvas.fill(values, channel, model.value(channel, codes[:, channel].astype(np.int64)))
    some = np.arange(0, count, -(-count // FITTED) | 1)
    activity = np.full((1 + channels) * canvas.plane, USUAL, np.uint8)
    for channel in range(channels):
        cell = canvas.cells + channel * canvas.plane
        model.terms.append(_terms(values, cell[some], channel, count, float(1 << 8 - bits[channel]), canvas))
        guess = sum((values[cell + canvas.offset(term)] * weight for term, weight in model.terms[-1]), 0 * cell)
        guess = model.guess(guess)
        error = (ONE * values[cell] - guess)[some]
        deviation = max(8, int(np.sqrt(np.square(error.astype(np.float64)).mean())))
        exponent = deviation.bit_length() - 4
        model.spread[channel] = exponent << 3 | (deviation >> exponent) & 7
        before = activity[cell].astype(np.int64)
        now = model.activity(channel, values[cell], guess, before)
        canvas.fill(activity, channel + 1, now)
        around = canvas.around(activity, cell + canvas.plane)
        seen = codes[some, channel].astype(np.int64), guess[some], around[some], before[some]
        model.mixture[channel] = _mixture(model, channel, *seen)
    return model


def _terms(values: Ints, cell: Ints, channel: int, count: int, step: float, canvas: Canvas) -> list[tuple[int, int]]:
    """What a channel of `count` codes reads, and its weights: each term saves more bits than it takes."""
    candidates = np.arange(len(OWN) + len(AROUND) * min(channel, BACK))
    near = values[cell[:, None] + np.array([canvas.offset(int(term)) for term in candidates])].astype(np.float64)
    wanted = values[cell].astype(np.float64)
    inner, outer, left = near.T @ near, near.T @ wanted, float(wanted @ wanted)
    inner += np.diag(NUDGE * (inner.diagonal() + len(cell)))
    floor, chosen, weights = len(cell) * step**2 / 12, list[int](), np.zeros(0)
    while len(chosen) < MOST_TERMS:
        both = inner[chosen]
        solved = np.linalg.solve(both[:, chosen], both) if chosen else both
        gain = np.square(outer - solved.T @ outer[chosen]) / np.maximum(
            inner.diagonal() - (both * solved).sum(0), 1e-3 * len(cell)
        )
        gain[chosen] = 0
        best = int(gain.argmax())
        if count / 2 * np.log2((left + floor) / (max(left - gain[best], 0) + floor)) < COST:
            break
        chosen.append(best)
        weights = np.linalg.solve(inner[np.ix_(chosen, chosen)], outer[chosen])
        left = max(float(wanted @ wanted - weights @ outer[chosen]), 0.0)
    rounded = np.clip(np.rint(ONE * weights), -128, 127).astype(int)
    return [(term, weight) for term, weight in zip(chosen, rounded.tolist(), strict=True) if weight]


def _mixture(model: CodeModel, channel: int, code: Ints, guess: Ints, around: Ints, before: Ints) -> Ints:
    """The mixture (4,) that takes the fewest bits: each number in turn, while that helps."""

    def length(mixture: tuple[int, ...]) -> float:
        model.mixture[channel] = mixture
        steepness = (1 << 26) // model.deviation(channel, around, before)
        curve = model.curve(channel, guess, steepness)
        return -float(np.log2((curve.below(code + 1) - curve.below(code)) / TOTAL).sum())

    best: tuple[int, ...] = FIRST
    least = length(best)
    improved = True
    while improved:
        improved = False
        for place, count in enumerate((16, 16, 16, len(SHAPES))):
            for number in range(count):
                tried = (*best[:place], number, *best[place + 1 :])
                if (found := length(tried)) < least:
                    best, least, improved = tried, found, True
    return np.array(best)
