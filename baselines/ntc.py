"""Neural texture compression for radiance (after Vaidyanathan et al., SIGGRAPH 2023).

"Random-access neural compression of material textures": two grids of features, of a few bits each, and a tiled encoding
of the texel's place enter a network that answers with channels of a material. Here directions enter too, and the answer
is radiance. The finer grid is read at the four points around a texel, side by side, the coarser one bilinearly. The
network answers texels; queries between them are interpolated.
"""

import copy
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import torch
from torch import Tensor, nn
from torch.nn import functional

from bench.btf import BTF
from bench.codec import Codec, Fit, Parts
from bench.inputs.errors import InputError
from bench.inputs.settings import Count, Layers, Range, Width
from bench.material import DecoderCost, Material, texel_corners, to_radiance
from bench.training import Batch, DirectedObjective, FitSettings, Samples, first_latents, fitted
from bench.training.decoder import Activation, Architecture, Decoder
from bench.training.inputs import COUNTS, Directions, direction_inputs
from bench.training.quantise import pack_bits, unpack_bits
from bench.training.stored_network import load_network

OCTAVES, TILE, PLACE = 3, 8, 12  # encoding of places: it repeats after 8 texels, and has 12 numbers
OMEGA = 2.0  # frequency of the sine, if the activation is a sine
ROUNDED_FROM = {"noise": 0.95, "round": 0.5}  # share of the steps after which grids are those of the file
GRIDS = ("fine", "coarse")
PAPER = {"reduction": 4, "fine": 12, "directions": "xy", "activation": "leaky-relu", "rounding": "noise"}
PAPER |= {"start": "random", "optimiser": "adam", "rate": 5e-3, "loss": "l2", "steps": 10_000}


class NTC(Codec):
    """Neural texture compression: two grids of a few bits, a tiled encoding of places, a network of two layers.

    Code: https://github.com/NVIDIA-RTX/RTXNTC

    @article{vaidyanathan2023random,
      author = {Vaidyanathan, Karthik and Salvi, Marco and Wronski, Bartlomiej and Akenine-Möller, Tomas and
        Ebelin, Pontus and Lefohn, Aaron},
      title = {Random-Access Neural Compression of Material Textures},
      journal = {ACM Transactions on Graphics},
      volume = {42},
      number = {4},
      articleno = {88},
      year = {2023},
      doi = {10.1145/3592407}
    }
    """

    name, version = "ntc", 3
    sizes = ("fine", "coarse", "width")
    recipes: ClassVar = {"paper": PAPER}

    @dataclass(frozen=True)
    class Settings(FitSettings):
        recipe: Literal["ours", "paper"] = "ours"  # "paper": its grids, rounding, rates and loss, ω_o and ω_i alone
        reduction: Count = 1  # texels a point of the finer grid; the coarser has half as many points a side
        fine: Width = 6  # features of the finer grid, each read at four points
        coarse: Width = 20  # features of the coarser grid
        bits: Annotated[int, Range(1, 8)] = 4  # bits of each feature
        rounding: Literal["noise", "round"] = "round"  # in the fit: noise of one step, or rounded from halfway on
        directions: Directions = "xyzh"  # inputs: x and y of both, or all of both and of their half vector
        layers: Layers = 2  # hidden layers of the network
        width: Width = 64  # channels of each hidden layer
        activation: Activation = "sine"  # activation of the hidden layers; a sine has a layer norm before it

        @property
        def architecture(self) -> Architecture:
            inputs = 4 * self.fine + self.coarse + PLACE + COUNTS[self.directions]
            widths = (self.width,) * self.layers
            sine = self.activation == "sine"
            return Architecture(
                inputs, widths, outputs=3, activation=self.activation, omega=OMEGA, norm=sine, residual=sine
            )

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        """Fit both grids and the network, and store the grids' codes, row by row, a few bits each."""
        bits = self.settings.bits
        fitting = fitted(NTCObjective, self.settings, btf, fit)
        packed = (pack_bits(codes_of(grid, bits).flatten(), bits) for grid in fitting.free)
        texture = dict(zip(GRIDS, packed, strict=True))
        return fitting.parts(texture, size=torch.tensor(btf.shape, dtype=torch.int32))

    def decode(self, parts: Parts, device: torch.device) -> Material:
        settings = self.settings
        bits = self.settings.bits
        network = load_network(Decoder(settings.architecture), parts.decoder)
        size = tuple(parts.other["size"].tolist())
        grids = []
        for name, (rows, cols) in zip(GRIDS, sizes(size, settings.reduction), strict=True):
            packed = parts.texture[name]
            count = rows * cols * getattr(settings, name)
            # The bytes of all codes, rounded up.
            if min(size) < 1 or packed.shape != ((count * bits + 7) // 8,):
                raise InputError(f"its {name} grid does not fit {size[0]} × {size[1]} texels: encode it again")
            grids.append(values_of(unpack_bits(packed, count, bits), bits).reshape(rows * cols, -1))
        return NTCMaterial(network, size, grids, float(parts.other["gain"]), settings).to(device)


def sizes(size: tuple[int, ...], reduction: int) -> tuple[tuple[int, int], ...]:
    """The sizes (rows, columns) of the finer and of the coarser grid of a picture (H, W)."""
    # Rounded up, so that the grid covers the picture.
    return tuple((-(-size[0] // each), -(-size[1] // each)) for each in (reduction, 2 * reduction))


def codes_of(values: Tensor, bits: int) -> Tensor:
    """Codes of `bits` bits, int64, of values from −1 to 1, any shape; values beyond are clamped."""
    return ((values.detach().clamp(-1, 1) + 1) / 2 * (2**bits - 1)).round().long()


def values_of(codes: Tensor, bits: int) -> Tensor:
    """The values, from −1 to 1, of codes of `bits` bits, any shape."""
    return codes.float() * (2 / (2**bits - 1)) - 1


def encoded_places(size: tuple[int, ...]) -> Tensor:
    """The tiled encoding (H · W, 12) of each texel's place: triangle waves of 8, 4 and 2 texels, at two phases."""
    row, col = torch.meshgrid(*(torch.arange(side) + 0.5 for side in size), indexing="ij")
    place = torch.stack([col, row], 2).flatten(0, 1)[:, None, :, None] / TILE  # (H · W, octave, axis, phase)
    # In turns of each wave; the second phase is a quarter of a turn later. A wave is 1 in the middle of its turn.
    turns = place * 2.0 ** torch.arange(OCTAVES)[:, None, None] + torch.tensor([0.0, 0.25])
    return (1 - 4 * (turns - turns.floor() - 0.5).abs()).flatten(1)


def corners_of_texels(grid: tuple[int, int], size: tuple[int, ...]) -> tuple[Tensor, Tensor]:
    """Flat points (H · W, 4) of a periodic grid and bilinear weights (H · W, 4) around each texel of a picture (H, W).

    Places are counted in whole numbers. Those of floats would fall to either side of a point that they should meet.
    """
    firsts, afters = [], []
    for points, side in zip(grid, size, strict=True):
        # Texel i lies (i + 1/2) · points / side − 1/2 points behind the first one, here in units of 1 / (2 · side).
        place = (2 * torch.arange(side) + 1) * points - side
        firsts.append(place.div(2 * side, rounding_mode="floor"))
        afters.append(place.remainder(2 * side) / (2 * side))
    row, col = torch.meshgrid(*firsts, indexing="ij")  # (H, W)
    below, right = torch.meshgrid(*afters, indexing="ij")
    north, south = (each.remainder(grid[0]) * grid[1] for each in (row, row + 1))
    west, east = (each.remainder(grid[1]) for each in (col, col + 1))
    above, left = 1 - below, 1 - right
    index = torch.stack([north + west, north + east, south + west, south + east], 2)
    weight = torch.stack([above * left, above * right, below * left, below * right], 2)
    return index.flatten(0, 1), weight.flatten(0, 1)


class Reader(nn.Module):
    """The network's input for each texel of a picture: where its grids are read, and the encoding of its place."""

    def __init__(self, size: tuple[int, ...], reduction: int):
        super().__init__()
        (fine, _), (coarse, weight) = (corners_of_texels(grid, size) for grid in sizes(size, reduction))
        # Three of (H · W, 4), and the encoded places (H · W, 12).
        self.fine, self.coarse, self.weight, self.place = (
            nn.Buffer(values, persistent=False) for values in (fine, coarse, weight, encoded_places(size))
        )

    def forward(self, texel: Tensor, fine: Tensor, coarse: Tensor) -> Tensor:
        """The numbers (n, 4 · F + C + 12) of texels (n,), of grids (points, F) and (points, C)."""
        near = fine.index_select(0, self.fine[texel].flatten()).unflatten(0, (-1, 4)).flatten(1)  # (n, 4 · F)
        around = coarse.index_select(0, self.coarse[texel].flatten()).unflatten(0, (-1, 4))  # (n, 4, C)
        wide = (around * self.weight[texel][..., None].to(around.dtype)).sum(1)  # (n, C)
        return torch.cat([near, wide, self.place[texel].to(near.dtype)], 1)


class NTCObjective(DirectedObjective):
    """Both grids, (points, features), and the network, all free."""

    def __init__(self, samples: Samples, settings: NTC.Settings, generator: torch.Generator):
        super().__init__(samples, settings, generator)
        self.reader = Reader(samples.shape, settings.reduction)
        channels = [settings.fine, settings.coarse]
        latents = first_latents(samples, sum(channels), settings.start, generator)
        first = latents.T.unflatten(1, samples.shape)  # (F + C, H, W)
        both = zip(first.split(channels), sizes(samples.shape, settings.reduction), strict=True)
        means = (functional.adaptive_avg_pool2d(part, size).flatten(1).T for part, size in both)
        self.free = nn.ParameterList([nn.Parameter(grid.clamp(-1, 1).contiguous()) for grid in means])

    def grids(self, progress: float, generator: torch.Generator | None = None) -> list[Tensor]:
        """Both grids as they are read at some progress of the fit; a generator draws their noise."""
        bits, rounding = self.settings.bits, self.settings.rounding
        grids = []
        for grid in self.free:
            with torch.no_grad():
                stored = values_of(codes_of(grid.clamp_(-1, 1), bits), bits)
            if progress >= ROUNDED_FROM[rounding]:  # as published, noisy grids then stop moving
                # Rounded ones go on: of `grid + (stored - grid).detach()` the gradient ignores the rounding.
                grids.append(stored if rounding == "noise" else grid + (stored - grid).detach())
            elif rounding == "noise" and generator is not None:
                noise = torch.rand(grid.shape, generator=generator).to(grid.device, non_blocking=True) - 0.5
                grids.append(grid + noise * (2 / (2**bits - 1)))
            else:
                grids.append(grid)
        return grids

    def predict(self, batch: Batch, progress: float, generator: torch.Generator | None = None) -> Tensor:
        """Log radiance (n, 3); only with a generator have the grids noise, so that the curve has none."""
        return self.answers(self.reader(batch.texel, *self.grids(progress, generator)), batch.pair)

    def loss(self, generator: torch.Generator, progress: float) -> Tensor:
        batch = self.samples.draw(self.settings.batch, generator)
        return self.distance(self.predict(batch, progress, generator), batch.target, batch.pair, progress)


def hashed(uv: Tensor) -> Tensor:
    """A number (n, 1) from 0 to below 1 of each uv (n, 2): a fixed hash of its bits."""
    bits = uv.float().contiguous().view(torch.int32).long() & 0xFFFFFFFF  # as if unsigned
    x = (bits[:, :1] * 0x85EBCA6B + bits[:, 1:] * 0xC2B2AE35) & 0xFFFFFFFF
    for shift in (16, 15):
        x = ((x ^ (x >> shift)) * 0x2C1B3C6D) & 0xFFFFFFFF
    return (x ^ (x >> 12)).bitwise_and(0xFFFFFF).float() / (1 << 24)


class NTCMaterial(Material):
    """Two grids, (points, features), and the network, which answers the four texels around a place, one by one."""

    one_texel = False

    def __init__(
        self, network: Decoder, size: tuple[int, ...], grids: list[Tensor], gain: float, settings: NTC.Settings
    ):
        architecture = network.architecture
        fine, coarse = grids
        channels = fine.shape[1] + coarse.shape[1]
        floats = fine.numel() + coarse.numel()
        # Of four texels: the network, four points of the coarser grid, and three colours to be mixed.
        flops = 4 * (architecture.flops + 2 * 4 * coarse.shape[1] + 6)
        cost = DecoderCost(
            parameters=architecture.parameters,
            texture_channels=channels,
            texture_floats=floats,
            flops_per_sample=flops,
            bytes_per_sample=4 * 4 * channels * fine.element_size(),
        )
        super().__init__((size[0], size[1]), cost)
        self.network = network
        self.fine = fine
        self.coarse = coarse
        self.gain = gain
        self.reader = Reader(size, settings.reduction)
        self.directions = settings.directions

    def at_one_texel(self) -> Material:
        """As published: one network a query, by stochastic filtering."""
        material = copy.copy(self)
        material.one_texel = True
        return material

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        """The network answers each of four texels, or one that is drawn by their weights; their radiances are mixed."""
        texel, weight = texel_corners(self.size, uv)
        if self.one_texel:
            # The first of the four whose running sum of weights is above the number: (n, 1).
            drawn = (weight.cumsum(1)[:, :3] <= hashed(uv)).sum(1, keepdim=True)
            texel = texel.gather(1, drawn)
            weight = torch.ones_like(weight[:, :1])
        count = texel.shape[1]
        directions = torch.cat(direction_inputs(wo, wi, self.directions), 1).repeat_interleave(count, 0)
        features = self.reader(texel.flatten(), self.fine, self.coarse)
        texels = to_radiance(self.network(torch.cat([features, directions.to(features.dtype)], 1)), self.gain)
        return (texels.clamp_min(0).unflatten(0, (-1, count)) * weight[..., None].to(texels.dtype)).sum(1)
