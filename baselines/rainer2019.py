"""Rainer et al., "Neural BTF compression and interpolation" (Computer Graphics Forum 38(2), 2019).

An encoder maps each texel's ABRDF to a few latents, a decoder maps latents and two directions to colour; both are
fitted together, one pair of networks a material, and the decoder alone is stored: it has the published 35,725
parameters. What no text that could be read confirms is a setting or a constant here and in `baselines.rainer`: the
encoder's layers, the activation, the loss, the optimiser, and the six further channels.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from baselines.rainer import Activation, Autoencoder, Encoder, RainerMaterial, architecture, directions
from bench.btf import BTF
from bench.codec import Codec, Fit, Parts
from bench.decoder import Decoder, load_vector, to_vector
from bench.material import Material
from bench.quantise import Precision, WeightPrecision, pack, unpack
from bench.settings import Count, Natural, Positive
from bench.training import Batch, Loss, Samples, gain_of, train


class Rainer2019(Codec):
    """Rainer 2019: an encoder from ABRDFs to latents and a wide decoder, one pair of networks a material."""

    name, version = "rainer2019", 1
    sizes = ("latents",)

    @dataclass(frozen=True)
    class Settings:
        steps: Natural = 10_000  # of the fit
        texels: Count = 64  # ABRDFs encoded in a step
        pairs: Count = 32  # pairs decoded of each of them
        rate: Positive = 3e-3  # highest learning rate
        loss: Loss = "both"  # on log radiance: absolute, squared, or their sum
        latents: Count = 8  # channels that the encoder makes
        activation: Activation = "leaky-relu"  # of the decoder's hidden layers
        precision: Precision = "int8"  # of the stored latents, means and deviations
        weights: WeightPrecision = "half"  # of the stored decoder

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        gain = gain_of(btf, fit)
        fitting = Fitting(Samples(btf, gain, fit), self.settings, fit)
        train(fitting, fit, self.settings.steps)
        texels = torch.arange(fitting.samples.texels, device=fit.device)
        texture = torch.cat([fitting.encode(texels), fitting.statistics.flatten(1)], 1)
        return Parts(
            decoder=pack("weights", to_vector(fitting.decoder), self.settings.weights),
            texture=pack("latents", texture.reshape(*btf.shape, -1), self.settings.precision),
            other={"gain": torch.tensor([gain])},
        )

    def decode(self, parts: Parts, device: torch.device) -> Material:
        decoder = Decoder(architecture(self.settings.latents, self.settings.activation))
        load_vector(unpack("weights", parts.decoder), decoder)
        return RainerMaterial(decoder, unpack("latents", parts.texture), float(parts.other["gain"])).to(device)


class Fitting(Autoencoder):
    """Encoder and decoder of one material."""

    def __init__(self, samples: Samples, settings: Rainer2019.Settings, fit: Fit):
        generator = fit.generator()
        encoder = Encoder(samples.pairs, settings.latents, generator)
        decoder = Decoder(architecture(settings.latents, settings.activation), generator)
        step = (settings.texels, settings.pairs)
        super().__init__(samples, encoder, decoder, step, settings.rate, settings.loss, fit)
        self.directions = directions(samples.wo, samples.wi)

    def where(self, batch: Batch) -> Tensor:
        return self.directions[batch.pair]
