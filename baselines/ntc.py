"""Neural texture compression for radiance (after Vaidyanathan et al., SIGGRAPH 2023).

"Random-access neural compression of material textures": two grids of features, of a few bits each, and a tiled encoding
of the texel's place enter a network that answers with channels of a material. Here directions enter too, and the answer
is radiance. The finer grid is read at the four points around a texel, side by side, the coarser one bilinearly. The
network answers texels; queries between them are interpolated.

A *feature* is one of the numbers of a grid's point, from −1 to 1; a file has a *code* of each, a whole number of `bits`
bits. The network answers log radiance.
"""

import copy
import math
from collections.abc import Hashable
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import torch
from torch import Tensor, nn
from torch.nn import functional

from baselines.pyramids import mixed_rows
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

# Encoding of places: it repeats after 8 texels, and has 12 numbers, one for each octave, of x and y, at two phases.
OCTAVES, TILE, PLACE_NUMBERS = 3, 8, 12
OMEGA = 2.0  # frequency of the sine, if the activation is a sine
ROUNDED_FROM = {"noise": 0.95, "round": 0.5}  # share of the steps after which grids are those of the file
GRIDS = ("fine", "coarse")  # names of the grids in the file, and of the settings of their features
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
            """The network that reads both grids, the place and the directions."""
            of_grids = 4 * self.fine + self.coarse  # the finer one is read at four points
            inputs = of_grids + PLACE_NUMBERS + COUNTS[self.directions]
            widths = (self.width,) * self.layers
            sine = self.activation == "sine"
            return Architecture(inputs, widths, activation=self.activation, omega=OMEGA, norm=sine, residual=sine)

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        """Fit both grids and the network, and store the grids' codes, row by row, a few bits each."""
        bits = self.settings.bits
        fitting = fitted(NTCObjective, self.settings, btf, fit)
        texture: dict[str, Tensor] = {}
        for name, grid in zip(GRIDS, fitting.unrounded_grids, strict=True):
            texture[name] = pack_bits(codes_of(grid, bits).flatten(), bits)  # one after the other, without gaps
        return fitting.parts(texture, size=torch.tensor(btf.shape, dtype=torch.int32))

    def decode(self, parts: Parts, device: torch.device) -> Material:
        """The material of a file's parts, on a device. `InputError` if a grid has too few or too many bytes, or
        there are no texels."""
        settings = self.settings
        bits = settings.bits
        network = load_network(Decoder(settings.architecture), parts.decoder)
        size = tuple(parts.other["size"].tolist())
        if min(size) < 1:
            raise InputError(f"it has {size[0]} × {size[1]} texels: encode it again")
        grids = []
        for name, (rows, cols) in zip(GRIDS, grid_sizes(size, settings.reduction), strict=True):
            packed = parts.texture[name]
            features = getattr(settings, name)  # a setting is named as its grid
            count = rows * cols * features
            expected_bytes = (count * bits + 7) // 8  # of all codes, rounded up
            if packed.shape != (expected_bytes,):
                raise InputError(f"its {name} grid does not fit {size[0]} × {size[1]} texels: encode it again")
            values = values_of(unpack_bits(packed, count, bits), bits)
            grids.append(values.reshape(rows * cols, features))
        return NTCMaterial(network, size, grids, float(parts.other["gain"]), settings).to(device)


def grid_sizes(size: tuple[int, ...], reduction: int) -> tuple[tuple[int, int], tuple[int, int]]:
    """The sizes (rows, columns) of the finer and of the coarser grid of a picture of `size` (H, W).

    A point of the finer grid stands for `reduction` texels a side, one of the coarser for twice as many.
    """

    def size_for(texels_of_point: int) -> tuple[int, int]:
        """The size of a grid with `texels_of_point` texels a side for each point, rounded up to cover the picture."""
        return math.ceil(size[0] / texels_of_point), math.ceil(size[1] / texels_of_point)

    return size_for(reduction), size_for(2 * reduction)


def codes_of(values: Tensor, bits: int) -> Tensor:
    """Codes of `bits` bits, int64, of values from −1 to 1, any shape; values beyond are clamped."""
    shares = (values.detach().clamp(-1, 1) + 1) / 2  # from 0 to 1
    return (shares * (2**bits - 1)).round().long()


def values_of(codes: Tensor, bits: int) -> Tensor:
    """The values, from −1 to 1, of codes of `bits` bits, any shape."""
    return codes.float() * (2 / (2**bits - 1)) - 1


def encoded_places(size: tuple[int, ...]) -> Tensor:
    """The tiled encoding (H · W, 12), from −1 to 1, of each texel's place in a picture of `size` (H, W).

    It has triangle waves of 8, 4 and 2 texels, along x and y, at two phases.
    """
    row, col = torch.meshgrid(*(torch.arange(side) + 0.5 for side in size), indexing="ij")
    # The axes of the next tensors are H · W, octaves, x and y, and phases.
    place = torch.stack([col, row], 2).flatten(0, 1)[:, None, :, None] / TILE  # in tiles
    octaves = 2.0 ** torch.arange(OCTAVES)[:, None, None]
    phases = torch.tensor([0.0, 0.25])  # in turns of a wave
    turns = place * octaves + phases
    # A triangle wave is −1 where a turn begins, and 1 in its middle.
    from_middle = (turns - turns.floor() - 0.5).abs()
    return (1 - 4 * from_middle).flatten(1)


def corners_of_texels(grid: tuple[int, int], size: tuple[int, ...]) -> tuple[Tensor, Tensor]:
    """The four points (H · W, 4) of a periodic grid around each texel of a picture, and their bilinear weights.

    `grid` is its size (rows, columns), `size` the picture's (H, W). A point is given as row · columns + column. Places
    are computed in whole numbers: as floats, a place that should meet a point could fall to either side of it.
    """
    firsts = []  # of rows, then of columns: the point before each texel
    shares = []  # how far the texel is from this point to the next, from 0 to 1
    for points, side in zip(grid, size, strict=True):
        # Texel i lies (i + 1/2) · points / side − 1/2 points behind the first one, here in units of 1 / (2 · side).
        place = (2 * torch.arange(side) + 1) * points - side
        firsts.append(place.div(2 * side, rounding_mode="floor"))
        shares.append(place.remainder(2 * side) / (2 * side))
    row, col = torch.meshgrid(*firsts, indexing="ij")  # (H, W)
    below, right = torch.meshgrid(*shares, indexing="ij")  # weights of the points below and at the right
    above, left = 1 - below, 1 - right
    # The flat index of a point is the sum of that of its row's first point and of its column.
    top = row.remainder(grid[0]) * grid[1]
    bottom = (row + 1).remainder(grid[0]) * grid[1]
    west = col.remainder(grid[1])
    east = (col + 1).remainder(grid[1])
    index = torch.stack([top + west, top + east, bottom + west, bottom + east], 2)
    weight = torch.stack([above * left, above * right, below * left, below * right], 2)
    return index.flatten(0, 1), weight.flatten(0, 1)


class Reader(nn.Module):
    """The network's input for each texel of a picture: where its grids are read, and the encoding of its place."""

    def __init__(self, size: tuple[int, ...], reduction: int):
        """Find the grid points and the encoding of each texel of a picture of `size` (H, W), once for all steps."""
        super().__init__()
        fine_grid, coarse_grid = grid_sizes(size, reduction)
        fine, _ = corners_of_texels(fine_grid, size)  # all four points enter the network, so they need no weights
        coarse, weight = corners_of_texels(coarse_grid, size)
        self.fine = nn.Buffer(fine, persistent=False)  # (H · W, 4)
        self.coarse = nn.Buffer(coarse, persistent=False)  # (H · W, 4)
        self.weight = nn.Buffer(weight, persistent=False)  # (H · W, 4), of the coarser grid's points
        self.place = nn.Buffer(encoded_places(size), persistent=False)  # (H · W, 12)

    def forward(self, texel: Tensor, fine: Tensor, coarse: Tensor) -> Tensor:
        """The network's inputs (n, 4 · F + C + 12) for texels (n,), given the grids (points, F) and (points, C)."""
        fine_points = fine.index_select(0, self.fine[texel].flatten()).unflatten(0, (-1, 4))  # (n, 4, F)
        of_fine = fine_points.flatten(1)  # (n, 4 · F)
        of_coarse = mixed_rows(coarse, self.coarse[texel], self.weight[texel])  # (n, C)
        return torch.cat([of_fine, of_coarse, self.place[texel].to(of_fine.dtype)], 1)


class NTCObjective(DirectedObjective):
    """Both grids, (points, features) with values from −1 to 1, and the network, all of them fitted."""

    def __init__(self, samples: Samples, settings: NTC.Settings, generator: torch.Generator):
        """Start the grids at the first latents of `first_latents`, averaged to their resolution."""
        super().__init__(samples, settings, generator)
        self.reader = Reader(samples.shape, settings.reduction)
        channels = [settings.fine, settings.coarse]
        latents = first_latents(samples, sum(channels), settings.start, generator)
        first_channels = latents.T.unflatten(1, samples.shape)  # (F + C, H, W)
        sizes = grid_sizes(samples.shape, settings.reduction)
        self.unrounded_grids = nn.ParameterList()
        for picture, size in zip(first_channels.split(channels), sizes, strict=True):
            grid = functional.adaptive_avg_pool2d(picture, size).flatten(1).T  # (points, features)
            self.unrounded_grids.append(nn.Parameter(grid.clamp(-1, 1).contiguous()))

    def phase(self, progress: float) -> Hashable:
        return super().phase(progress), progress >= ROUNDED_FROM[self.settings.rounding]

    def grids(self, progress: float, generator: torch.Generator | None = None) -> list[Tensor]:
        """Both grids as they are read at some progress of the fit, from 0 to 1.

        At first they are as fitted, or with a generator and `rounding=noise` with noise, which stands for the rounding;
        from `ROUNDED_FROM` on they are rounded as in the file. Clamps the fitted grids to −1 and 1 in place.
        """
        bits, rounding = self.settings.bits, self.settings.rounding
        grids = []
        for grid in self.unrounded_grids:
            with torch.no_grad():
                stored = values_of(codes_of(grid.clamp_(-1, 1), bits), bits)
            if progress >= ROUNDED_FROM[rounding]:
                if rounding == "noise":  # as published, the grids then stop moving: `stored` has no gradient
                    grids.append(stored)
                else:  # of this sum, which is `stored`, the gradient ignores the rounding
                    grids.append(grid + (stored - grid).detach())
            elif rounding == "noise" and generator is not None:
                # Uniform noise as wide as the step between two codes.
                noise = torch.rand(grid.shape, generator=generator).to(grid.device, non_blocking=True) - 0.5
                grids.append(grid + noise * (2 / (2**bits - 1)))
            else:
                grids.append(grid)
        return grids

    def predict(self, batch: Batch, progress: float, generator: torch.Generator | None = None) -> Tensor:
        """Log radiance (n, 3) of a batch. Without a generator the grids have no noise, as for the fit's curve."""
        return self.answers(self.reader(batch.texel, *self.grids(progress, generator)), batch.pair)

    def loss(self, generator: torch.Generator, progress: float) -> Tensor:
        batch = self.samples.draw(self.settings.batch, generator)
        return self.distance(self.predict(batch, progress, generator), batch.target, batch.pair, progress)


def hashed(uv: Tensor) -> Tensor:
    """A number (n, 1) from 0 to below 1 for each uv (n, 2): a fixed hash of its bits, which looks random.

    Odd factors and shifts mix the bits in 32-bit arithmetic; & 0xFFFFFFFF keeps 32 bits.
    """
    bits = uv.float().contiguous().view(torch.int32).long() & 0xFFFFFFFF  # as if unsigned
    x = (bits[:, :1] * 0x85EBCA6B + bits[:, 1:] * 0xC2B2AE35) & 0xFFFFFFFF
    for shift in (16, 15):  # each round folds the high bits into the low ones, and multiplies
        x = ((x ^ (x >> shift)) * 0x2C1B3C6D) & 0xFFFFFFFF
    lowest_24_bits = (x ^ (x >> 12)).bitwise_and(0xFFFFFF)  # as many as a float32 holds
    return lowest_24_bits.float() / (1 << 24)


class NTCMaterial(Material):
    """Two grids, (points, features), and the network, which answers the four texels around a place, one by one."""

    one_texel = False  # whether a query is answered by one texel, drawn at random, not by four

    def __init__(
        self, network: Decoder, size: tuple[int, ...], grids: list[Tensor], gain: float, settings: NTC.Settings
    ):
        """Count the cost of an answer, which asks the network at four texels, and keep the parts."""
        architecture = network.architecture
        fine, coarse = grids
        channels = fine.shape[1] + coarse.shape[1]
        floats = fine.numel() + coarse.numel()
        coarse_flops = 2 * 4 * coarse.shape[1]  # four points, multiplied and added; the finer ones are not mixed
        colour_flops = 2 * 3  # the answer's three colours, multiplied by the texel's weight and added
        flops_of_texel = architecture.flops + coarse_flops + colour_flops
        numbers_of_texel = 4 * channels  # at four points of both grids
        cost = DecoderCost(
            parameters=architecture.parameters,
            texture_channels=channels,
            texture_floats=floats,
            flops_per_sample=4 * flops_of_texel,  # of four texels
            bytes_per_sample=4 * numbers_of_texel * fine.element_size(),
        )
        super().__init__((size[0], size[1]), cost)
        self.network = network
        self.fine = fine
        self.coarse = coarse
        self.gain = gain
        self.reader = Reader(size, settings.reduction)
        self.directions = settings.directions

    def at_one_texel(self) -> Material:
        """This material with stochastic filtering, as published: the network answers one texel a query, not four.

        The texel is drawn by the bilinear weights, from a hash of the query's uv.
        """
        material = copy.copy(self)  # shares all tensors
        material.one_texel = True
        return material

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        """Linear radiance (n, 3) of queries, each (n, …); see `Material`. The footprint is ignored: there is one level
        of detail.

        The network answers each of four texels, or one that is drawn by their weights; their radiances are mixed.
        """
        texel, weight = texel_corners(self.size, uv)
        if self.one_texel:
            # The first of the four whose running sum of weights is above the hash: (n, 1). If it is none of the first
            # three, it is the last.
            corner = (weight.cumsum(1)[:, :3] <= hashed(uv)).sum(1, keepdim=True)
            texel = texel.gather(1, corner)
            weight = torch.ones_like(weight[:, :1])
        count = texel.shape[1]  # texels a query
        directions = torch.cat(direction_inputs(wo, wi, self.directions), 1).repeat_interleave(count, 0)
        features = self.reader(texel.flatten(), self.fine, self.coarse)
        outputs = self.network(torch.cat([features, directions.to(features.dtype)], 1))  # (n · count, 3)
        # Each texel is clamped as `Material` clamps an answer: as if it were asked for by itself.
        texels = to_radiance(outputs, self.gain).clamp_min(0).unflatten(0, (-1, count))  # (n, count, 3)
        return (texels * weight[..., None].to(texels.dtype)).sum(1)
