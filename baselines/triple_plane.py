"""Triple plane (Xu et al., "Towards comprehensive neural materials", 2025).

Three planes of features: over the texels, over the half vector and over the difference vector, the light seen from the
half vector. The values fetched from the three enter a small network. Facts are from the authors' code (see
docs/recipes.md), which runs the network in eight bits; ours uses floats.

*Features*, or latents, are the numbers that a texel of a plane gives the network. The network answers log radiance.
From half of the fit on, planes are looked up *rounded*, as the file stores them.
"""

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Literal

import torch
from torch import Tensor, nn

from baselines.planes import Difference, blurred, blurring, half_and_difference, places
from bench.btf import BTF
from bench.codec import Codec, Fit, Parts
from bench.inputs.settings import Natural, NotNegative, Positive, Range, Width
from bench.material import Material, sample_texture, saturated, texel_corners, to_radiance
from bench.training import Batch, Loss, Samples, TextureObjective, TextureSettings, fitted
from bench.training.decoder import Architecture, Decoder
from bench.training.gridded import GriddedMaterial, GriddedNetwork, first_grids, gridded_parts, load_gridded
from bench.training.grids import GridSettings, total_channels
from bench.training.initial_latents import RANDOM_SPREAD, Start
from bench.training.stored_network import load_network
from bench.training.stored_texture import Bits, Rounding, load_texture, store_texture

LAYERS = 3  # hidden layers of the network
PAPER = {"bits": 8, "difference": "rusinkiewicz", "blur": 0.0, "start": "random", "optimiser": "adam", "loss": "l1"}
PAPER |= {"steps": 10_000}


class TriplePlane(Codec):
    """Triple plane: planes of features over texels, half and difference vectors, and a small network.

    Code: https://github.com/Starry316/ComprehensiveNeuralMaterial-Train

    @inproceedings{xu2025comprehensive,
      author = {Xu, Zilin and Chen, Xiang and Liu, Chen and Wang, Beibei and Wang, Lu and Montazeri, Zahra and
        Yan, Ling-Qi},
      title = {Towards Comprehensive Neural Materials: Dynamic Structure-Preserving Synthesis with Accurate Silhouette
        at Instant Inference Speed},
      booktitle = {SIGGRAPH Conference Papers '25},
      articleno = {161},
      year = {2025},
      doi = {10.1145/3721238.3730626}
    }
    """

    name, version = "triple-plane", 2
    sizes = ("channels", "resolution", "width")
    recipes: ClassVar = {"paper": PAPER}

    @dataclass(frozen=True)
    class Settings(TextureSettings, GridSettings):
        recipe: Literal["ours", "paper"] = "ours"  # "paper": its difference vector, loss, random planes, no blur, Adam
        patience: Natural = 0  # steps without a gain of 0.02 dB on its probe that end the fit; 0: never
        channels: Width = 8  # of each plane
        width: Width = 32  # of the network's hidden layers
        resolution: Annotated[int, Range(1, 4096)] = 50  # texels a side of the planes over directions
        difference: Difference = "nearest"  # turn to the half vector: about z, then y as published, or the shortest way
        blur: NotNegative = 5.0  # σ in texels of the planes over directions, so that neighbours fill unseen directions
        start: Start = "mixed"  # of the planes: x and y of directions, and of texels components, both; or all random
        plane_rate: Positive = 1e-2  # highest learning rate of the planes
        loss: Loss = "both"  # error of log radiance: absolute, squared, or their sum; or later errors as displayed
        bits: Bits = 0  # bits of a stored number of the planes on average; 0: chosen by the fit; 16, 32: floats

        @property
        def latents(self) -> int:
            """The features of the plane over texels at full resolution: see `bench.training.grids`."""
            return self.channels

        @property
        def architecture(self) -> Architecture:
            """The network that reads the features of three planes, and of further grids over texels."""
            return Architecture(total_channels(self) + 2 * self.channels, (self.width,) * LAYERS)

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        """Fit planes and network. The plane over texels is the file's part `texture`; both planes over directions are
        in its part `decoder`, beside the network."""
        fitting = fitted(TriplePlaneObjective, self.settings, btf, fit)
        parts = gridded_parts(fitting, fitting.grids)
        parts.decoder.update(store_texture("planes", fitting.planes(), fitting.rounded_planes))
        return parts

    def decode(self, parts: Parts, device: torch.device) -> Material:
        """The material of a file's parts, on a device. `ValueError` if planes and settings do not fit."""
        settings = self.settings
        grids = load_gridded(parts, settings)
        network = GriddedNetwork(Decoder(settings.architecture), settings, grids["latents"].shape[:2])
        load_network(network, parts.decoder)
        planes = list(load_texture("planes", parts.decoder))
        return TriplePlaneMaterial(network, grids, planes, float(parts.other["gain"]), settings).to(device)


class TriplePlaneObjective(TextureObjective):
    """The three planes and the network, all of them fitted."""

    texture_rate = "plane_rate"

    def __init__(self, samples: Samples, settings: TriplePlane.Settings, generator: torch.Generator):
        """Start the network at the mean of the data, and the planes over directions at small random features, or with
        two channels that hold the direction.

        The network's weights are the first numbers of the generator.
        """
        super().__init__(samples, settings)
        decoder = Decoder(settings.architecture, generator)
        decoder.start_at(samples.mean(generator))
        self.network: GriddedNetwork = GriddedNetwork(decoder, settings, samples.shape, generator)
        side, channels = settings.resolution, settings.channels
        self.grids = first_grids(samples, settings, settings.start, generator)
        first_planes = RANDOM_SPREAD * torch.randn(2, side, side, channels, generator=generator)
        if settings.start != "random":
            # The first two channels are x and y of the direction that each texel of a plane stands for: row 0 is y = 1,
            # as in a texture.
            centre = torch.linspace(-1, 1, side)  # of each texel along a side
            xy = torch.stack([centre.expand(side, side), -centre[:, None].expand(side, side)], 2)  # (S, S, 2)
            first_planes[..., : min(2, channels)] = xy[..., :channels]  # of one channel only x
        self.direction_planes = nn.Parameter(first_planes)  # over half and over difference vectors; not blurred
        self.rounded_planes = Rounding(channels, settings.bits)
        # The four texels around the place at which each pair's vector reads its plane, and their weights, (N, 4).
        h, d = half_and_difference(samples.wo, samples.wi, settings.difference)
        h_texel, h_weight = texel_corners((side, side), places(h, side).cpu())
        d_texel, d_weight = texel_corners((side, side), places(d, side).cpu())
        texel = torch.stack([h_texel, d_texel + side * side], 1)  # the second plane's rows follow those of the first
        weight = torch.stack([h_weight, d_weight], 1)
        self.kernel = nn.Buffer(blurring(side, settings.blur), persistent=False)
        self.texel = nn.Buffer(texel, persistent=False)  # (N, 2, 4)
        self.weight = nn.Buffer(weight, persistent=False)  # (N, 2, 4)

    def planes(self) -> Tensor:
        """The planes (2, S, S, C) over the half and the difference vector, blurred but not rounded."""
        return blurred(self.direction_planes, self.kernel)

    def predict(self, batch: Batch, progress: float) -> Tensor:
        """Log radiance (n, 3). The network sees the features of texel, half and difference vector, in this order."""
        texel, weight = self.texel[batch.pair], self.weight[batch.pair]
        of_texel = self.network.fetch_batch(self.grids.rounded(), self.samples, batch)
        planes = self.rounded_planes(self.planes()).flatten(0, 2)  # (2 · S², C)
        rows = planes.index_select(0, texel.flatten()).unflatten(0, texel.shape)  # (n, 2, 4, C)
        features = (rows * weight[..., None]).sum(2).flatten(1)  # (n, 2 · C)
        return self.network(torch.cat([of_texel, features], 1))


class TriplePlaneMaterial(GriddedMaterial):
    """Grids (h, w, C) of features over texels, planes (S, S, C) over half and difference vector, and the network."""

    def __init__(
        self,
        network: GriddedNetwork,
        grids: dict[str, Tensor],
        planes: list[Tensor],
        gain: float,
        settings: TriplePlane.Settings,
    ):
        """Count the cost of an answer, and keep the parts. `ValueError` if planes have other channels than settings."""
        channels = settings.channels
        if any(plane.shape[2] != channels for plane in planes):
            raise ValueError(f"planes of {[plane.shape[2] for plane in planes]} channels for settings of {channels}")
        plane_numbers_read = 2 * 4 * channels  # of four texels of each of the two planes over directions
        flops = settings.architecture.flops + 2 * plane_numbers_read  # each is multiplied and added
        super().__init__(network, grids, flops, gain)  # adds the grids' own reads
        bytes_read = self.cost.bytes_per_sample + 4 * plane_numbers_read  # float32
        table_floats = sum(plane.numel() for plane in planes)
        self.cost = replace(self.cost, table_floats=table_floats, bytes_per_sample=bytes_read)
        self.turn = settings.difference  # how the difference vector is turned
        self.half_plane, self.difference_plane = planes

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        """Linear radiance (n, 3) of queries, each (n, …); see `Material`. The footprint is ignored: there is one level
        of detail."""
        h, d = half_and_difference(wo, wi, self.turn)
        # Weights of halves may add up to a little more than 1.
        of_half = saturated(sample_texture(self.half_plane, places(h, len(self.half_plane))))
        of_difference = saturated(sample_texture(self.difference_plane, places(d, len(self.difference_plane))))
        level = self.network(torch.cat([self.latents(uv, wo), of_half, of_difference], 1))
        return to_radiance(level, self.gain)
