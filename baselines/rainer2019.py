"""Rainer et al., "Neural BTF compression and interpolation" (Computer Graphics Forum 38(2), 2019).

An encoder maps each texel's ABRDF to a few latents, a decoder maps latents and two directions to colour; both are
fitted together, one pair of networks a material, and the decoder alone is stored: it has the published 35,725
parameters. What no text that could be read confirms is a setting or a constant here: the encoder's layers, the
activation, the loss, the optimiser, and the six further channels, taken as the mean and the deviation of a texel's
ABRDF in each colour.
"""

from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import Tensor, nn
from torch.nn import functional

from bench.btf import BTF
from bench.codec import Codec, Fit, Parts
from bench.decoder import LEAK, Architecture, Decoder, load_vector, to_vector
from bench.directions import stereographic
from bench.errors import InputError
from bench.material import DecoderCost, Material, sample_texture
from bench.quantise import Precision, WeightPrecision, pack, unpack
from bench.training import Batch, Loss, Objective, Samples, distance, gain_of, train

WIDTHS = (106, 106, 106, 106)
CONVOLUTIONS = ((16, 7), (32, 5), (64, 5))  # channels and kernel of the encoder's layers
STRIDE = 4
STATISTICS = 6  # channels of mean and deviation
LEAST_DEVIATION = 1e-3  # of log radiance: a constant ABRDF is not blown up
BLOCK = 256  # texels encoded at once


class Rainer2019(Codec):
    """Rainer 2019: an encoder from ABRDFs to latents and a wide decoder, one pair of networks a material."""

    name, version = "rainer2019", 1

    @dataclass(frozen=True)
    class Settings:
        steps: int = 10_000  # of the fit
        texels: int = 64  # ABRDFs encoded in a step
        pairs: int = 32  # pairs decoded of each of them
        rate: float = 3e-3  # highest learning rate
        loss: Loss = "both"  # on log radiance: absolute, squared, or their sum
        latents: int = 8  # channels that the encoder makes
        activation: Literal["leaky-relu", "relu"] = "leaky-relu"  # of the decoder's hidden layers
        precision: Precision = "int8"  # of the stored latents, means and deviations
        weights: WeightPrecision = "half"  # of the stored decoder

        def __post_init__(self) -> None:
            if min(self.texels, self.pairs, self.latents) < 1:
                raise InputError("codec rainer2019 needs texels, pairs and latents of at least 1")

        @property
        def architecture(self) -> Architecture:
            return Architecture(self.latents + 4, WIDTHS, activation=self.activation)

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
        decoder = Decoder(self.settings.architecture)
        load_vector(unpack("weights", parts.decoder), decoder)
        return Rainer2019Material(decoder, unpack("latents", parts.texture), parts.other["gain"]).to(device)


class Encoder(nn.Module):
    """Normalised ABRDFs (n, pairs, 3) → latents (n, latents): 1-D convolutions along the pairs, then linear."""

    def __init__(self, pairs: int, latents: int, generator: torch.Generator):
        super().__init__()
        self.convolutions = nn.ModuleList()
        channels = 3
        for out, kernel in CONVOLUTIONS:
            self.convolutions.append(nn.Conv1d(channels, out, kernel, STRIDE, padding=kernel // 2))
            channels, pairs = out, (pairs - 1) // STRIDE + 1
        self.linear = nn.Linear(channels * pairs, latents)
        with torch.no_grad():
            for layer in (*self.convolutions, self.linear):
                fan = layer.weight[0].numel()
                layer.weight.normal_(0, (2 / fan) ** 0.5, generator=generator)
                layer.bias.zero_()

    def forward(self, abrdfs: Tensor) -> Tensor:
        x = abrdfs.transpose(1, 2)
        for convolution in self.convolutions:
            x = functional.leaky_relu(convolution(x), LEAK)
        return self.linear(x.flatten(1))


def directions(wo: Tensor, wi: Tensor) -> Tensor:
    """The decoder's coordinates (n, 4) of two unit directions: light, then view, each in the stereographic plane."""
    return torch.cat([stereographic(wi), stereographic(wo)], 1)


def radiance(decoder: Decoder, latents: Tensor, statistics: Tensor, where: Tensor) -> Tensor:
    """Log radiance (n, 3) of latents (n, D), statistics (n, 6), and coordinates of directions (n, 4)."""
    mean, deviation = statistics.chunk(2, 1)
    return mean + deviation * decoder(torch.cat([latents, where], 1))


class Fitting(Objective):
    """Encoder and decoder, fitted on a few texels and a few pairs of each a step."""

    statistics: Tensor  # (texels, 2, 3): mean and deviation of each texel's log ABRDF

    def __init__(self, samples: Samples, settings: Rainer2019.Settings, fit: Fit):
        super().__init__(samples)
        generator = fit.generator()
        self.settings = settings
        self.encoder = Encoder(samples.pairs, settings.latents, generator)
        self.decoder = Decoder(settings.architecture, generator)
        blocks = torch.arange(samples.texels, device=fit.device).split(BLOCK)
        found = [_statistics(samples.abrdfs(block)) for block in fit.progress(blocks, "texel statistics")]
        self.register_buffer("statistics", torch.cat(found), persistent=False)
        self.directions = directions(samples.wo, samples.wi)

    def groups(self) -> list[dict[str, Any]]:
        return [{"params": list(self.parameters()), "lr": self.settings.rate}]

    def latents(self, texel: Tensor) -> Tensor:
        """The latents (n, D) that the encoder makes of some texels' ABRDFs."""
        mean, deviation = self.statistics[texel].unbind(1)
        return self.encoder((self.samples.abrdfs(texel) - mean[:, None]) / deviation[:, None])

    @torch.no_grad()
    def encode(self, texel: Tensor) -> Tensor:
        """The latents (n, D) of any number of texels, in blocks."""
        return torch.cat([self.latents(block) for block in texel.split(BLOCK)])

    def predict(self, batch: Batch, progress: float) -> Tensor:
        texel, place = batch.texel.unique(return_inverse=True)
        return self._decode(self.encode(texel)[place], batch)

    def _decode(self, latents: Tensor, batch: Batch) -> Tensor:
        return radiance(self.decoder, latents, self.statistics[batch.texel].flatten(1), self.directions[batch.pair])

    def loss(self, generator: torch.Generator, progress: float) -> Tensor:
        texels, pairs, device = self.settings.texels, self.settings.pairs, self.samples.device
        texel = torch.randint(self.samples.texels, (texels,), generator=generator).to(device)
        pair = torch.randint(self.samples.pairs, (texels * pairs,), generator=generator).to(device)
        latents = self.latents(texel).repeat_interleave(pairs, 0)
        batch = self.samples.at(texel.repeat_interleave(pairs), pair)
        return distance(self._decode(latents, batch), batch.target, self.settings.loss)


def _statistics(abrdfs: Tensor) -> Tensor:
    """The mean and the deviation (n, 2, 3) of ABRDFs (n, pairs, 3) over their pairs."""
    return torch.stack([abrdfs.mean(1), abrdfs.std(1, correction=0).clamp_min(LEAST_DEVIATION)], 1)


class Rainer2019Material(Material):
    """A texture (H, W, D + 6) of latents, means and deviations, fetched bilinearly, and the decoder."""

    def __init__(self, decoder: Decoder, texture: Tensor, gain: Tensor):
        height, width, channels = texture.shape
        cost = DecoderCost(
            parameters=decoder.architecture.parameters,
            texture_channels=channels,
            texture_floats=texture.numel(),
            flops_per_sample=decoder.architecture.flops + 4 * 2 * channels + 6,
            bytes_per_sample=4 * channels * texture.element_size(),
        )
        super().__init__((height, width), cost)
        self.decoder, self.texture, self.gain = decoder, texture, gain

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        latents, statistics = sample_texture(self.texture, uv).tensor_split([-STATISTICS], dim=1)
        return radiance(self.decoder, latents, statistics, directions(wo, wi)).expm1() / self.gain
