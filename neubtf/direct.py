"""NeuBTF's neural texture and renderer fitted to the data directly, without the autoencoder.

With `recipe=paper` the decoder is the paper's; by default it also sees half vectors. It makes no new textures. Grids at
half and a quarter of the resolution and an offset along the view may be added: `neubtf.gridded`.
"""

from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import torch
from torch import Tensor, nn

from bench.btf import BTF
from bench.codec import Codec, Fit, Parts
from bench.material import Material
from bench.training import Batch, DirectedObjective, FitSettings, Samples, first_latents, fitted
from bench.training.decoder import Architecture
from bench.training.grids import GridSettings, total
from bench.training.inputs import COUNTS
from bench.training.stored_texture import Rounding, store_texture
from neubtf.gridded import GriddedObjective, is_gridded, load_gridded
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
            return replace(super().architecture, inputs=total(self) + COUNTS[self.directions])

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        """Fit the texture, or the grids, and the renderer; returns the parts of the file."""
        if is_gridded(self.settings):
            return fitted(GriddedObjective, self.settings, btf, fit).file()
        fitting = fitted(Direct, self.settings, btf, fit)
        texture = fitting.texture.reshape(*btf.shape, -1)
        return fitting.parts(store_texture("latents", texture, fitting.rounding))

    def decode(self, parts: Parts, device: torch.device) -> Material:
        """The material of a file's parts, on a device."""
        if is_gridded(self.settings):
            return load_gridded(parts, self.settings).to(device)
        return load(parts, self.settings).to(device)


class Direct(DirectedObjective):
    """The neural texture (H · W, D) and the renderer, both of them fitted."""

    def __init__(self, samples: Samples, settings: NeuBTFDirect.Settings, generator: torch.Generator):
        """Make the renderer, then start the texture as the setting `start` says."""
        as_siren = settings.recipe == "paper"  # its last layer starts as SIREN's, not at the mean of the data
        super().__init__(samples, settings, generator, about=as_siren)
        self.texture = nn.Parameter(first_latents(samples, settings.latents, settings.start, generator))
        self.rounding = Rounding(settings.latents, settings.bits)

    def predict(self, batch: Batch, progress: float) -> Tensor:
        latents = self.rounding(self.texture).index_select(0, batch.texel)
        return self.answers(latents, batch.pair)
