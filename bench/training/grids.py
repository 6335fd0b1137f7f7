"""A neural texture on up to three grids: channels at full, half and quarter resolution, fetched at one place.

Grid points hold latents. A channel at a quarter takes a sixteenth of the bits of one at full resolution, and many
channels of a surface change slowly. A look-up may also be moved along the view, by a depth that a small network finds:
where a texel blurs a relief over the places at which views see it, this sharpens it, without a height.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from bench.btf import periods
from bench.inputs.errors import InputError
from bench.inputs.settings import IF_SET, Range
from bench.training.decoder import Architecture, Decoder
from bench.training.stored_texture import Rounding, load_texture, store_texture

FACTORS = {"latents": 1, "latents2": 2, "latents4": 4, "offset": 4}  # texels a side of a point of each grid
OFFSET_CHANNELS = 4  # of the grid that the offset's network reads

LOWEST = 0.2  # cosine of a view: nearer to the horizon (78.5°) it moves a look-up no further
Further = Annotated[int, Range(0, 4096)]  # channels, or none


@dataclass(frozen=True)
class GridSettings:
    """The further grids of a texture whose channels at full resolution are the setting `latents`."""

    half: Further = field(default=0, metadata=IF_SET)  # further channels at half the resolution
    quarter: Further = field(default=0, metadata=IF_SET)  # further channels at a quarter of it
    offset: Further = field(default=0, metadata=IF_SET)  # hidden channels of what moves a look-up along the view


def channels(settings: Any, offset: bool = True) -> dict[str, int]:
    """The number of channels of each grid that has some.

    The grid of the offset is read by the offset's network, not by the decoder: `offset=False` leaves it out.
    """
    counts = {"latents": settings.latents, "latents2": settings.half, "latents4": settings.quarter}
    if offset and settings.offset:
        counts["offset"] = OFFSET_CHANNELS
    return {name: count for name, count in counts.items() if count}


def total_channels(settings: Any) -> int:
    """The number of channels that the decoder reads, of all grids together."""
    return sum(channels(settings, offset=False).values())


def size_of(name: str, shape: tuple[int, int]) -> tuple[int, int]:
    """The size of a grid by name, over a picture (H, W); incomplete points at the edges count."""
    factor = FACTORS[name]
    height, width = shape
    return math.ceil(height / factor), math.ceil(width / factor)


def on_grids(first: Tensor, shape: tuple[int, int], counts: dict[str, int]) -> dict[str, Tensor]:
    """Latents (H · W, C) of a picture (H, W) as means on grids (h, w, c), with `counts` channels c of each.

    The first channels are for the grid at full resolution, the next for that at half, then a quarter. The offset's grid
    has the first channels again: components that separate texels also separate heights.
    """
    picture = first.T.unflatten(1, shape)  # (C, H, W), as pooling takes it
    grids = {}
    start = 0  # first of the channels that no grid has yet
    for name, count in counts.items():
        part = picture[:count] if name == "offset" else picture[start : start + count]
        start += len(part)  # the offset's grid is the last
        missing = picture.new_zeros(count - len(part), *shape)  # of an offset of more channels than all latents
        mean = functional.adaptive_avg_pool2d(torch.cat([part, missing]), size_of(name, shape))
        grids[name] = mean.permute(1, 2, 0).contiguous()  # (h, w, c)
    return grids


class Grids(nn.Module):
    """The grids of a fit, free: `values[name]` (h, w, C), and the rounding of each."""

    def __init__(
        self,
        first: Tensor,
        shape: tuple[int, int],
        settings: Any,
        offset: bool = True,
        bound: Callable[[Tensor], Tensor] | None = None,
    ):
        """Start at latents (H · W, `total_channels`), shared out by `on_grids`.

        `offset=False` leaves out the offset's grid. `bound` is applied to the free numbers: what it returns is looked
        up and stored.
        """
        super().__init__()
        self.bound = bound or nn.Identity()
        self.values: Any = nn.ParameterDict()
        self.roundings: Any = nn.ModuleDict()
        for name, mean in on_grids(first, shape, channels(settings, offset)).items():
            self.values[name] = nn.Parameter(mean)
            self.roundings[name] = Rounding(mean.shape[2], settings.bits)

    def rounded(self) -> dict[str, Tensor]:
        """The grids (h, w, C) as they are looked up: from half of the fit on as the file will hold them."""
        return {name: self.roundings[name](self.bound(values)) for name, values in self.values.items()}

    def stored(self) -> dict[str, Tensor]:
        """The tensors of a file."""
        stored: dict[str, Tensor] = {}
        for name, values in self.values.items():
            stored |= store_texture(name, self.bound(values), self.roundings[name])
        return stored


def load_grids(
    stored: dict[str, Tensor], settings: Any, shape: tuple[int, int], offset: bool = True
) -> dict[str, Tensor]:
    """The grids (h, w, C) of a picture (H, W) by name from `Grids.stored`. `InputError` if their sizes differ."""
    grids = {}
    for name, count in channels(settings, offset).items():
        grids[name] = load_texture(name, stored)
        expected = (*size_of(name, shape), count)
        if grids[name].shape != expected or min(shape) < 1:  # no texels make no grid
            size = " × ".join(map(str, grids[name].shape))
            raise InputError(f"grid {name} of this file is {size}, of {shape[0]} × {shape[1]} texels: encode it again")
    return grids


class Offset(nn.Module):
    """Moves a look-up along the view, by a depth of the offset's latents and, with `by_view`, of ω_o.

    The scale of the depth, the gate, starts at 0. Moved freely, as NeuralBTF does, neighbouring views of a periodic
    surface such as corduroy settle periods apart, and a view between them sees it half a period away: docs/relief.md.
    """

    def __init__(
        self,
        width: int,
        size: tuple[int, int],
        generator: torch.Generator | None = None,
        by_view: bool = True,
        channels: int = OFFSET_CHANNELS,
    ):
        """Make the network, of `width` hidden channels, for a picture of `size` (H, W) and latents of `channels`."""
        super().__init__()
        # (2,): the longer side in uv along u and along v. 1 and 1 of a square picture.
        self.periods = nn.Buffer(torch.tensor(periods(size)), persistent=False)
        self.by_view = by_view
        inputs = channels + 3 * by_view  # x, y and z of ω_o
        self.decoder = Decoder(Architecture(inputs, (width,), outputs=1), generator)
        self.gate = nn.Parameter(torch.zeros(1))

    @property
    def flops(self) -> int:
        """Operations of one sample, a fused multiply-add counted as two."""
        return self.decoder.architecture.flops + 9  # those of `moved`

    def moved(self, uv: Tensor, latents: Tensor, wo: Tensor) -> Tensor:
        """uv (n, 2), moved along views wo (n, 3) by the depth of latents (n, `channels`) there.

        Depths are in units of the picture's longer side, so that a depth moves as far along u as along v.
        """
        inputs = torch.cat([latents, wo.to(latents.dtype)], 1) if self.by_view else latents
        depth = self.gate * self.decoder(inputs).tanh()
        slope = wo[:, :2] / wo[:, 2:].clamp_min(LOWEST)  # sideways for each unit of depth
        return uv + depth.to(uv.dtype) * slope.to(uv.dtype) * self.periods.to(uv.dtype)
