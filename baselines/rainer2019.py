"""Rainer et al., "Neural BTF compression and interpolation" (Computer Graphics Forum 38(2), 2019).

An encoder maps each texel's ABRDF to a few latents, a decoder maps latents and two directions to colour; both are
fitted together, one pair of networks per material. Only the decoder is stored; it has the published 35,725 parameters.
Details that no available text confirms are settings or constants here and in `baselines.rainer`, which also says what
ABRDFs, latents, statistics and log radiance are. With `start=components`, the default, there is no encoder: latents are
*free*, numbers that the fit changes for themselves. *Rounding* is how the file stores the texture: each channel in a
few bits.
"""

from dataclasses import dataclass
from typing import ClassVar, Literal

import torch
from torch import Tensor, nn

from baselines import rainer
from baselines.rainer import Directions
from bench.btf import BTF
from bench.codec import Codec, Fit, Parts
from bench.inputs.errors import InputError
from bench.inputs.settings import Natural, Positive, Width
from bench.material import Material
from bench.training import Batch, Samples, first_latents, gain_of, train
from bench.training.decoder import Architecture, Decoder
from bench.training.fitting import ROUNDING_SAMPLES
from bench.training.stored_network import load_network
from bench.training.stored_texture import Bits, Rounding, load_texture, round_after, store_texture


class Rainer2019(Codec):
    """Rainer 2019: an encoder from ABRDFs to latents and a wide decoder, one pair of networks a material.

    @article{rainer2019neural,
      author = {Rainer, Gilles and Jakob, Wenzel and Ghosh, Abhijeet and Weyrich, Tim},
      title = {Neural {BTF} Compression and Interpolation},
      journal = {Computer Graphics Forum},
      volume = {38},
      number = {2},
      pages = {235--244},
      year = {2019},
      doi = {10.1111/cgf.13633}
    }
    """

    name, version = "rainer2019", 3
    sizes = ("latents",)
    recipes: ClassVar = {
        "paper": {"bits": 8, "directions": "stereographic", "start": "encoder", "optimiser": "adam", "steps": 10_000}
    }

    @dataclass(frozen=True)
    class Settings(rainer.RainerSettings):
        steps: Natural = 2_500  # steps of the fit
        recipe: Literal["ours", "paper"] = "ours"  # "paper": its inputs, the encoder, only Adam
        start: Literal["components", "encoder"] = "components"  # latents: free from principal components, or encoded
        directions: Directions = "xyzh"  # inputs: each stereographic as published, or all of both and of their half
        patience: Natural = 0  # steps without a gain of 0.02 dB on its probe that end the fit; 0: never
        latents: Width = 8  # channels that the encoder makes
        width: Width = rainer.WIDTH  # of the decoder's hidden layers
        latent_rate: Positive = 1e-2  # highest learning rate of latents that no encoder makes
        activation: rainer.Activation = "leaky-relu"  # activation of the decoder's hidden layers
        bits: Bits = 0  # bits of a stored latent, mean or deviation on average; 0: chosen by the fit; 16, 32: floats

        def __post_init__(self) -> None:
            """`InputError` if the encoder's fit, which has its own loss, is asked for a loss as displayed."""
            if self.start == "encoder" and self.loss == "display":
                raise InputError("codec rainer2019: start=encoder has a loss of its own: leave out loss=display")

        @property
        def architecture(self) -> Architecture:
            """The decoder."""
            return rainer.architecture(self.latents, self.activation, self.directions, self.width)

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        """Fit encoder and decoder, or the decoder with free latents; returns the parts of the file."""
        samples = Samples(btf, gain_of(btf, fit), fit)
        objective = Encoded if self.settings.start == "encoder" else FreeLatents
        fitting = objective(samples, self.settings, fit)
        train(fitting, fit, self.settings.steps, self.settings.patience)
        texture, rounding = fitting.stored_texture(fit)
        return fitting.parts(store_texture("latents", texture.reshape(*btf.shape, -1), rounding))

    def decode(self, parts: Parts, device: torch.device) -> Material:
        """The material of a file's parts, on a device."""
        decoder = load_network(Decoder(self.settings.architecture), parts.decoder)
        texture = load_texture("latents", parts.texture)
        gain = float(parts.other["gain"])
        return rainer.RainerMaterial(decoder, texture, gain, self.settings.directions).to(device)


class Encoded(rainer.Autoencoder):
    """Encoder and decoder of one material, as published."""

    settings: Rainer2019.Settings

    def __init__(self, samples: Samples, settings: Rainer2019.Settings, fit: Fit):
        """Make both networks; the encoder's weights are the first numbers of the generator."""
        generator = fit.generator()
        encoder = rainer.Encoder(samples.pairs, settings.latents, generator)
        super().__init__(samples, encoder, Decoder(settings.architecture, generator), settings, fit)
        self.coordinates = rainer.coordinates(samples.wo, samples.wi, settings.directions)

    def stored_texture(self, fit: Fit) -> tuple[Tensor, Rounding]:
        """The final texture (texels, D + 6) of the encoder, and its rounding, chosen now by its error at samples."""
        texels = torch.arange(self.samples.texels, device=fit.device)
        texture = torch.cat([self.encode(texels), self.statistics.flatten(1)], 1)
        batch = self.samples.draw(ROUNDING_SAMPLES, fit.generator())
        bits = self.settings.bits
        rounding = round_after(texture, bits, lambda values: self.answers(values, batch), batch.target)
        return texture, rounding


class FreeLatents(rainer.Fitted):
    """The decoder and free latents, without an encoder. The file is as that of `Encoded`, which holds no encoder."""

    settings: Rainer2019.Settings

    def __init__(self, samples: Samples, settings: Rainer2019.Settings, fit: Fit):
        """Make the decoder, and start the latents at the texels' principal components: see `first_latents`."""
        generator = fit.generator()
        super().__init__(samples, Decoder(settings.architecture, generator), settings, fit)
        self.latents = nn.Parameter(first_latents(samples, settings.latents, "components", generator))  # (texels, D)
        self.coordinates = rainer.coordinates(samples.wo, samples.wi, settings.directions)
        self.rounding = Rounding(settings.latents + rainer.STATISTICS, settings.bits)

    def texture(self) -> Tensor:
        """The texture (texels, D + 6) of latents and statistics, not rounded."""
        return torch.cat([self.latents, self.statistics.flatten(1)], 1)

    def stored_texture(self, fit: Fit) -> tuple[Tensor, Rounding]:
        """The final texture (texels, D + 6), and the rounding that it was fitted with; `fit` is that of `Encoded`, and
        not needed."""
        return self.texture(), self.rounding

    def predict(self, batch: Batch, progress: float) -> Tensor:
        """Log radiance (n, 3) of a batch, from half of the fit on of the texture as the file stores it."""
        return self.answers(self.rounding(self.texture()), batch)

    def loss(self, generator: torch.Generator, progress: float) -> Tensor:
        """The loss at as many random samples as the encoder's fit decodes in a step."""
        batch = self.samples.draw(self.settings.texels * self.settings.pairs, generator)
        return self.distance(self.predict(batch, progress), batch.target, batch.pair, progress)
