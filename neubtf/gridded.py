"""NeuBTF's renderer on a texture of several grids, with a look-up that moves along the view; no part of the paper.

What other codecs may use, this one may, too: `half`, `quarter` and `offset` are settings of `neubtf-direct`, and
without them its files are those of one texture. The grids are those of `bench.training.grids`.
"""

from typing import Any

import torch
from torch import Tensor, nn

from bench.codec import Parts
from bench.material import DecoderCost, Material, sample_texture, to_radiance
from bench.training import Batch, DirectedObjective, ParameterGroup, Samples, first_latents, groups_of
from bench.training.decoder import Decoder
from bench.training.grids import Grids, Offset, load_grids, total
from bench.training.inputs import direction_inputs
from bench.training.stored_network import load_network


def is_gridded(settings: Any) -> bool:
    """Whether settings ask for more than one texture at full resolution."""
    return bool(settings.half or settings.quarter or settings.offset)


class GriddedNetwork(nn.Module):
    """The renderer and, if the settings ask for it, the network of the offset, over a picture of `size` (H, W)."""

    def __init__(
        self, decoder: Decoder, settings: Any, size: tuple[int, int], generator: torch.Generator | None = None
    ):
        super().__init__()
        self.decoder = decoder
        self.offset = Offset(settings.offset, size, generator) if settings.offset else None

    def forward(self, inputs: Tensor) -> Tensor:
        return self.decoder(inputs)

    def fetch(self, grids: dict[str, Tensor], uv: Tensor, wo: Tensor) -> Tensor:
        """The channels (n, D) of all grids (h, w, C) at uv (n, 2), where the offset moves it for views wo (n, 3)."""
        if self.offset is not None:
            uv = self.offset.moved(uv, sample_texture(grids["offset"], uv), wo)
        latents = [sample_texture(grid, uv) for name, grid in grids.items() if name != "offset"]
        return torch.cat(latents, 1)


class GriddedObjective(DirectedObjective):
    """The grids and both networks, all of them fitted."""

    def __init__(self, samples: Samples, settings: Any, generator: torch.Generator):
        """Make the renderer and what moves a look-up, then start the grids at the first latents."""
        as_siren = settings.recipe == "paper"  # its last layer starts as SIREN's, not at the mean of the data
        super().__init__(samples, settings, generator, about=as_siren)
        self.network: Any = GriddedNetwork(self.network, settings, samples.shape, generator)
        first = first_latents(samples, total(settings), settings.start, generator)
        self.grids = Grids(first, samples.shape, settings, offset=bool(settings.offset))

    def groups(self) -> list[ParameterGroup]:
        settings = self.settings
        networks = groups_of([self.network], settings.rate, settings.optimiser, settings.hidden_rate)
        return [*networks, {"params": list(self.grids.parameters()), "lr": settings.latent_rate}]

    def predict(self, batch: Batch, progress: float) -> Tensor:
        uv, wo = self.samples.centres(batch.texel), self.samples.wo.index_select(0, batch.pair)
        latents = self.network.fetch(self.grids.rounded(), uv, wo)
        return self.answers(latents, batch.pair)

    def file(self) -> Parts:
        """The tensors of a file."""
        size = torch.tensor(self.samples.shape, dtype=torch.int32)
        return self.parts(self.grids.stored(), size=size)


def load_gridded(parts: Parts, settings: Any) -> "GriddedMaterial":
    """The material of a file."""
    height, width = parts.other["size"].tolist()
    network = load_network(GriddedNetwork(Decoder(settings.architecture), settings, (height, width)), parts.decoder)
    grids = load_grids(parts.texture, settings, (height, width), offset=bool(settings.offset))
    return GriddedMaterial(network, grids, (height, width), float(parts.other["gain"]), settings.directions)


class GriddedMaterial(Material):
    """Grids (h, w, C) by name over a picture of `size`, and the networks."""

    def __init__(
        self, network: GriddedNetwork, grids: dict[str, Tensor], size: tuple[int, int], gain: float, directions: Any
    ):
        """Count the cost of an answer, and keep the parts; `size` is (H, W) of the finest grid."""
        numbers_read = sum(4 * grid.shape[2] for grid in grids.values())  # four texels around a place, of each grid
        mixed = 2 * numbers_read  # each is multiplied and added
        offset_flops = network.offset.flops if network.offset is not None else 0
        cost = DecoderCost(
            parameters=sum(parameter.numel() for parameter in network.parameters()),
            texture_channels=grids["latents"].shape[2],  # of full resolution
            texture_floats=sum(grid.numel() for grid in grids.values()),
            flops_per_sample=network.decoder.architecture.flops + offset_flops + mixed,
            bytes_per_sample=numbers_read * grids["latents"].element_size(),
        )
        super().__init__(size, cost)
        self.network = network
        self.gain = gain
        self.directions = directions
        self.names = list(grids)
        for name, grid in grids.items():  # as attributes, because `Material.to` moves only tensors that are
            setattr(self, f"grid_{name}", grid)

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        """Linear radiance (n, 3) of queries, each (n, …); see `Material`. The footprint is ignored: there is one level
        of detail."""
        grids = {name: getattr(self, f"grid_{name}") for name in self.names}
        latents = self.network.fetch(grids, uv, wo)
        directions = [values.to(latents.dtype) for values in direction_inputs(wo, wi, self.directions)]
        level = self.network(torch.cat([latents, *directions], 1))
        return to_radiance(level, self.gain)
