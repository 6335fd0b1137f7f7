"""Stores the textures of most codecs: each channel in as few bits as matter, which the fit takes into account.

A channel is one of the numbers of each texel. A code is such a number, rounded to the bits of its channel.

From half of the fit on, a texture is looked up as its file will hold it, and the other parameters adapt to the
rounding. The bits of each channel are chosen by the error that its rounding adds to the fit; a texture from a codec
that is not fitted in steps, or from an autoencoder, is rounded in the same way at the end. See docs/decisions/0091.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Literal

import torch
from torch import Tensor, nn

from bench.inputs.errors import InputError
from bench.training.quantise import pack, unpack
from bench.training.texture_codes import MOST_BITS, bits_of, compress, expand

Sizes = Sequence[tuple[int, int]] | None  # of pictures (H, W) whose texels a texture (N, C) holds
Bits = Literal[0, 1, 2, 3, 4, 5, 6, 7, 8, 16, 32]  # of a stored number, on average; 0: left to the fit, 16, 32: floats

VERSION = 4  # part of the version of every codec: raise it if the codes or the choice of bits change
BEARABLE = 0.015  # share of the fit's squared error that rounding may add, if the fit chooses the bits
# Bits to which a channel is rounded alone, to measure the error that this adds; 0 if channels may have none.
PROBED_BITS = 4
MEASURED_TEXELS = 1 << 16  # texels of larger textures whose rounding is measured
RANGES = 29  # number of tried shares of a channel's range, from 0.3 to 1: smaller ones round finer and clip more


class Rounding(nn.Module):
    """The rounding of a texture (…, C), which a codec calls with all of it; none until `choose_bits` has chosen bits.

    Gradients ignore the rounding. Textures of 16 and 32 bits are stored as floats, and never rounded. With `least` 0, a
    channel that matters little becomes a constant, its mean, which takes no bits.
    """

    def __init__(self, channels: int, bits: int, least: int = 1, sizes: Sizes = None):
        """`bits` is the setting of that name: a mean over the texture's numbers, 0 to leave it to the fit. `sizes` are
        those of the pictures that a texture (N, C) holds; one (H, W, C) is a picture."""
        super().__init__()
        self.sizes = sizes
        self.mean_bits = bits  # on average over the texture's numbers; 0: left to the fit
        self.least = least  # of each channel
        self.low = nn.Buffer(torch.zeros(channels))  # the lowest value (C,) of each channel
        self.step = nn.Buffer(torch.zeros(channels))  # from one code to the next (C,)
        self.bits = nn.Buffer(torch.zeros(channels, dtype=torch.long))  # (C,), all 0: not chosen
        self.chosen = False  # whether there are bits: kept on the host, which else would wait for a GPU at each step
        self.trial: Callable[[Tensor], Tensor] | None = None  # the rounding that is tried while bits are chosen
        self.spent_bits: Tensor | None = None  # of the last step's texture in a file, estimated: a scalar

    @property
    def undecided(self) -> bool:
        """Whether bits must still be chosen."""
        return self.mean_bits <= MOST_BITS and self.bits.numel() > 0 and not self.chosen

    def forward(self, values: Tensor) -> Tensor:
        """Values (…, C) as the file holds them once bits are chosen; until then unchanged, or as a trial makes them."""
        if self.trial is not None:
            return self.trial(values)
        if not self.chosen:
            return values
        if torch.is_grad_enabled():
            self.spent_bits = self._estimated_bits(values)
        return rounded(values, self.low, self.step, self.bits)

    def _estimated_bits(self, values: Tensor) -> Tensor | None:
        """About the bits that a texture takes in a file, with a gradient; None if its pictures are not known, or all
        are single rows or columns."""
        # A single row or column of texels has no neighbours to predict from.
        if values.ndim == 3:
            return estimated_bits(values, self.step, self.bits) if min(values.shape[:2]) > 1 else None
        if self.sizes is None:
            return None
        pictures = values.split([height * width for height, width in self.sizes])
        bits = [
            estimated_bits(picture.unflatten(0, size), self.step, self.bits)
            for picture, size in zip(pictures, self.sizes, strict=True)
            if min(size) > 1
        ]
        return torch.stack(bits).sum() if bits else None

    def codes(self, values: Tensor) -> Tensor:
        """The codes (…, C), as floats, of values (…, C)."""
        return codes_of(values.detach(), self.low, self.step, self.bits)

    def fit_to(self, values: Tensor) -> "Rounding":
        """Itself, with the steps of final values (…, C); the bits stay, which were chosen by some of these values.

        A texture that is stored as floats has no steps.
        """
        if self.chosen:
            self.set(values, self.bits)
        return self

    def set(self, values: Tensor, bits: Tensor) -> None:
        """Round to bits (C,) from now on, by steps for these values (…, C)."""
        low, step = steps_for(values, bits.to(self.bits))
        self.low.copy_(low)
        self.step.copy_(step)
        self.bits.copy_(bits)
        self.chosen = True


@torch.no_grad()
def choose_bits(roundings: Sequence[Rounding], answers: Callable[[], Tensor], target: Tensor) -> None:
    """Choose the bits of textures by the change of `answers`, which should be `target`, if one channel is rounded.

    `answers()` looks the textures up through their roundings. These all want the same bits on average and have the same
    least bits, and the bits of all are shared out together. The squared error that a channel adds grows with the square
    of its rounding.
    """
    roundings = [rounding for rounding in roundings if rounding.undecided]
    if not roundings:
        return
    mean_bits, least = roundings[0].mean_bits, roundings[0].least
    # Look everything up once without any rounding, and note the texture (…, C) of each.
    texture_of: dict[Rounding, Tensor] = {}
    for rounding in roundings:
        rounding.trial = partial(_note, texture_of, rounding)
    exact = answers()
    for rounding in roundings:
        rounding.trial = None
    errors: list[Tensor] = []  # of each texture, the error (C, n) of each channel with each number of bits
    sizes: list[int] = []  # numbers of each channel of all textures
    for rounding, values in texture_of.items():
        errors.append(_added_errors(rounding, values, answers, exact, least))
        sizes += [math.prod(values.shape[:-1])] * values.shape[-1]
    if mean_bits:  # so many on average, else as many as it takes to keep the error bearable
        bearable = 0.0
        total = mean_bits * sum(sizes)
    else:
        bearable = BEARABLE * float((exact - target).square().mean())
        total = MOST_BITS * sum(sizes)
    bits = shared_out(torch.cat(errors).cpu(), torch.tensor(sizes), total, bearable, least)
    bits_of_textures = bits.split([len(of_texture) for of_texture in errors])
    for (rounding, values), bits_of_texture in zip(texture_of.items(), bits_of_textures, strict=True):
        rounding.set(values, bits_of_texture)


def _added_errors(
    rounding: Rounding, values: Tensor, answers: Callable[[], Tensor], exact: Tensor, least: int
) -> Tensor:
    """The error (C, n) that each channel of a texture (…, C) adds, rounded alone, with `least` to `MOST_BITS` bits.

    It is the mean squared change of `answers` from the `exact` ones. It is measured with one number of bits, and taken
    to grow with the square of the change of the texture.
    """
    # Where a channel may become its mean, this is tried: a channel of two values would lose nothing by 4 bits.
    probed_bits = PROBED_BITS if least else 0
    change = _change(values, probed_bits)
    changes_of_answers: list[Tensor] = []  # mean squared, of each channel
    for channel in range(values.shape[-1]):
        alone = torch.zeros_like(values)
        alone[..., channel] = change[..., channel]  # no other channel is rounded
        rounding.trial = partial(torch.add, alone)
        changes_of_answers.append((answers() - exact).square().mean())
    rounding.trial = None
    texels = values.flatten(0, -2)  # (N, C)
    every = math.ceil(len(texels) / MEASURED_TEXELS)  # rounded up, so that at most so many are left, evenly spread
    some = texels[::every]
    # (C, n): the mean squared change of each channel with each number of bits.
    changes = torch.stack([_change(some, bits).square().mean(0) for bits in range(least, MOST_BITS + 1)], 1)
    probed_change = changes[:, probed_bits - least].clamp_min(1e-30)
    return changes * (torch.stack(changes_of_answers) / probed_change)[:, None]


def round_after(
    texture: Tensor, bits: int, answers: Callable[[Tensor], Tensor], target: Tensor, least: int = 1
) -> Rounding:
    """The rounding of a finished texture (…, C) to `bits` a channel in the mean, and at least `least` in each.

    Which channel gets how many is chosen so that `answers(texture)` stays near the `target`.
    """
    rounding = Rounding(texture.shape[-1], bits, least).to(texture.device)
    choose_bits([rounding], lambda: answers(rounding(texture)), target)  # changes the rounding
    return rounding


def _note(texture_of: dict[Rounding, Tensor], rounding: Rounding, values: Tensor) -> Tensor:
    """Note the values that a rounding is called with, and return them unchanged."""
    texture_of[rounding] = values.detach()
    return values


def _change(values: Tensor, bits: int) -> Tensor:
    """The change of values (…, C) when each channel is rounded to some bits."""
    bits_of_channels = torch.full((values.shape[-1],), bits, device=values.device)
    low, step = steps_for(values, bits_of_channels)
    return rounded(values, low, step, bits_of_channels) - values


def steps_for(values: Tensor, bits: Tensor) -> tuple[Tensor, Tensor]:
    """Lowest value and step (C,) of values (…, C) that round them to bits (C,) with the least squared error of each.

    The one value that 0 bits can tell is the mean.
    """
    values = values.detach().flatten(0, -2)
    low, high = values.amin(0), values.amax(0)
    middle, half = (low + high) / 2, (high - low) / 2
    top = (2**bits - 1).clamp_min(1)  # the highest code; 1 for 0 bits, because it divides
    least_error = torch.full_like(middle, torch.inf)
    best_low = low.clone()
    best_step = (2 * half / top).clamp_min(1e-12)
    for share in torch.linspace(0.3, 1, RANGES).tolist():
        tried_low = middle - share * half
        tried_step = (2 * share * half / top).clamp_min(1e-12)
        error = (rounded(values, tried_low, tried_step, bits) - values).square().mean(0)
        better = error < least_error
        least_error = torch.where(better, error, least_error)
        best_low = torch.where(better, tried_low, best_low)
        best_step = torch.where(better, tried_step, best_step)
    return torch.where(bits == 0, values.mean(0), best_low), best_step


def shared_out(errors: Tensor, sizes: Tensor, total: int, bearable: float, least: int = 1) -> Tensor:
    """The bits (C,) of each channel, `least` to `MOST_BITS`, from the `errors` (C, n) that each of these adds.

    Each bit goes to the channel that adds most error for each of its `sizes` (C,) numbers, until all together add a
    bearable error, or `total` bits are spent: the last one may go beyond, if channels differ in size.
    """
    bits = torch.full((len(errors),), least)
    total = min(total, MOST_BITS * int(sizes.sum()))  # no number has more than `MOST_BITS`
    while (bits * sizes).sum() < total:
        column = bits - least  # (C,): column i of `errors` is of `least` + i bits
        added = errors.gather(1, column[:, None])[:, 0]  # (C,): what each channel adds with its bits so far
        if added.sum() <= bearable:
            break
        worth = torch.where(bits < MOST_BITS, added / sizes, -torch.inf)
        bits[worth.argmax()] += 1
    return bits


def estimated_bits(values: Tensor, step: Tensor, bits: Tensor) -> Tensor:
    """About the bits that the codes of a texture (H, W, C) take in a file, with a gradient; codes have steps (C,).

    A code is predicted by three neighbours, and what remains is taken to follow Laplace's distribution, whose entropy
    is log2(2e · its mean magnitude) where that is large. A channel of no bits takes none.
    """
    steps = values / step.clamp_min(1e-12)
    above, left, corner = steps[:-1, 1:], steps[1:, :-1], steps[:-1, :-1]
    rest = steps[1:, 1:] - (0.75 * (above + left) - 0.5 * corner)
    bits_a_code = torch.log2(1 + 2 * math.e * rest.abs().mean((0, 1)))  # (C,)
    return math.prod(values.shape[:2]) * (bits_a_code * (bits > 0)).sum()


def codes_of(values: Tensor, low: Tensor, step: Tensor, bits: Tensor) -> Tensor:
    """Codes, as floats from 0 to 2^bits − 1, of values (…, C), by each channel's lowest value, step and bits (C,)."""
    return ((values - low) / step).round().clamp_min(0).minimum(2.0**bits - 1)


def rounded(values: Tensor, low: Tensor, step: Tensor, bits: Tensor) -> Tensor:
    """Values (…, C) as read back from a file; gradients ignore the rounding."""
    with torch.no_grad():
        change = low + step * codes_of(values, low, step, bits) - values
    return values + change


@torch.no_grad()
def store_texture(name: str, values: Tensor, rounding: Rounding, sizes: Sizes = None) -> dict[str, Tensor]:
    """A texture (…, C) as named tensors: codes, steps and size, or floats. `load_texture` needs the same sizes."""
    if rounding.mean_bits > MOST_BITS or not values.numel():
        return pack(name, values, "float32" if rounding.mean_bits == 32 else "half")
    return {
        name: compress(rounding.codes(values), rounding.bits.tolist(), sizes),
        f"{name}.low": rounding.low,
        f"{name}.step": rounding.step,
        f"{name}.size": torch.tensor(values.shape[:-1], dtype=torch.int32),
    }


@torch.no_grad()
def store_table(name: str, table: Tensor, rounding: Rounding, axis: int) -> dict[str, Tensor]:
    """A table (H, W, A, B) as named tensors for `load_table`: a picture (H, W) of A · B channels, B the fastest.

    The rounding has the channels of `axis`, 2 or 3; those along the other axis share their bits and steps.
    """
    if rounding.mean_bits > MOST_BITS or not table.numel():
        return pack(name, table, "float32" if rounding.mean_bits == 32 else "half")
    codes = rounding.codes(table.movedim(axis, 3)).movedim(3, axis)  # (H, W, A, B)
    bits = rounding.bits.expand(table.shape[5 - axis], -1)  # 5 − axis is the other axis
    if axis == 2:
        bits = bits.T  # (A, B)
    size = list(table.shape)
    del size[axis]  # as many as there are steps
    return {
        name: compress(codes.flatten(2), bits.flatten().tolist()),
        f"{name}.low": rounding.low,
        f"{name}.step": rounding.step,
        f"{name}.size": torch.tensor(size, dtype=torch.int32),
    }


def store_alike(name: str, values: Tensor, stored: dict[str, Tensor]) -> dict[str, Tensor]:
    """A texture (…, C) as named tensors; each channel gets the bits that it has in another texture of C channels.

    `stored` are the tensors that `store_texture` made of that texture, under the same name.
    """
    if f"{name}.step" not in stored:
        return pack(name, values, "half" if stored[name].dtype == torch.float16 else "float32")
    rounding = Rounding(values.shape[-1], MOST_BITS)  # any number of bits but those of floats: the next line sets them
    rounding.set(values, bits_of(stored[name], values.shape[-1]))
    return store_texture(name, values, rounding)


def load_texture(name: str, tensors: dict[str, Tensor], sizes: Sizes = None) -> Tensor:
    """The texture (…, C), float32, that `store_texture` stored. `InputError` if the bytes hold no such texture."""
    if f"{name}.step" not in tensors:
        return unpack(name, tensors)
    low, step = _steps(name, tensors)
    shape = (*tensors[f"{name}.size"].tolist(), len(step))
    return expand(tensors[name], shape, sizes) * step + low


def load_table(name: str, tensors: dict[str, Tensor], axis: int) -> Tensor:
    """The table (H, W, A, B), float32, that `store_table` stored. `InputError` if the bytes hold no such table."""
    if f"{name}.step" not in tensors:
        table = unpack(name, tensors)
        if table.ndim == 4:
            return table
    else:
        low, step = _steps(name, tensors)
        size = tensors[f"{name}.size"].tolist()
        size.insert(axis, len(step))
        if len(size) == 4:
            codes = expand(tensors[name], (*size[:2], size[2] * size[3])).unflatten(2, size[2:])
            return (codes.movedim(axis, 3) * step + low).movedim(3, axis).contiguous()
    raise InputError("a table of this file has not four axes: encode it again")


def _steps(name: str, tensors: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
    """The lowest value and the step (C,) of each channel."""
    low, step = tensors[f"{name}.low"], tensors[f"{name}.step"]
    if step.ndim != 1 or low.shape != step.shape:  # other shapes would be broadcast over all codes
        shapes = f"{tuple(step.shape)} from {tuple(low.shape)}"
        raise InputError(f"a texture of this file has steps {shapes}: encode it again")
    return low, step
