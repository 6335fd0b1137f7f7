"""A hierarchical architecture (Xue et al., "A hierarchical architecture for neural materials", CGF 43(6), 2024).

NeuMIP's pyramid and offset; a decoder of two Inception modules, convolutions side by side, sees the neighbours of a
point, and the place and the directions as sines of octaves. The authors convolve over the picture that a renderer asks
for; here the neighbours are in the material, 9 × 9 places a footprint apart at the directions of the query, so that
every query has one answer. See docs/recipes.md.

`baselines.neumip` says what tables are. *Pictures* are here small squares of S × S texels of one level of
detail; *places* are the points that the decoder sees, and also the setting for the octaves of their u and v.
"""

import math
from collections.abc import Hashable
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import torch
from torch import Tensor, nn
from torch.nn import functional

from baselines.neumip import (
    COARSE_ONE_IN,
    Networks,
    NeuMIP,
    NeuMIPObjective,
    Pyramid,
    PyramidSettings,
    log_of,
    texture_costs,
)
from baselines.pyramids import queries_of, sample_levels
from bench.inputs.settings import BatchSize, NotNegative, Range
from bench.material import DecoderCost, Material, sample_texture, saturated, to_radiance
from bench.metrics.display import LOG_SCALE
from bench.training import Batch, distance
from bench.training.inputs import COUNTS, direction_inputs

CHANNELS = 25  # between the layers: 7, 12, 3 and 3 of the branches
BRANCHES = (7, 12, 3, 3)  # of 1 × 1, 3 × 3 and 5 × 5, and of the maximum of 3 × 3
HALO = 4  # neighbours on each side that two modules see: their largest kernels, of 5 × 5, take two each
SIDE = 2 * HALO + 1  # places a side that the decoder sees for one answer
QUERIES_AT_ONCE = 1_024  # of 81 places each
SOBEL = ((1.0, 0.0, -1.0), (2.0, 0.0, -2.0), (1.0, 0.0, -1.0))
GRADIENT_FROM = 0.25  # of the steps: from there on the loss has its term on gradients
DARKEST = 1e-7  # least radiance × exposure of which a root is taken: at 0 its gradient would be infinite
PAPER = {"steps": 30_000, "batch": 30_000, "patch": 64, "rate": 5e-4, "bits": 8, "directions": "xy", "octaves": 4}
PAPER |= {"start": "random", "optimiser": "adam", "blur": True, "loss": "root", "gradient": 1.0}

Octaves = Annotated[int, Range(0, 16)]


class Inception(nn.Module):
    """Four branches over pictures: (n, 25, S, S) → (n, 25, S − 4, S − 4).

    Each kernel is kept as the matrix of a linear layer, since the optimiser Muon steps matrices.
    """

    def __init__(self, generator: torch.Generator | None):
        """Make the kernels of all branches, drawn from the generator in the order of the file."""
        super().__init__()
        point, three, five, pooled = BRANCHES
        # A kernel of 3 × 3 has 9 inputs a channel, one of 5 × 5 has 25. The order is that of the draws and of the file.
        self.kernels: Any = nn.ModuleList(
            [
                linear(CHANNELS, point, generator),
                linear(CHANNELS, three, generator),  # before the 3 × 3
                linear(9 * three, three, generator),
                linear(CHANNELS, five, generator),  # before the 5 × 5
                linear(25 * five, five, generator),
                linear(CHANNELS, pooled, generator),  # after the maximum
            ]
        )

    def forward(self, x: Tensor) -> Tensor:
        """The branches' answers, one after the other in the channels, for the inner S − 4 texels a side."""
        point, to_three, three, to_five, five, pooled = self.kernels
        inner, outer = x[..., 1:-1, 1:-1], x[..., 2:-2, 2:-2]  # S − 2, S − 4 texels a side
        # Each kernel takes (k − 1) / 2 texels from every border, so smaller ones start from smaller pictures.
        small = convolved(convolved(inner, to_three), three)
        large = convolved(convolved(x, to_five), five)
        highest = convolved(functional.max_pool2d(inner, kernel_size=3, stride=1), pooled)
        return torch.cat([convolved(outer, point), small, large, highest], 1)

    def flops(self, side: int) -> int:
        """Operations of an answer of `side` × `side` texels, a fused multiply-add counted as two."""
        # A 1 × 1 before a larger kernel answers all the texels that this kernel reads.
        point, to_three, three, to_five, five, pooled = (int(layer.weight.numel()) for layer in self.kernels)
        at_answers = side**2 * (point + three + five + pooled)
        before_kernels = (side + 2) ** 2 * to_three + (side + 4) ** 2 * to_five
        return 2 * (at_answers + before_kernels)


def linear(inputs: int, outputs: int, generator: torch.Generator | None) -> nn.Linear:
    """A linear layer that starts as those of `bench.training.Decoder` do, after He et al. 2015, drawn from the
    generator; None: from PyTorch's own."""
    layer = nn.Linear(inputs, outputs)
    with torch.no_grad():
        weight_bound = math.sqrt(6 / inputs)
        layer.weight.uniform_(-weight_bound, weight_bound, generator=generator)
        bias_bound = 1 / math.sqrt(inputs)
        layer.bias.uniform_(-bias_bound, bias_bound, generator=generator)
    return layer


def convolved(x: Tensor, layer: nn.Linear) -> Tensor:
    """Pictures (n, C, S, S) under a layer of k × k kernels and a ReLU: (n, D, S − k + 1, S − k + 1)."""
    side = math.isqrt(layer.in_features // x.shape[1])  # k, since a layer has C · k · k inputs
    kernel = layer.weight.unflatten(1, (x.shape[1], side, side))  # (D, C, k, k)
    return saturated(functional.conv2d(x, kernel, layer.bias)).relu()


class Hierarchy(nn.Module):
    """The decoder: inputs → 25 → two Inception modules → 3.

    The columns of the first matrix are for the directions, then the place, then the latents.
    """

    def __init__(self, inputs: int, generator: torch.Generator | None):
        """Make a layer from `inputs` numbers, two Inception modules, and a layer to three outputs; weights are drawn
        from the generator in this order."""
        super().__init__()
        self.layers: Any = nn.ModuleList()
        self.layers.append(linear(inputs, CHANNELS, generator))
        self.layers.append(Inception(generator))
        self.layers.append(Inception(generator))
        self.layers.append(linear(CHANNELS, 3, generator))

    def hidden_matrices(self) -> list[Tensor]:
        """The kernels of both modules: see `bench.training.optimiser`."""
        matrices = []
        for module in self.layers[1:-1]:
            matrices += [kernel.weight for kernel in module.kernels]
        return matrices

    @torch.no_grad()
    def start_at(self, outputs: Tensor) -> None:
        """Set the last layer to answer `outputs` (3,) for any inputs."""
        self.layers[-1].weight.zero_()
        self.layers[-1].bias.copy_(outputs)

    def forward(self, directions: Tensor, numbers: Tensor) -> Tensor:
        """Outputs (n, S − 8, S − 8, 3) for directions and S × S places of each of n pictures.

        `directions` (n, D) are the inputs of each picture's two directions; `numbers` (n, S, S, E) those of each place:
        its sines, then its latents.
        """
        first, *modules, last = self.layers
        dtype = first.weight.dtype
        count = directions.shape[1]
        # The first layer in two parts: that of the directions is the same for all S × S places.
        of_directions = functional.linear(directions.to(dtype), first.weight[:, :count], first.bias)  # (n, 25)
        of_places = functional.linear(numbers.to(dtype), first.weight[:, count:])  # (n, S, S, 25)
        # In half precision both may be infinite with opposite signs, and their sum then no number.
        x = saturated(saturated(of_places) + saturated(of_directions)[:, None, None])
        x = x.permute(0, 3, 1, 2)  # (n, 25, S, S)
        for module in modules:
            x = module(x)
        return saturated(last(x.permute(0, 2, 3, 1))).to(numbers.dtype)


class HierarchicalNetworks(Networks):
    """The decoder, what makes its inputs, and NeuMIP's offset network."""

    def first_decoder(self, settings: Any, generator: torch.Generator | None) -> Hierarchy:
        """The decoder, as a fit starts with it. Keeps the settings `octaves` and `places`, by which inputs are made."""
        self.octaves, self.places = settings.octaves, settings.places
        numbers = COUNTS[settings.directions]  # of the directions
        of_directions = 2 * settings.octaves * numbers if settings.octaves else numbers  # sin and cos of each octave
        of_place = 4 * settings.places  # sin and cos of each octave of u and of v
        return Hierarchy(of_directions + of_place + settings.channels, generator)

    def direction_numbers(self, wo: Tensor, wi: Tensor) -> Tensor:
        """What the decoder sees of unit directions (n, 3): the numbers (n, D) of `direction_inputs`, or with the
        setting `octaves` their sines (n, 2 D · octaves)."""
        numbers = torch.cat(direction_inputs(wo, wi, self.directions), 1)
        return sines(numbers, self.octaves) if self.octaves else numbers

    def pictures(
        self, pyramid: Pyramid, textures: tuple[Tensor, Tensor | None], queries: tuple[Tensor, ...], side: int = 1
    ) -> Tensor:
        """gain · radiance (n, S, S, 3), not clamped, of pictures of S × S texels of a level, S = `side`.

        The decoder sees (S + 8) × (S + 8) texels around a middle. Queries are uv (n, 2) of these middles, wo and wi
        (n, 3), and level (n,), of an integer type in a fit, and floats in a material. `textures` are the table (rows,
        C) and the offset's texture (H · W, C) or None.
        """
        middle, wo, wi, level = queries
        table, offset = textures
        wide = side + 2 * HALO  # S + 8
        uv = texels_around(pyramid, middle, level, wide).flatten(0, 2)  # (n · texels, 2)
        texels = wide * wide
        texel_levels = level.repeat_interleave(texels)  # (n · texels,)
        place = self.place_numbers(uv, texel_levels, pyramid.side)
        in_fit = not level.is_floating_point()  # only then fetches need a gradient; those without one are faster
        if offset is not None:
            if in_fit:  # the offset's texture has one level, 0
                offset_latents = pyramid.fetch(offset, uv, torch.zeros_like(texel_levels))
            else:
                offset_latents = sample_texture(offset.unflatten(0, pyramid.level_sizes[0]), uv)
            uv = self.moved(uv, offset_latents, wo.repeat_interleave(texels, 0), pyramid.reach)
        if in_fit:
            latents = pyramid.fetch(table, uv, texel_levels)
        else:
            latents = sample_levels(pyramid, table, uv, texel_levels)
        numbers = torch.cat([place.to(latents.dtype), latents], 1).unflatten(0, (len(middle), wide, wide))
        outputs = self.decoder(self.direction_numbers(wo, wi), numbers)  # (n, S, S, 3), in YUV
        return to_radiance(outputs @ self.to_rgb.to(outputs.dtype), gain=1.0)

    def place_numbers(self, uv: Tensor, level: Tensor, side: int) -> Tensor:
        """The sines (n, 4 · places) of uv (n, 2) at levels (n,) of a texture of `side` texels along its longer side.

        `places`, a setting, is the number of octaves. Octave k repeats 2ᵏ times in the texture. It counts whole where a
        period has two texels of the level or more, fades out below, and is 0 from one texel on.
        """
        octave = torch.arange(self.places, device=uv.device)
        log2_of_period = math.log2(side) - level[:, None] - octave  # (n, places), of a period's texels
        share = log2_of_period.clamp(0, 1)  # log2 of two texels is 1, and of one is 0
        # (n, 4, places): sin of u and of v, cos of u and of v. `sines` takes numbers from −1 to 1.
        waves = sines(2 * uv - 1, self.places).unflatten(1, (4, -1))
        return waves.mul(share[:, None]).flatten(1)


def texels_around(pyramid: Pyramid, middle: Tensor, level: Tensor, side: int) -> Tensor:
    """The uv (n, side, side, 2), not wrapped, of n squares of `side` × `side` texels, around middles at uv (n, 2).

    Neighbours lie a texel of the square's level (n,) apart. Rows go from the top, where v is largest, down.
    """
    distance_to_middle = torch.arange(side, device=middle.device) - (side - 1) / 2  # in texels
    right = distance_to_middle.expand(side, side)
    up = -distance_to_middle[:, None].expand(side, side)
    grid = torch.stack([right, up], 2)  # (side, side, 2)
    # (n, 2): the uv from one texel of the level to the next along u and v; `sizes` are rows, then columns.
    step = 2.0 ** level[:, None] / pyramid.sizes[0].flip(0)
    return middle[:, None, None] + grid * step[:, None, None]


def sines(numbers: Tensor, octaves: int) -> Tensor:
    """The sines of 2ᵏ π x, k from 0, for x (n, C), then the cosines: (n, 2 C · octaves), all k of a number together."""
    frequency = math.pi * 2.0 ** torch.arange(octaves, device=numbers.device)
    angle = (numbers[:, :, None] * frequency).flatten(1)  # (n, C · octaves)
    return torch.cat([angle.sin(), angle.cos()], 1)


class HierarchicalObjective(NeuMIPObjective):
    """NeuMIP's textures and the networks, fitted to patches of slices, a quarter of them of a random coarser level."""

    networks_class = HierarchicalNetworks
    networks: HierarchicalNetworks

    def phase(self, progress: float) -> Hashable:
        return super().phase(progress), progress >= GRADIENT_FROM

    def predict(self, batch: Batch, progress: float) -> Tensor:
        """Log radiance (n, 3). Each sample is answered by itself, as the material does, at the finest level."""
        textures = self.textures(progress)
        blocks = [values.split(QUERIES_AT_ONCE) for values in queries_of(self.levels, 0, batch)]
        answers = []
        for queries in zip(*blocks, strict=True):  # a block of them at a time
            answers.append(self.networks.pictures(self.pyramid, textures, queries))
        return log_of(torch.cat(answers)[:, 0, 0])  # pictures of one texel

    def loss(self, generator: torch.Generator, progress: float) -> Tensor:
        """The loss of patches, squares of texels that share two directions.

        It is the distance of log radiance by the setting `loss`, or with `loss=root` of fourth roots of radiance ×
        exposure. From `GRADIENT_FROM` of the steps on, the mean squared error of its `gradients` is added, times the
        setting `gradient`.
        """
        settings = self.settings
        patch = settings.patch
        middle, wo, wi, level, target, pair = self._drawn_patches(generator)
        ours = self.networks.pictures(self.pyramid, self.textures(progress), (middle, wo, wi, level), patch)
        if settings.loss == "root":  # `ours` is gain · radiance, which over LOG_SCALE is radiance × exposure
            ours = (ours / LOG_SCALE).clamp_min(DARKEST) ** 0.25
            target = (target.expm1() / LOG_SCALE).clamp_min(DARKEST) ** 0.25
            loss = distance(ours, target, "l1")
        elif settings.loss == "display":
            ours = log_of(ours)
            pair_of_texel = pair.repeat_interleave(patch**2)
            loss = self.distance(ours.flatten(0, 2), target.flatten(0, 2), pair_of_texel, progress)
        else:
            ours = log_of(ours)
            loss = distance(ours, target, settings.loss)
        if settings.gradient and progress >= GRADIENT_FROM and patch > 2:  # Sobel's kernels have three texels a side
            loss = loss + settings.gradient * gradients(ours - target).square().mean()
        return loss

    def _drawn_patches(self, generator: torch.Generator) -> list[Tensor]:
        """The random patches of a step, as many as the setting `batch` fills, a share of them of a coarser level.

        Returns what `_patches` does, for all of them.
        """
        count = max(1, self.settings.batch // self.settings.patch**2)  # patches of all levels
        coarse_count = count // COARSE_ONE_IN if len(self.levels) > 1 else 0  # of these, those of a coarser level
        patches = [self._patches(0, count - coarse_count, generator)]
        if coarse_count:
            level = int(torch.randint(1, len(self.levels), (), generator=generator))
            patches.append(self._patches(level, coarse_count, generator))
        return [torch.cat(tensors) for tensors in zip(*patches, strict=True)]  # of each the tensors of all patches

    def _patches(self, level: int, count: int, generator: torch.Generator) -> tuple[Tensor, ...]:
        """Random patches of S × S texels of a level, which wrap around its borders.

        Returns uv (count, 2) of their middles, wo and wi (count, 3), the level (count,), the data, log radiance
        (count, S, S, 3), and the pair of directions (count,).
        """
        samples = self.levels[level]
        patch = self.settings.patch
        height, width = samples.shape
        corner = samples.draw(count, generator)  # a patch begins at each of these samples, and has their directions
        uv, wo, wi, level_of_detail = queries_of(self.levels, level, corner)
        texel_size = 2**level / self.pyramid.sizes[0].flip(0)  # (2,), of the level, along u and v
        across, down = ((patch - 1) / 2 * texel_size).unbind()  # from the first texel's centre to the patch's
        middle = torch.stack([uv[:, 0] + across, uv[:, 1] - down], 1)  # rows go down, v goes up
        step = torch.arange(patch, device=uv.device)  # in texels from the first
        first_row = corner.texel.div(width, rounding_mode="floor")
        first_col = corner.texel.remainder(width)
        row = (first_row[:, None] + step).remainder(height)  # (n, S)
        col = (first_col[:, None] + step).remainder(width)  # (n, S)
        texels = (row[:, :, None] * width + col[:, None]).flatten()  # (n · S²,)
        target = samples.seen(texels, corner.pair.repeat_interleave(patch**2)).target
        return middle, wo, wi, level_of_detail, target.unflatten(0, (count, patch, patch)), corner.pair


def gradients(pictures: Tensor) -> Tensor:
    """Sobel's differences along u and v, (3 n, 2, S − 2, S − 2), of pictures (n, S, S, 3)."""
    kernel = pictures.new_tensor(SOBEL)
    flat = pictures.permute(0, 3, 1, 2).flatten(0, 1)[:, None]  # (3 n, 1, S, S)
    return functional.conv2d(flat, torch.stack([kernel, kernel.T])[:, None])  # two kernels, (2, 1, 3, 3)


class HierarchicalMaterial(Material):
    """A table (rows, C) of all levels, an offset texture (H · W, C) or None, and the networks."""

    def __init__(
        self, pyramid: Pyramid, networks: HierarchicalNetworks, table: Tensor, offset: Tensor | None, gain: float
    ):
        """Count the cost of an answer term by term, and keep the parts. `offset` is the texture that the offset network
        reads, or None."""
        first, first_module, second_module, last = networks.decoder.layers
        texture_channels, texture_floats, numbers_read = texture_costs(table, offset)
        offset_flops = networks.offset.architecture.flops if networks.offset is not None else 0
        inputs_of_place = 4 * networks.places + table.shape[1]  # sines and latents
        inputs_of_directions = first.in_features - inputs_of_place
        # At each of 9 × 9 places: the offset, the reads, multiplied and added, and the first layer's part of the place.
        flops = SIDE**2 * (offset_flops + 2 * numbers_read + 2 * inputs_of_place * CHANNELS)
        flops += 2 * inputs_of_directions * CHANNELS  # once: all places have the same directions
        # The first module answers all but two places at each border, the second the one in the middle.
        flops += first_module.flops(SIDE - 4) + second_module.flops(1)
        flops += 2 * last.weight.numel()
        flops += 2 * 9  # YUV to RGB
        cost = DecoderCost(
            parameters=sum(p.numel() for p in networks.parameters()),
            texture_channels=texture_channels,
            texture_floats=texture_floats,
            flops_per_sample=flops,
            bytes_per_sample=SIDE**2 * numbers_read * table.element_size(),
        )
        super().__init__(pyramid.level_sizes[0], cost)
        self.networks = networks
        self.pyramid = pyramid
        self.table = table
        self.offset = offset
        self.gain = gain
        self.chunk = QUERIES_AT_ONCE  # queries that `Material` passes to `evaluate` at once, on a CPU

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        """Linear radiance (n, 3) of queries, each (n, …); see `Material`. Each is a picture of one texel, of the
        footprint's level."""
        queries = uv, wo, wi, self.pyramid.level(footprint)
        return self.networks.pictures(self.pyramid, (self.table, self.offset), queries)[:, 0, 0] / self.gain


class Hierarchical(NeuMIP):
    """A hierarchical architecture: NeuMIP's pyramid and offset, and convolutions over the neighbours of a point.

    Code: https://github.com/yley123/A-Hierarchical-Architecture-for-Neural-Materials

    @article{xue2024hierarchical,
      author = {Xue, Bowen and Zhao, Shuang and Jensen, Henrik Wann and Montazeri, Zahra},
      title = {A Hierarchical Architecture for Neural Materials},
      journal = {Computer Graphics Forum},
      year = {2024},
      url = {https://arxiv.org/abs/2307.10135}
    }
    """

    name, version = "hierarchical", 4
    sizes = ("channels",)
    recipes: ClassVar = {"paper": PAPER}
    recipe_versions: ClassVar = {}  # not NeuMIP's
    objective, material = HierarchicalObjective, HierarchicalMaterial

    @dataclass(frozen=True)
    class Settings(PyramidSettings):
        batch: BatchSize = 4_096  # samples a step, in whole patches
        patch: Annotated[int, Range(1, 1024)] = 8  # texels a side of a patch, whose samples share their directions
        recipe: Literal["ours", "paper"] = "ours"  # "paper": its inputs, start, Adam, blur, loss, rate and batch
        octaves: Octaves = 0  # octaves of the sines of each of these inputs; 0: the inputs themselves
        places: Octaves = 10  # octaves of the sines of u and of v; those that texels cannot show are 0
        loss: Literal["both", "l1", "display", "root"] = "both"  # "root": the published error of fourth roots
        gradient: NotNegative = 0.0  # weight of the squared error of Sobel gradients, from a quarter of the steps on
