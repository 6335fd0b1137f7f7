"""NeuBTF's neural texture and renderer fitted to the data directly, without the autoencoder.

With `recipe=paper` the decoder is the paper's; by default it also sees half vectors. It makes no new textures. Grids at
half and a quarter of the resolution and an offset along the view, which are no part of the paper, may be added.
"""

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import torch
from torch import Tensor

from bench.btf import BTF
from bench.codec import Codec, Fit, Parts
from bench.material import Material
from bench.training import Batch, DirectedObjective, FitSettings, Samples, fitted
from bench.training.decoder import Architecture, Decoder
from bench.training.gridded import (
    DirectedGriddedMaterial,
    GriddedNetwork,
    first_grids,
    gridded_parts,
    is_gridded,
    load_gridded,
)
from bench.training.grids import GridSettings, total_channels
from bench.training.inputs import COUNTS
from bench.training.stored_network import load_network
from neubtf.renderer import RendererSettings, load

PAPER = {"bits": 8, "directions": "xy", "start": "random", "optimiser": "adam", "loss": "l1", "steps": 10_000}


class NeuBTFDirect(Codec):
    """NeuBTF's texture and renderer, fitted without the autoencoder: faster to fit, cannot be re-textured.

    Cited as `neubtf`.
    """

    name, version = "neubtf-direct", 5
    sizes = ("latents", "width")
    recipes: ClassVar = {"paper": PAPER}

    @dataclass(frozen=True)
    class Settings(FitSettings, RendererSettings, GridSettings):
        recipe: Literal["ours", "paper"] = "ours"  # "paper": its inputs, start, loss and Adam, random latents

        @property
        def architecture(self) -> Architecture:
            """The renderer's network, whose inputs are the latents of all grids."""
            return replace(super().architecture, inputs=total_channels(self) + COUNTS[self.directions])

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        """Fit the texture, or the grids, and the renderer; returns the parts of the file."""
        fitting = fitted(Direct, self.settings, btf, fit)
        return gridded_parts(fitting, fitting.grids)

    def decode(self, parts: Parts, device: torch.device) -> Material:
        """The material of a file's parts, on a device."""
        settings = self.settings
        if not is_gridded(settings):
            return load(parts, settings).to(device)
        grids = load_gridded(parts, settings)
        network = GriddedNetwork(Decoder(settings.architecture), settings, grids["latents"].shape[:2])
        load_network(network, parts.decoder)
        flops, gain = settings.architecture.flops, float(parts.other["gain"])
        return DirectedGriddedMaterial(network, grids, flops, gain, settings.directions).to(device)


class Direct(DirectedObjective):
    """The neural texture, on one grid or several, and the renderer, both of them fitted."""

    def __init__(self, samples: Samples, settings: NeuBTFDirect.Settings, generator: torch.Generator):
        """Make the renderer, then start the texture as the setting `start` says."""
        as_siren = settings.recipe == "paper"  # its last layer starts as SIREN's, not at the mean of the data
        super().__init__(samples, settings, generator, about=as_siren)
        self.network: Any = GriddedNetwork(self.network, settings, samples.shape, generator)
        self.grids = first_grids(samples, settings, settings.start, generator)

    def predict(self, batch: Batch, progress: float) -> Tensor:
        return self.answers(self.network.fetch_batch(self.grids.rounded(), self.samples, batch), batch.pair)
