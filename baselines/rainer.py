"""Common parts of Rainer's two codecs: the encoder of ABRDFs, the decoder's inputs and output, the fit, the material.

An encoder maps a texel's ABRDF to latents; six further channels hold the mean and the deviation of its log radiance.
The decoder maps latents and two directions to a colour, scaled by the deviation and shifted by the mean.

Log ABRDFs are (pairs, 3). The encoder sees *normalised* ABRDFs: without the mean, over the deviation. A texel has D
latents; its *statistics* are its mean and its deviation, three numbers each; D + 6 numbers are a *row* of the texture.
"""

from dataclasses import dataclass
from typing import Literal, cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from bench.codec import Fit
from bench.directions.interpolation import stereographic
from bench.inputs.settings import BatchSize, Natural, Positive
from bench.material import DecoderCost, Material, sample_texture, to_radiance
from bench.training import (
    Batch,
    LogLoss,
    Loss,
    NetworkSettings,
    ParameterGroup,
    Samples,
    TextureObjective,
    distance,
    groups_of,
)
from bench.training.decoder import LEAK, Architecture, Decoder
from bench.training.inputs import direction_inputs

WIDTH, LAYERS = 106, 4  # of the decoder, as published
CONVOLUTIONS = ((16, 7), (32, 5), (64, 5))  # channels and kernel of the encoder's layers
STRIDE = 4
STATISTICS = 6  # channels of mean and deviation, of three colours each
STATISTICS_FLOPS = 2 * 3  # times the deviation, plus the mean
LEAST_DEVIATION = 1e-3  # of log radiance: keeps the scaling of a constant ABRDF finite
BLOCK = 256  # texels encoded at once

Activation = Literal["leaky-relu", "relu"]
Directions = Literal["stereographic", "xyzh"]
COUNTS = {"stereographic": 4, "xyzh": 9}  # numbers of two directions


def architecture(
    latents: int, activation: Activation, directions: Directions = "stereographic", width: int = WIDTH
) -> Architecture:
    """The decoder for a number of latents: latents and two directions → four layers of `width` → colour."""
    return Architecture(latents + COUNTS[directions], (width,) * LAYERS, activation=activation)


class Encoder(nn.Module):
    """Normalised ABRDFs (n, pairs, 3) → latents (n, latents): 1-D convolutions along the pairs, then linear."""

    def __init__(self, pairs: int, latents: int, generator: torch.Generator | None = None):
        """Make the convolutions, each of which shortens the row of pairs, and the linear layer after them; weights are
        drawn from the generator."""
        super().__init__()
        self.convolutions = nn.ModuleList()
        channels = 3
        length = pairs
        for out, kernel in CONVOLUTIONS:
            self.convolutions.append(nn.Conv1d(channels, out, kernel, stride=STRIDE, padding=kernel // 2))
            channels = out
            length = (length - 1) // STRIDE + 1  # of the convolution's answer: length / STRIDE, rounded up
        self.linear = nn.Linear(channels * length, latents)
        with torch.no_grad():
            for layer in (*self.convolutions, self.linear):
                inputs_of_output = layer.weight[0].numel()
                spread = (2 / inputs_of_output) ** 0.5  # He et al. 2015
                layer.weight.normal_(0, spread, generator=generator)
                layer.bias.zero_()

    def forward(self, abrdfs: Tensor) -> Tensor:
        """Latents (n, D) of normalised ABRDFs (n, pairs, 3), whose colours are the first layer's channels."""
        x = abrdfs.transpose(1, 2)  # (n, 3, pairs)
        for convolution in self.convolutions:
            x = functional.leaky_relu(convolution(x), LEAK)
        return self.linear(x.flatten(1))


def statistics(abrdfs: Tensor) -> Tensor:
    """The mean and the deviation (n, 2, 3) of log ABRDFs (n, pairs, 3) over their pairs; no deviation is 0."""
    deviation = abrdfs.std(1, correction=0).clamp_min(LEAST_DEVIATION)
    return torch.stack([abrdfs.mean(1), deviation], 1)


def encoded_latents(encoder: nn.Module, abrdfs: Tensor, stats: Tensor) -> Tensor:
    """The latents (n, D) that an encoder makes of log ABRDFs (n, pairs, 3) with their statistics (n, 2, 3)."""
    mean, deviation = stats.unbind(1)  # (n, 3) each
    normalised = (abrdfs - mean[:, None]) / deviation[:, None]
    return encoder(normalised)


def direction_coordinates(wo: Tensor, wi: Tensor, directions: Directions = "stereographic") -> Tensor:
    """The decoder's inputs of two unit directions (n, 3): stereographic (n, 4), the light's first; or x, y, z (n, 9) of
    view, light and half vector."""
    if directions == "stereographic":
        return torch.cat([stereographic(wi), stereographic(wo)], 1)
    return torch.cat(direction_inputs(wo, wi, directions), 1)


def log_radiance(decoder: nn.Module, rows: Tensor, coordinates: Tensor) -> Tensor:
    """Log radiance (n, 3) of rows (n, D + 6) of a texture, at the `direction_coordinates` (n, k)."""
    latents, mean, deviation = rows.tensor_split([-STATISTICS, -3], dim=1)  # (n, D), (n, 3), (n, 3)
    normalised = decoder(torch.cat([latents, coordinates], 1))
    return mean + deviation * normalised


@dataclass(frozen=True)
class RainerSettings(NetworkSettings):
    """The settings of a fit of Rainer's networks."""

    steps: Natural = 10_000  # steps of the fit
    texels: BatchSize = 64  # ABRDFs encoded in a step
    pairs: BatchSize = 32  # pairs decoded of each of them
    rate: Positive = 3e-3  # highest learning rate
    loss: Loss = "both"  # error of log radiance: absolute, squared, or their sum; or later errors as displayed


class RainerObjective(TextureObjective):
    """The fit of a decoder, whatever makes its latents; each texel's statistics are taken from the data, not fitted."""

    network: nn.Module
    # (pairs, k), of each pair, which `coordinates_of` looks up. Subclasses set it, or override `coordinates_of`.
    coordinates: Tensor

    def __init__(self, samples: Samples, decoder: Decoder, settings: RainerSettings, fit: Fit):
        """Keep the decoder, and measure the statistics of each texel, in blocks that fit into memory."""
        super().__init__(samples, settings)
        self.network = decoder
        blocks = torch.arange(samples.texels, device=fit.device).split(BLOCK)
        statistics_of_blocks = [statistics(samples.abrdfs(block)) for block in fit.progress(blocks, "texel statistics")]
        # (texels, 2, 3): mean and deviation of each texel's log ABRDF.
        self.statistics = nn.Buffer(torch.cat(statistics_of_blocks), persistent=False)

    def coordinates_of(self, batch: Batch) -> Tensor:
        """The decoder's inputs (n, k) for the directions of a batch."""
        return self.coordinates[batch.pair]

    def decode(self, latents: Tensor, batch: Batch) -> Tensor:
        """Log radiance (n, 3) of latents (n, D), one row for each sample of a batch, with its texel's statistics."""
        rows = torch.cat([latents, self.statistics[batch.texel].flatten(1)], 1)
        return log_radiance(self.network, rows, self.coordinates_of(batch))

    def answers(self, texture: Tensor, batch: Batch) -> Tensor:
        """Log radiance (n, 3) of a texture (texels, D + 6) of latents and statistics, at the pairs of a batch."""
        return log_radiance(self.network, texture.index_select(0, batch.texel), self.coordinates_of(batch))


class Autoencoder(RainerObjective):
    """Encoder and decoder, fitted in each step to a few texels and a few pairs of each."""

    def __init__(self, samples: Samples, encoder: nn.Module, decoder: Decoder, settings: RainerSettings, fit: Fit):
        """Keep both networks, and measure the statistics of each texel."""
        super().__init__(samples, decoder, settings, fit)
        self.encoder = encoder

    def groups(self) -> list[ParameterGroup]:
        """The encoder and the decoder at one rate; Muon, if set, steps the decoder's hidden matrices."""
        settings = self.settings
        return groups_of([self.encoder, self.network], settings.rate, settings.optimiser, settings.hidden_rate)

    def latents(self, texel: Tensor) -> Tensor:
        """The latents (n, D) that the encoder makes of the ABRDFs of texels (n,), with a gradient, all at once."""
        return encoded_latents(self.encoder, self.samples.abrdfs(texel), self.statistics[texel])

    @torch.no_grad()
    def encode(self, texel: Tensor) -> Tensor:
        """The latents (n, D) of any number of texels (n,), in blocks and without a gradient."""
        return torch.cat([self.latents(block) for block in texel.split(BLOCK)])

    def predict(self, batch: Batch, progress: float) -> Tensor:
        """Log radiance (n, 3) at a batch; each of its texels is encoded once, without a gradient."""
        distinct_texels, place = batch.texel.unique(return_inverse=True)  # `place` (n,): each sample's among these
        return self.decode(self.encode(distinct_texels)[place], batch)

    def loss(self, generator: torch.Generator, progress: float) -> Tensor:
        """The loss at a few random texels, each encoded once and decoded at several random pairs."""
        settings = self.settings
        # Texels from `trained_texels` on belong to materials that are kept for the curve.
        texel = torch.randint(self.samples.trained_texels, (settings.texels,), generator=generator)
        texel = texel.to(self.samples.device, non_blocking=True)
        batch = self.samples.draw_at(texel.repeat_interleave(settings.pairs), generator)
        latents = self.latents(texel).repeat_interleave(settings.pairs, 0)  # (texels · pairs, D)
        loss = cast(LogLoss, settings.loss)  # not as displayed, which the codecs with an encoder refuse
        return distance(self.decode(latents, batch), batch.target, loss)


class RainerMaterial(Material):
    """A texture (H, W, D + 6) of latents, means and deviations, fetched bilinearly, and the decoder."""

    def __init__(self, decoder: Decoder, texture: Tensor, gain: float, directions: Directions = "stereographic"):
        """Count the cost of an answer, and keep the parts."""
        flops = decoder.architecture.flops + STATISTICS_FLOPS
        cost = DecoderCost.of_texture(texture, decoder.architecture.parameters, flops)
        super().__init__((texture.shape[0], texture.shape[1]), cost)
        self.decoder = decoder
        self.texture = texture
        self.gain = gain
        self.directions = directions

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        """Linear radiance (n, 3) of queries, each (n, …); see `Material`. The footprint is ignored: there is one level
        of detail."""
        rows = sample_texture(self.texture, uv)
        coordinates = direction_coordinates(wo, wi, self.directions)
        return to_radiance(log_radiance(self.decoder, rows, coordinates), self.gain)
