"""Rainer et al., "Neural BTF compression and interpolation" (Computer Graphics Forum 38(2), 2019).

An encoder maps each texel's ABRDF to a few latents, a decoder maps latents and two directions to colour; both are
fitted together, one pair of networks per material. Only the decoder is stored; it has the published 35,725 parameters.
Details that no available text confirms are settings or constants here and in `baselines.rainer`: the encoder's layers,
the activation, the loss, the optimiser, and the six further channels.
"""

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import torch
from torch import Tensor, nn

from baselines.rainer import (
    Activation,
    Autoencoder,
    Directions,
    Encoder,
    Fitted,
    RainerMaterial,
    RainerSettings,
    architecture,
    coordinates,
)
from bench.btf import BTF
from bench.codec import Codec, Fit, Parts
from bench.material import Material
from bench.settings import Natural, Positive, Width
from bench.training import (
    Architecture,
    Batch,
    Decoder,
    Precision,
    Samples,
    WeightPrecision,
    distance,
    first_latents,
    gain_of,
    groups_of,
    load_vector,
    pack,
    to_vector,
    train,
    unpack,
)


class Rainer2019(Codec):
    """Rainer 2019: an encoder from ABRDFs to latents and a wide decoder, one pair of networks a material."""

    name, version = "rainer2019", 2
    sizes = ("latents",)
    recipes: ClassVar = {
        "paper": {"directions": "stereographic", "start": "encoder", "optimiser": "adam", "steps": 10_000}
    }

    @dataclass(frozen=True)
    class Settings(RainerSettings):
        steps: Natural = 2_500  # of the fit
        recipe: Literal["ours", "paper"] = "ours"  # "paper": its inputs, the encoder, Adam alone
        start: Literal["components", "encoder"] = "components"  # latents: free from principal components, or encoded
        directions: Directions = "xyzh"  # inputs: each stereographic as published, or all of both and of their half
        patience: Natural = 0  # steps without a gain of 0.02 dB on its probe that end the fit; 0: takes all its steps
        latents: Width = 8  # channels that the encoder makes
        latent_rate: Positive = 1e-2  # highest learning rate of latents that no encoder makes
        activation: Activation = "leaky-relu"  # of the decoder's hidden layers
        precision: Precision = "int8"  # of the stored latents, means and deviations
        weights: WeightPrecision = "half"  # of the stored decoder

        @property
        def architecture(self) -> Architecture:
            return architecture(self.latents, self.activation, self.directions)

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        gain = gain_of(btf, fit)
        samples = Samples(btf, gain, fit)
        fitting = (Encoded if self.settings.start == "encoder" else Free)(samples, self.settings, fit)
        train(fitting, fit, self.settings.steps, self.settings.patience)
        texels = torch.arange(fitting.samples.texels, device=fit.device)
        texture = torch.cat([fitting.encode(texels), fitting.statistics.flatten(1)], 1)
        return Parts(
            decoder=pack("weights", to_vector(fitting.decoder), self.settings.weights),
            texture=pack("latents", texture.reshape(*btf.shape, -1), self.settings.precision),
            other={"gain": torch.tensor([gain])},
        )

    def decode(self, parts: Parts, device: torch.device) -> Material:
        decoder = Decoder(self.settings.architecture)
        load_vector(unpack("weights", parts.decoder), decoder)
        texture, gain = unpack("latents", parts.texture), float(parts.other["gain"])
        return RainerMaterial(decoder, texture, gain, self.settings.directions).to(device)


class Encoded(Autoencoder):
    """Encoder and decoder of one material, as published."""

    def __init__(self, samples: Samples, settings: Rainer2019.Settings, fit: Fit):
        generator = fit.generator()
        encoder = Encoder(samples.pairs, settings.latents, generator)
        super().__init__(samples, encoder, Decoder(settings.architecture, generator), settings, fit)
        self.coordinates = coordinates(samples.wo, samples.wi, settings.directions)


class Free(Fitted):
    """The decoder and free latents, without an encoder; the file holds no encoder in either case."""

    settings: Rainer2019.Settings

    def __init__(self, samples: Samples, settings: Rainer2019.Settings, fit: Fit):
        generator = fit.generator()
        super().__init__(samples, Decoder(settings.architecture, generator), settings, fit)
        self.texture = nn.Parameter(first_latents(samples, settings.latents, "components", generator))
        self.coordinates = coordinates(samples.wo, samples.wi, settings.directions)

    def groups(self) -> list[dict[str, Any]]:
        settings = self.settings
        decoder = groups_of([self.decoder], settings.rate, settings.optimiser, settings.hidden_rate)
        return [*decoder, {"params": [self.texture], "lr": settings.latent_rate}]

    def encode(self, texel: Tensor) -> Tensor:
        return self.texture.detach()[texel]

    def predict(self, batch: Batch, progress: float) -> Tensor:
        return self.decode(self.texture.index_select(0, batch.texel), batch)

    def loss(self, generator: torch.Generator, progress: float) -> Tensor:
        batch = self.samples.draw(self.settings.texels * self.settings.pairs, generator)
        return distance(self.predict(batch, progress), batch.target, self.settings.loss)
