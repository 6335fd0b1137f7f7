"""Zeltner et al., "Real-time neural appearance models" (ACM Trans. Graph. 43(3), 2024).

Eight latents a texel make two shading frames, into which both directions are turned; latents and turned directions
enter a network of two hidden layers. The authors' encoder maps the parameters of a layered material to latents. Data
have no such parameters, so the texture is free, as in their second stage. See docs/recipes.md for what else is open.
"""

from dataclasses import dataclass
from typing import ClassVar, Literal

import torch
from torch import Tensor, nn
from torch.nn import functional

from bench.btf import BTF
from bench.codec import Codec, Fit, Parts
from bench.material import DecoderCost, Material, sample_texture, to_radiance
from bench.settings import Count, Natural
from bench.training import (
    Activation,
    Architecture,
    Batch,
    Bits,
    Decoder,
    FitSettings,
    Frames,
    Rounding,
    Samples,
    TextureObjective,
    WeightPrecision,
    first_latents,
    gain_of,
    load_texture,
    load_vector,
    pack,
    store_texture,
    to_vector,
    train,
    unpack,
)


class Zeltner2024(Codec):
    """Zeltner 2024: eight latents, directions turned into two learned shading frames, a small network."""

    name, version = "zeltner2024", 2
    sizes = ("latents", "width")
    recipes: ClassVar = {
        "paper": {"bits": 8, "halfway": False, "start": "random", "optimiser": "adam", "loss": "l1", "steps": 10_000}
    }

    @dataclass(frozen=True)
    class Settings(FitSettings):
        recipe: Literal["ours", "paper"] = "ours"  # "paper": ω_o and ω_i alone, random latents, Adam, absolute error
        latents: Count = 8  # channels of the neural texture
        frames: Natural = 2  # learned shading frames; 0: the network sees directions as they are
        halfway: bool = True  # turn the half vector beside ω_o and ω_i
        layers: Count = 2  # hidden layers of the network
        width: Count = 32  # channels of each hidden layer
        activation: Activation = "leaky-relu"  # of the hidden layers
        bits: Bits = 0  # of a stored latent on average; 0: left to the fit; 16, 32: floats
        weights: WeightPrecision = "half"  # of the stored network

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        gain = gain_of(btf, fit)
        fitting = Zeltner2024Objective(Samples(btf, gain, fit), self.settings, fit.generator())
        train(fitting, fit, self.settings.steps, self.settings.patience)
        return Parts(
            decoder=pack("weights", to_vector(fitting.network), self.settings.weights),
            texture=store_texture("latents", fitting.texture.reshape(*btf.shape, -1), fitting.rounding),
            other={"gain": torch.tensor([gain])},
        )

    def decode(self, parts: Parts, device: torch.device) -> Material:
        network = FramedNetwork(self.settings)
        load_vector(unpack("weights", parts.decoder), network)
        texture, gain = load_texture("latents", parts.texture), float(parts.other["gain"])
        return Zeltner2024Material(network, texture, gain).to(device)


class FramedNetwork(nn.Module):
    """Latents (n, D) and directions (n, 3) → log radiance (n, 3)."""

    def __init__(self, settings: Zeltner2024.Settings, generator: torch.Generator | None = None):
        super().__init__()
        self.directions = 2 + settings.halfway
        inputs = settings.latents + 3 * self.directions * max(1, settings.frames)
        architecture = Architecture(inputs, (settings.width,) * settings.layers, activation=settings.activation)
        # The authors' frames have no bias: outputs are added to the surface's own axes.
        self.frames = Frames(settings.latents, settings.frames, generator, bias=False) if settings.frames else None
        self.decoder = Decoder(architecture, generator)

    def forward(self, latents: Tensor, wo: Tensor, wi: Tensor) -> Tensor:
        directions = torch.stack([wo, wi, functional.normalize(wo + wi, dim=1)][: self.directions], 1)
        turned = directions.flatten(1) if self.frames is None else self.frames.turned(latents, directions)
        level: Tensor = self.decoder(torch.cat([latents, turned.to(latents.dtype)], 1))
        return level


class Zeltner2024Objective(TextureObjective):
    """The neural texture (H · W, D) and the network, both free."""

    def __init__(self, samples: Samples, settings: Zeltner2024.Settings, generator: torch.Generator):
        super().__init__(samples, settings)
        self.network = FramedNetwork(settings, generator)
        self.network.decoder.start_at(samples.mean(generator))
        self.texture = nn.Parameter(first_latents(samples, settings.latents, settings.start, generator))
        self.rounding = Rounding(settings.latents, settings.bits)

    def predict(self, batch: Batch, progress: float) -> Tensor:
        latents = self.rounding(self.texture).index_select(0, batch.texel)
        level: Tensor = self.network(latents, self.samples.wo[batch.pair], self.samples.wi[batch.pair])
        return level


class Zeltner2024Material(Material):
    """A texture (H, W, D) of latents, fetched bilinearly, frames and network."""

    def __init__(self, network: FramedNetwork, texture: Tensor, gain: float):
        architecture, frames = network.decoder.architecture, network.frames
        if texture.shape[2] != architecture.inputs - 3 * network.directions * (frames.count if frames else 1):
            raise ValueError(f"a texture of {texture.shape[2]} channels for a network of {architecture.inputs} inputs")
        flops = architecture.flops + (frames.flops(network.directions) if frames else 0)
        count = sum(p.numel() for p in network.parameters())
        super().__init__((texture.shape[0], texture.shape[1]), DecoderCost.of_texture(texture, count, flops))
        self.network, self.texture, self.gain = network, texture, gain

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        return to_radiance(self.network(sample_texture(self.texture, uv), wo, wi), self.gain)
