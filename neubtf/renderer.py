"""NeuBTF's renderer: a latent vector and two directions → RGB, and the material that any NeuBTF file decodes to.

The paper's network has 3,011 parameters: 18 inputs (14 latents, xy of ω_o, xy of ω_i), three hidden layers of 32, each
linear → layer norm → sine, residuals between equal widths, and a linear layer to RGB.
"""

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor
from torch.nn import functional

from bench.codec import Parts
from bench.inputs.settings import Layers, Positive, Width
from bench.training import Bits, TextureMaterial, load_texture
from bench.training.decoder import Architecture, Decoder
from bench.training.gridded import DirectedGriddedMaterial
from bench.training.grids import size_of
from bench.training.inputs import COUNTS, Directions, direction_inputs
from bench.training.stored_network import load_network


@dataclass(frozen=True)
class RendererSettings:
    """The settings of a NeuBTF file, common to every codec that writes one."""

    latents: Width = 14  # channels of the neural texture
    directions: Directions = "xyzh"  # inputs: x and y of both as in the paper, or all of both and of their half vector
    layers: Layers = 3  # hidden layers of the renderer
    width: Width = 32  # channels of each hidden layer
    activation: Literal["sine", "relu"] = "sine"  # activation of the hidden layers
    omega: Positive = 2.0  # frequency of the sine; without the layer norm SIREN's is 30
    norm: bool = True  # layer norm before each activation
    residual: bool = True  # residual connections between layers of equal width
    bits: Bits = 0  # bits of a stored latent on average; 0: chosen by the fit; 16, 32: floats

    @property
    def architecture(self) -> Architecture:
        """The renderer's network: latents and directions → three outputs."""
        return Architecture(
            inputs=self.latents + COUNTS[self.directions],
            widths=(self.width,) * self.layers,
            activation=self.activation,
            omega=self.omega,
            norm=self.norm,
            residual=self.residual,
        )


def render(renderer: Decoder, latents: Tensor, wo: Tensor, wi: Tensor, directions: Directions) -> Tensor:
    """Log radiance (n, 3) of latents (n, D) and unit directions wo, wi (n, 3)."""
    return renderer(torch.cat([latents, *direction_inputs(wo, wi, directions)], 1))


def on_grids(texture: Tensor, latents: int) -> dict[str, Tensor]:
    """The grids (h, w, C) by name of an autoencoder's texture (H, W, C): its first `latents` channels are one grid.

    Further channels are those that the offset's network reads; their means make a grid of a quarter of the resolution.
    """
    if texture.shape[2] == latents:
        return {"latents": texture}
    of_offset = texture[..., latents:].movedim(-1, 0)  # (C, H, W), as pooling takes it
    height, width, _ = texture.shape
    means = functional.adaptive_avg_pool2d(of_offset, size_of("offset", (height, width)))
    return {"latents": texture[..., :latents], "offset": means.movedim(0, -1)}


def load(parts: Parts, settings: RendererSettings) -> "NeuBTFMaterial":
    """The material of a file without an offset: its parts hold the renderer, the texture `latents`, and the gain."""
    renderer = load_network(Decoder(settings.architecture), parts.decoder)
    texture = load_texture("latents", parts.texture)  # (H, W, D)
    gain = float(parts.other["gain"])
    return NeuBTFMaterial(renderer, texture, gain, settings.directions)


class NeuBTFMaterial(TextureMaterial):
    """The decoded material of every NeuBTF file of one texture, and of no other."""


Decoded = NeuBTFMaterial | DirectedGriddedMaterial  # what a NeuBTF file decodes to: one texture, or with an offset
