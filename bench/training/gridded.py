"""What codecs share whose texture may lie on several grids and be looked up along the view.

The settings are those of `bench.training.grids.GridSettings`. Without them there is one texture at full resolution, and
neither answers nor files differ from those of a codec that has no such settings.
"""

from typing import Any

import torch
from torch import Tensor, nn

from bench.codec import Parts
from bench.material import DecoderCost, Material, sample_texture, to_radiance
from bench.training.grids import FACTORS, OFFSET_CHANNELS, Grids, Offset, load_grids, total_channels
from bench.training.initial_latents import Start, first_latents
from bench.training.inputs import Directions, direction_inputs
from bench.training.samples import Batch, Samples
from bench.training.stored_texture import load_texture
from bench.training.texture_fit import TextureObjective


def is_gridded(settings: Any) -> bool:
    """Whether settings ask for more than one texture at full resolution."""
    return bool(settings.half or settings.quarter or settings.offset)


class GriddedNetwork(nn.Module):
    """A codec's own network, `decoder`, and the offset's if the settings ask for one, over a picture of `size` (H, W).

    `decoder` may be any module; it is called with the inputs of this one.
    """

    def __init__(
        self,
        decoder: nn.Module,
        settings: Any,
        size: tuple[int, ...],
        generator: torch.Generator | None = None,
        offset_channels: int = OFFSET_CHANNELS,
    ):
        super().__init__()
        self.decoder: Any = decoder
        self.offset: Offset | None = None
        if settings.offset:
            height, width = size
            self.offset = Offset(settings.offset, (height, width), generator, channels=offset_channels)

    def forward(self, *inputs: Tensor) -> Tensor:
        return self.decoder(*inputs)

    def fetch(self, grids: dict[str, Tensor], uv: Tensor, wo: Tensor) -> Tensor:
        """The latents (n, D) of all grids (h, w, C) at uv (n, 2), where the offset moves it for views wo (n, 3)."""
        if self.offset is not None:
            uv = self.offset.moved(uv, sample_texture(grids["offset"], uv), wo)
        names = [name for name in FACTORS if name in grids and name != "offset"]
        return torch.cat([sample_texture(grids[name], uv) for name in names], 1)

    def fetch_batch(self, grids: dict[str, Tensor], samples: Samples, batch: Batch) -> Tensor:
        """The latents (n, D) of all grids (h, w, C) for a batch."""
        if grids.keys() == {"latents"}:  # queries are at centres of texels
            return grids["latents"].flatten(0, 1).index_select(0, batch.texel)
        return self.fetch(grids, samples.centres(batch.texel), samples.wo.index_select(0, batch.pair))


def first_grids(samples: Samples, settings: Any, start: Start, generator: torch.Generator, **more: Any) -> Grids:
    """The grids of a fit at their first latents; `more` are further arguments of `Grids`."""
    first = first_latents(samples, total_channels(settings), start, generator)
    return Grids(first, samples.shape, settings, **more)


def gridded_parts(objective: TextureObjective, grids: Grids, **textures: Tensor) -> Parts:
    """The parts of a file: the network of an objective, its grids, and the tensors of further textures."""
    other = {}
    if is_gridded(objective.settings):
        other["size"] = torch.tensor(objective.samples.shape, dtype=torch.int32)
    return objective.parts(grids.stored() | textures, **other)


def load_gridded(parts: Parts, settings: Any) -> dict[str, Tensor]:
    """The grids (h, w, C) by name of the parts of a file. `InputError` if their sizes contradict each other."""
    if not is_gridded(settings):
        return {"latents": load_texture("latents", parts.texture)}
    height, width = parts.other["size"].tolist()
    return load_grids(parts.texture, settings, (height, width))


class GriddedMaterial(Material):
    """Grids (h, w, C) by name and a network, from which a codec's own class answers; `grids` may hold further textures
    (H, W, C)."""

    def __init__(self, network: GriddedNetwork, grids: dict[str, Tensor], flops: int, gain: float):
        """Count the cost of an answer, of which the codec's own network takes `flops`, and keep the parts."""
        channels = [grid.shape[2] for name, grid in grids.items() if FACTORS.get(name, 1) == 1]  # of full resolution
        numbers_read = sum(4 * grid.shape[2] for grid in grids.values())  # four texels around a place, of each grid
        interpolation_flops = 2 * numbers_read  # each is multiplied and added
        offset_flops = network.offset.flops if network.offset is not None else 0
        latents = grids["latents"]
        cost = DecoderCost(
            parameters=sum(parameter.numel() for parameter in network.parameters()),
            texture_channels=sum(channels),
            texture_floats=sum(grid.numel() for grid in grids.values()),
            flops_per_sample=flops + offset_flops + interpolation_flops,
            bytes_per_sample=numbers_read * latents.element_size(),
        )
        super().__init__((latents.shape[0], latents.shape[1]), cost)
        self.network = network
        self.gain = gain
        self.names = list(grids)
        for name, grid in grids.items():  # as attributes, because `Material.to` moves only tensors that are
            setattr(self, f"grid_{name}", grid)

    def latents(self, uv: Tensor, wo: Tensor) -> Tensor:
        """The latents (n, D) at uv (n, 2) for views wo (n, 3)."""
        return self.network.fetch({name: getattr(self, f"grid_{name}") for name in self.names}, uv, wo)


class DirectedGriddedMaterial(GriddedMaterial):
    """Grids and a network whose inputs are the latents, then those of two directions, of the kind `directions`."""

    def __init__(
        self, network: GriddedNetwork, grids: dict[str, Tensor], flops: int, gain: float, directions: Directions
    ):
        """Keep the parts, and the kind of the network's directions."""
        super().__init__(network, grids, flops, gain)
        self.directions = directions

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        """Linear radiance (n, 3) of queries; see `Material`. The footprint is ignored: there is one level of detail."""
        latents = self.latents(uv, wo)
        directions = [values.to(latents.dtype) for values in direction_inputs(wo, wi, self.directions)]
        return to_radiance(self.network(torch.cat([latents, *directions], 1)), self.gain)
