"""What predicts a code of a texture from its neighbours and from earlier channels, in integers alone.

A texture has a number for each texel and channel; a code is such a number, rounded to as many bits as its channel has.
The codes of a channel are a plane. A code is predicted as a weighted sum of codes around it: of its channel, those
before it; of channels before, all nine around. What remains follows Student's t, whose scale grows with the errors near
by. Weights and shapes are chosen by the encoder and stored, so nothing is learned while decoding, and all channels and
rows are decoded side by side: texel (x, y) of channel c at step x + 2 y + 4 c. Its symbols go to interleaved range
coders (rANS: Duda 2013, Giesen 2014). Every number that decides about a symbol is an integer, so that a file decodes
alike on every machine.
"""

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.inputs.errors import InputError

Ints = NDArray[np.int64]
Size = tuple[int, int]

LAG = 4  # steps from a channel to the next: its nine neighbours are known by then
OWN = [(0, -1), (-1, 0), (-1, -1), (-1, 1), (0, -2), (-2, 0)]  # (rows, columns) from a code to those of its channel
AROUND = [(0, 0), (0, -1), (-1, 0), (0, 1), (1, 0), (-1, -1), (-1, 1), (1, -1), (1, 1)]  # and of an earlier one
MOST_TERMS = 15  # of a prediction
MOST_BACK = (255 - len(OWN)) // len(AROUND)  # channels that a term can reach back, because its number is a byte
ONE = 64  # the fixed point of weights, predictions and activity
SHAPES = (2, 4, 8, 64)  # degrees of freedom; all even, so that the distribution has a closed form
FINE, REACH = 1024, 1 << 14  # entries of the distribution's table for a scale, and to each side
TOTAL = 1 << 16  # of the frequencies of a symbol, and the least state of a coder
USUAL = 51  # activity where none is known: 0.8 scales, a normal density's mean absolute error
MOST_GUESS = 1 << 15  # of a prediction times `ONE`, either sign: twice the largest value
FEW_STEPS = 1 << 10  # that any texture may take: some tenths of a second
LEAST_CODES = 64  # for each further step: with fewer, most of its time is NumPy's overhead
HEAD = 5  # bytes of a channel's parameters before its terms
UNREADABLE = "a texture of this file does not say how its codes are predicted: encode it again"


@dataclass(frozen=True)
class Canvas:
    """Pictures one below the other, each transposed if all are tall (`is_tall`), which takes fewer steps.

    Around them is a frame: 2 above, 1 below, 2 on the left, 1 on the right.
    """

    stride: int
    plane: int  # numbers of a channel, frame included
    cells: Ints  # (N,) where each texel is
    shadows: Ints  # (N,) from a texel at the border to the place beyond it that repeats it; 0 elsewhere
    order: Ints  # (N,) texels by x + 2 y
    starts: Ints  # (steps + 1,) where each x + 2 y starts in `order`

    @classmethod
    def of(cls, sizes: Sequence[Size]) -> "Canvas":
        """The canvas of pictures of some sizes (H, W), whose texels come one picture after the other, row by row."""
        tall = is_tall(sizes)
        stride = 3 + max(width for _, width in _placed(sizes))
        top = 0
        rows, columns, shadows = [], [], []
        for height, width in sizes:
            y, x = np.divmod(np.arange(height * width), width)
            if tall:  # transposed: rows become columns
                x, y, height, width = y, x, width, height
            shadow = np.zeros_like(x)
            # On the left the place is a row further down: there a row repeats the first texel of the row above it,
            # since its own is not decoded yet.
            shadow[x == width - 1] = 1
            shadow[x == 0] = stride - 1
            rows.append(y + top)
            columns.append(x)
            shadows.append(shadow)
            top += height
        y, x = np.concatenate(rows), np.concatenate(columns)
        level = x + 2 * y
        order = np.argsort(level, kind="stable")
        starts = np.searchsorted(level[order], np.arange(int(level.max()) + 2))  # and the end of the last
        cells = (y + 2) * stride + x + 2  # behind the frame: two rows above, two columns on the left
        return cls(stride, (top + 3) * stride, cells, np.concatenate(shadows), order, starts)

    def steps(self, channels: int) -> Iterator[tuple[Ints, Ints]]:
        """The texels and channels (n,) of each step of decoding: in channel c, the texels with x + 2 y = step − 4 c."""
        levels = len(self.starts) - 1
        channel = np.arange(channels)
        for step in range(levels + LAG * (channels - 1)):
            level = step - LAG * channel
            active = channel[(level >= 0) & (level < levels)]  # the channels that have texels in this step
            start = self.starts[step - LAG * active]
            end = self.starts[step - LAG * active + 1]
            sizes = end - start
            total = int(sizes.sum())
            if total:
                # Joins the stretches of `order` from each start to its end: texel number i of the step is place
                # i − before of its own channel's stretch.
                before = np.cumsum(sizes) - sizes  # texels of the channels before each
                place = np.arange(total) + np.repeat(start - before, sizes)
                yield self.order[place], np.repeat(active, sizes)

    def fill(self, planes: Ints, plane: int, values: Ints) -> None:
        """Write the values (N,) of all texels to a plane, and what repeats them beyond the border."""
        for cells in (self.cells, self.cells + self.shadows):
            planes[plane * self.plane + cells] = values

    def around(self, planes: NDArray[np.integer], cell: Ints) -> Ints:
        """The mean (n,) of what is left of cells (n,) and above them; what shares a side counts three times."""

        def back(places: int) -> Ints:
            """What lies so many places before each cell, (n,)."""
            return planes[cell - places].astype(np.int64)

        left, above = back(1), back(self.stride)
        above_right, above_left = back(self.stride - 1), back(self.stride + 1)
        return (3 * (left + above) + above_right + above_left) >> 3  # over 8, the sum of the weights

    def offset(self, term: int) -> int:
        """How far from a code the one is that a term reads, in an array of the planes of all channels.

        Terms are numbered: first `OWN`, then `AROUND` in the channel before, in the one before that, and so on.
        """
        if term < len(OWN):
            rows, columns = OWN[term]
            return rows * self.stride + columns
        back, around = divmod(term - len(OWN), len(AROUND))
        rows, columns = AROUND[around]
        return rows * self.stride + columns - (back + 1) * self.plane


def is_tall(sizes: Sequence[Size]) -> bool:
    """Whether pictures one below the other are more than twice as high as wide."""
    return sum(height for height, _ in sizes) > 2 * max(width for _, width in sizes)


def _placed(sizes: Sequence[Size]) -> Sequence[Size]:
    """The sizes of pictures as they lie on a canvas: transposed, if they are tall."""
    if is_tall(sizes):
        return [(width, height) for height, width in sizes]
    return sizes


def feasible(sizes: Sequence[Size], channels: int) -> bool:
    """Whether pictures of these sizes have texels, and take a number of steps that suits the number of codes."""
    if min(min(size) for size in sizes) < 1:
        return False
    sides = _placed(sizes)
    # A little more than the last x + 2 y of a canvas, and the lag of all channels.
    steps = max(width for _, width in sides) + 2 * sum(height for height, _ in sides) + LAG * channels
    codes = channels * sum(height * width for height, width in sizes)
    return steps <= FEW_STEPS + codes // LEAST_CODES


@dataclass
class CodeModel:
    """What predicts the codes of C channels, on the scale of eight bits: stored as bytes, and used as it is stored."""

    bits: Ints  # (C,)
    middle: Ints  # (C,) the code that counts as 0
    spread: Ints  # (C,) a small floating-point number: three bits of fraction below the exponent
    mixture: Ints  # (C, 4) of the scale: constant, activity around, activity of the channel before; and the shape
    terms: list[list[tuple[int, int]]]  # of each channel: what it reads, and its weight

    def to_bytes(self) -> bytes:
        """The bytes of each channel in turn: `HEAD` of parameters, then what each term reads, then the terms' weights.

        Parameters are middle, spread, two bytes of the mixture's four numbers, four bits each, and the count of terms.
        """
        out = bytearray()
        for channel, terms in enumerate(self.terms):
            constant, around, before, shape = self.mixture[channel].tolist()
            read = [term for term, _ in terms]
            weights = [weight & 255 for _, weight in terms]  # signed bytes, in two's complement
            out += bytes([self.middle[channel], self.spread[channel], (constant << 4) | around, (before << 4) | shape])
            out += bytes([len(terms), *read, *weights])
        return bytes(out)

    @classmethod
    def from_bytes(cls, data: bytes, bits: Ints) -> tuple["CodeModel", int]:
        """A model, and the number of bytes that it takes; `InputError` if `to_bytes` cannot have written them."""
        place = 0
        heads = []
        terms = list[list[tuple[int, int]]]()
        for channel in range(len(bits)):
            head = data[place : place + HEAD]
            if len(head) < HEAD:  # the data end here
                raise InputError(UNREADABLE)
            middle, spread, first_two, last_two, count = head
            # Two numbers of four bits in a byte.
            constant, around = first_two >> 4, first_two & 15
            before, shape = last_two >> 4, last_two & 15
            body = np.frombuffer(data[place + HEAD : place + HEAD + 2 * count], np.int8)
            read = body[:count].view(np.uint8).tolist()
            weights = body[count:].tolist()
            readable = len(OWN) + len(AROUND) * min(channel, MOST_BACK)
            # A spread from 128 on would give an exponent over 15, which no error needs.
            is_valid = count <= MOST_TERMS and len(body) == 2 * count and spread < 128 and shape < len(SHAPES)
            if not is_valid or max(read, default=0) >= readable:
                raise InputError(UNREADABLE)
            heads.append([middle, spread, constant, around, before, shape])
            terms.append(list(zip(read, weights, strict=True)))
            place += HEAD + 2 * count
        table = np.array(heads, np.int64)
        return cls(bits, table[:, 0], table[:, 1], table[:, 2:], terms), place

    @property
    def scale(self) -> Ints:
        """The scale (C,) of the errors, in which activity is measured: 1 + fraction / 8, times 2^(exponent + 3)."""
        return (8 + (self.spread & 7)) << (self.spread >> 3)

    def deviation(self, channel: Ints | int, around: Ints, before: Ints) -> Ints:
        """The scale (n,) of what remains, from the activity near by: `around`, and of the channel `before` (n,)."""
        constant, of_around, of_before, _ = self.mixture[channel].T
        share = constant * ONE + of_around * around + of_before * before
        # A number of the mixture counts 16 as 1, and activity `ONE`: 2^4 · 2^6 is 2^10.
        return np.maximum((self.scale[channel] * share) >> 10, 1)

    def value(self, channel: Ints | int, code: Ints) -> Ints:
        """What a code (n,) stands for, on the scale of eight bits."""
        return (code - self.middle[channel]) << (8 - self.bits[channel])

    def guess(self, weighted: Ints) -> Ints:
        """The prediction (n,), times `ONE`, from the sums of weighted terms."""
        return np.minimum(np.maximum(weighted, -MOST_GUESS), MOST_GUESS)

    def activity(self, channel: Ints | int, value: Ints, guess: Ints, before: Ints) -> Ints:
        """The activity (n,) of a texel up to this channel, from that up to the one `before`: a running mean of errors,
        over their scale and times `ONE`, in which this channel's counts a quarter."""
        error = np.abs(ONE * value - guess)
        inverse = (1 << 20) // self.scale[channel]  # times 2^20, because there are only integers
        here = (error * inverse) >> 14  # error / scale · `ONE`, because 2^20 is 2^14 · `ONE`
        return (3 * before + np.minimum(here, 255)) >> 2  # below 256, so that it fits a byte

    def taps(self, canvas: Canvas) -> tuple[Ints, NDArray[np.int32]]:
        """The offsets and the weights, int32, (C, T) of the terms of each channel; T is the most that one has.

        A channel with fewer has weights of 0 in the other places.
        """
        most = max([1, *(len(terms) for terms in self.terms)])
        offsets, weights = np.zeros((2, len(self.terms), most), np.int64)
        for channel, terms in enumerate(self.terms):
            for place, (term, weight) in enumerate(terms):
                offsets[channel, place] = canvas.offset(term)
                weights[channel, place] = weight
        return offsets, weights.astype(np.int32)

    def curve(self, channel: Ints | int, guess: Ints, deviation: Ints) -> "Curve":
        """The distributions (n,) of codes around guesses, of the given `deviation`.

        A place in the table is in 1/FINE of a scale, times 2^16, and FINE · 2^16 is 2^26.
        """
        bits = self.bits[channel]
        steepness = (1 << 26) // deviation
        # Code 0 begins half a code below its value, which is −middle codes of 2^(8 − bits). It is counted in halves of
        # a code, to be an integer, times `ONE` / 2.
        first = ONE // 2 * ((-2 * self.middle[channel] - 1) << (8 - bits))
        start = (first - guess) * steepness
        slope = (ONE << (8 - bits)) * steepness
        middle = self.mixture[channel, 3] * (2 * REACH) + REACH  # of the shape's table
        codes = 1 << bits
        return Curve(start, slope, middle, codes, TOTAL - codes)


class Curve(NamedTuple):
    """Distributions (n,) of codes: the place in the table where each code begins, times 2^16, is linear in the code."""

    start: Ints  # that of code 0
    slope: Ints  # from a code to the next
    middle: Ints  # of each one's table in `cumulative`
    codes: Ints  # how many there are
    room: Ints  # TOTAL − codes, as each takes at least one

    def inside(self, code: Ints) -> Ints:
        """The frequencies (n,) of all codes below these, from 1 to the last: their share of `room` by the table, and
        one for each of them. In place, because this takes much of the time."""
        place = self.start + code * self.slope
        place >>= 16  # in 1/FINE of a scale
        np.maximum(place, -REACH, out=place)
        np.minimum(place, REACH - 1, out=place)
        place += self.middle
        below = cumulative().take(place)
        below *= self.room
        below >>= 16
        below += code
        return below

    def below(self, code: Ints) -> Ints:
        """The frequencies (n,) of all codes below these, 0 and the number of codes among them."""
        frequencies = np.where(code >= self.codes, TOTAL, self.inside(code))
        return np.where(code <= 0, 0, frequencies)


@functools.cache
def cumulative() -> Ints:
    """Student's t distributions of 2^16, one after the other (shapes · 2 REACH,), at every 1/FINE of a scale.

    For 2 k degrees of freedom: 1/2 + 1/2 sin a Σ_{i<k} C(2 i, i) / 4^i cos^{2 i} a with tan a = t / √(2 k)
    (Abramowitz and Stegun 1964, 26.7.4). In integers: the cosine's square and the terms of the sum times 2^24, the sine
    times 2^17.
    """
    tables = []
    squares = np.arange(REACH, dtype=np.int64) ** 2  # of each t, times FINE²
    for freedom in SHAPES:
        whole = freedom * FINE**2 + squares
        squared_cosine = ((freedom * FINE**2) << 24) // whole
        term = np.full(REACH, 1 << 24)
        total = term
        for i in range(1, freedom // 2):
            # C(2 i, i) / 4^i is the one before times (2 i − 1) / (2 i).
            term = ((term * squared_cosine) >> 24) * (2 * i - 1) // (2 * i)
            total = total + term
        sine = _square_roots((squares << 34) // whole)
        # Half of sine · total, from 2^17 · 2^24 to 2^16, the sum of frequencies. Rounding must not let it fall.
        upper = np.maximum.accumulate(TOTAL // 2 + ((sine * total) >> 26))
        # The lower half mirrors the upper one, without 0; its first entry stands twice, to make 2 REACH.
        tables.append(np.concatenate([TOTAL - upper[-1:], TOTAL - upper[:0:-1], upper]))
    return np.concatenate(tables)


def _square_roots(values: Ints) -> Ints:
    """The square roots (n,) of whole numbers below 2^36, rounded down: Newton's method from above, in integers."""
    roots = np.full_like(values, 1 << 18)
    while True:
        better = (roots + values // np.maximum(roots, 1)) >> 1
        if (better >= roots).all():
            return roots
        roots = np.minimum(roots, better)
