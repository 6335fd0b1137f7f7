"""A hierarchical architecture (Xue et al., "A hierarchical architecture for neural materials", CGF 43(6), 2024).

NeuMIP's pyramid and offset; a decoder of two Inception modules, convolutions side by side, sees the neighbours of a
point, and the place and the directions as sines of octaves. The authors convolve over the picture that a renderer asks
for; here the neighbours are in the material, 9 × 9 places a footprint apart at the directions of the query, so that
every query has one answer. See docs/recipes.md.
"""

import math
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import torch
from torch import Tensor, nn
from torch.nn import functional

from baselines.neumip import COARSE_SHARE, Networks, NeuMIP, NeuMIPObjective, Pyramid, PyramidSettings, _log
from baselines.pyramids import queries_of, sampled
from bench.inputs.settings import BatchSize, NotNegative, Range
from bench.material import DecoderCost, Material, sample_texture, saturated, to_radiance
from bench.metrics.display import LOG_SCALE
from bench.training import Batch, distance
from bench.training.inputs import COUNTS, direction_inputs

CHANNELS = 25  # between the layers: 7, 12, 3 and 3 of the branches
BRANCHES = (7, 12, 3, 3)  # of 1 × 1, 3 × 3 and 5 × 5, and of the maximum of 3 × 3
HALO = 4  # neighbours on each side that two modules see
SIDE = 2 * HALO + 1
ANSWERED = 1_024  # queries at a time, of 81 places each
SOBEL = ((1.0, 0.0, -1.0), (2.0, 0.0, -2.0), (1.0, 0.0, -1.0))
GRADIENT_FROM = 0.25  # of the steps: from there on the loss has its term on gradients
DARKEST = 1e-7  # radiance of which a root is still taken
PAPER = {"steps": 30_000, "batch": 30_000, "patch": 64, "rate": 5e-4, "bits": 8, "directions": "xy", "octaves": 4}
PAPER |= {"start": "random", "optimiser": "adam", "blur": True, "loss": "root", "gradient": 1.0}

Octaves = Annotated[int, Range(0, 16)]


class Inception(nn.Module):
    """Four branches over pictures (n, 25, S, S) → (n, 25, S − 4, S − 4); each kernel is a matrix, for Muon."""

    def __init__(self, generator: torch.Generator | None):
        super().__init__()
        point, three, five, pooled = BRANCHES
        # Inputs and outputs: 1 × 1; 1 × 1 and after it 3 × 3; 1 × 1 and after it 5 × 5; 1 × 1 after the maximum.
        # A kernel of 3 × 3 has 9 inputs a channel, one of 5 × 5 has 25.
        shapes = (CHANNELS, point), (CHANNELS, three), (9 * three, three), (CHANNELS, five), (25 * five, five)
        self.kernels: Any = nn.ModuleList(linear(*shape, generator) for shape in (*shapes, (CHANNELS, pooled)))

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
        """Operations of an answer of side × side texels, a fused multiply-add counted as two."""
        counts = (side, side + 2, side, side + 4, side, side)  # a side of each kernel's answer, in their order
        return sum(2 * n * n * int(layer.weight.numel()) for n, layer in zip(counts, self.kernels, strict=True))


def linear(inputs: int, outputs: int, generator: torch.Generator | None) -> nn.Linear:
    """A layer as `bench.training.Decoder` starts its own, after He et al. 2015."""
    layer = nn.Linear(inputs, outputs)
    with torch.no_grad():
        bound = math.sqrt(6 / inputs)
        layer.weight.uniform_(-bound, bound, generator=generator)
        layer.bias.uniform_(-1 / math.sqrt(inputs), 1 / math.sqrt(inputs), generator=generator)
    return layer


def convolved(x: Tensor, layer: nn.Linear) -> Tensor:
    """Pictures (n, C, S, S) under a layer of k × k kernels and a ReLU: (n, D, S − k + 1, S − k + 1)."""
    side = math.isqrt(layer.in_features // x.shape[1])
    kernel = layer.weight.unflatten(1, (x.shape[1], side, side))  # (D, C, k, k)
    return saturated(functional.conv2d(x, kernel, layer.bias)).relu()


class Hierarchy(nn.Module):
    """The decoder: inputs → 25 → two modules → 3. The first matrix reads directions, places, then latents."""

    def __init__(self, inputs: int, generator: torch.Generator | None):
        super().__init__()
        modules = (Inception(generator) for _ in range(2))
        self.layers: Any = nn.ModuleList(
            [linear(inputs, CHANNELS, generator), *modules, linear(CHANNELS, 3, generator)]
        )

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
        """Outputs (n, S − 8, S − 8, 3) of directions (n, D) and of numbers (n, S, S, E) of each place."""
        first, *modules, last = self.layers
        dtype = first.weight.dtype
        count = directions.shape[1]
        seen = functional.linear(directions.to(dtype), first.weight[:, :count], first.bias)  # (n, 25)
        own = functional.linear(numbers.to(dtype), first.weight[:, count:])  # (n, S, S, 25)
        # In half precision each may be infinite, and their sum then no number.
        x = saturated(saturated(own) + saturated(seen)[:, None, None]).permute(0, 3, 1, 2)  # (n, 25, S, S)
        for module in modules:
            x = module(x)
        return saturated(last(x.permute(0, 2, 3, 1))).to(numbers.dtype)


class HierarchicalNetworks(Networks):
    """The decoder, what it sees, and NeuMIP's offset network."""

    def first(self, settings: Any, generator: torch.Generator | None) -> Hierarchy:
        """The decoder, as a fit starts with it; the octaves that it sees are noted for `seen` and `placed`."""
        self.octaves, self.places = settings.octaves, settings.places
        seen = COUNTS[settings.directions] * max(1, 2 * settings.octaves)  # sin and cos of each octave, or none
        return Hierarchy(seen + 4 * settings.places + settings.channels, generator)

    def seen(self, wo: Tensor, wi: Tensor) -> Tensor:
        """What the decoder sees of unit directions (n, 3)."""
        numbers = torch.cat(direction_inputs(wo, wi, self.directions), 1)
        return sines(numbers, self.octaves) if self.octaves else numbers

    def pictures(
        self, pyramid: Pyramid, textures: tuple[Tensor, Tensor | None], queries: tuple[Tensor, ...], side: int = 1
    ) -> Tensor:
        """gain · radiance (n, S, S, 3), not clamped, of pictures of S × S texels of a level, which see S + 8.

        Queries: uv (n, 2) of their middles, wo and wi (n, 3), and level (n,), whole in a fit.
        """
        middle, wo, wi, level = queries
        table, offset = textures
        wide = side + 2 * HALO  # S + 8
        # Texels from the middle along u and v, row by row from the top, where v is largest.
        apart = torch.arange(wide, device=middle.device) - (wide - 1) / 2
        grid = torch.stack([apart.expand(wide, wide), -apart[:, None].expand(wide, wide)], 2)  # (S + 8, S + 8, 2)
        step = 2.0 ** level[:, None] / pyramid.sizes[0].flip(0)  # (n, 2), of a texel along u and v
        uv = (middle[:, None, None] + grid * step[:, None, None]).flatten(0, 2)  # (n · texels, 2)
        texels = wide * wide
        each = level.repeat_interleave(texels)  # the level of each texel
        place = self.placed(uv, each, pyramid.side)
        fits = not level.is_floating_point()
        if offset is not None:
            finest = offset.unflatten(0, pyramid.levels[0])
            own = pyramid.fetch(offset, uv, torch.zeros_like(each)) if fits else sample_texture(finest, uv)
            uv = self.move(uv, own, wo.repeat_interleave(texels, 0), pyramid.reach)
        latents = pyramid.fetch(table, uv, each) if fits else sampled(pyramid, table, uv, each)
        numbers = torch.cat([place.to(latents.dtype), latents], 1).unflatten(0, (len(middle), wide, wide))
        out = self.decoder(self.seen(wo, wi), numbers)  # (n, S, S, 3)
        return to_radiance(out @ self.to_rgb.to(out.dtype), gain=1.0)

    def placed(self, uv: Tensor, level: Tensor, side: int) -> Tensor:
        """The sines (n, 4 · places) of uv (n, 2); an octave fades out from two texels of the level a period to one."""
        octave = torch.arange(self.places, device=uv.device)
        share = (math.log2(side) - level[:, None] - octave).clamp(0, 1)  # (n, places)
        waves = sines(2 * uv - 1, self.places).unflatten(1, (4, -1))  # (n, 4, places)
        return waves.mul(share[:, None]).flatten(1)


def sines(numbers: Tensor, octaves: int) -> Tensor:
    """sin and cos of 2ᵏ π x, k from 0, of numbers x (n, C): (n, 2 C · octaves), the octaves of each side by side."""
    angle = (numbers[:, :, None] * (math.pi * 2.0 ** torch.arange(octaves, device=numbers.device))).flatten(1)
    return torch.cat([angle.sin(), angle.cos()], 1)


class HierarchicalObjective(NeuMIPObjective):
    """NeuMIP's textures and the networks, fitted to patches of slices, a quarter of them of a random coarser level."""

    made_of = HierarchicalNetworks
    networks: HierarchicalNetworks

    def predict(self, batch: Batch, progress: float) -> Tensor:
        """Each sample is answered by itself, as the material does, at the finest level."""
        textures = self.textures(progress)
        queries = queries_of(self.levels, 0, batch)
        parts = zip(*(each.split(ANSWERED) for each in queries), strict=True)
        answers = [self.networks.pictures(self.pyramid, textures, part) for part in parts]
        return _log(torch.cat(answers)[:, 0, 0])  # pictures of one texel

    def loss(self, generator: torch.Generator, progress: float) -> Tensor:
        """The loss of patches: of log radiance, or of fourth roots of radiance × exposure; later of gradients, too."""
        settings = self.settings
        patch = self.settings.patch
        count = max(1, settings.batch // patch**2)
        coarse = count // COARSE_SHARE if len(self.levels) > 1 else 0
        drawn = [self._patches(0, count - coarse, generator)]
        if coarse:
            level = int(torch.randint(1, len(self.levels), (), generator=generator))
            drawn.append(self._patches(level, coarse, generator))
        *queries, target = (torch.cat(both) for both in zip(*drawn, strict=True))
        ours = self.networks.pictures(self.pyramid, self.textures(progress), tuple(queries), patch)
        if settings.loss == "root":
            ours, target = ((x / LOG_SCALE).clamp_min(DARKEST) ** 0.25 for x in (ours, target.expm1()))
        else:
            ours = _log(ours)
        loss = distance(ours, target, "l1" if settings.loss == "root" else settings.loss)
        if settings.gradient and progress >= GRADIENT_FROM and patch > 2:
            loss = loss + settings.gradient * gradients(ours - target).square().mean()
        return loss

    def _patches(self, level: int, count: int, generator: torch.Generator) -> tuple[Tensor, ...]:
        """Middles, directions, level and log radiance (count, S, S, 3) of random patches of a level, which wrap."""
        samples = self.levels[level]
        patch = self.settings.patch
        height, width = samples.shape
        corner = samples.draw(count, generator)
        uv, wo, wi, levels = queries_of(self.levels, level, corner)
        # From the centre of the first texel to that of the patch, along u and v.
        across, down = ((patch - 1) / 2 * (2**level / self.pyramid.sizes[0].flip(0))).unbind()
        middle = torch.stack([uv[:, 0] + across, uv[:, 1] - down], 1)
        along = torch.arange(patch, device=uv.device)
        row = (corner.texel.div(width, rounding_mode="floor")[:, None] + along).remainder(height)  # (n, S)
        col = (corner.texel.remainder(width)[:, None] + along).remainder(width)  # (n, S)
        texels = (row[:, :, None] * width + col[:, None]).flatten()  # (n · S²,)
        target = samples.seen(texels, corner.pair.repeat_interleave(patch**2)).target
        return middle, wo, wi, levels, target.unflatten(0, (count, patch, patch))


def gradients(pictures: Tensor) -> Tensor:
    """Sobel's differences along u and v, (3 n, 2, S − 2, S − 2), of pictures (n, S, S, 3)."""
    kernel = pictures.new_tensor(SOBEL)
    flat = pictures.permute(0, 3, 1, 2).flatten(0, 1)[:, None]  # (3 n, 1, S, S)
    return functional.conv2d(flat, torch.stack([kernel, kernel.T])[:, None])  # two kernels, (2, 1, 3, 3)


class HierarchicalMaterial(Material):
    """A table of all levels, an offset texture (H · W, C) or None, and the networks."""

    def __init__(
        self, pyramid: Pyramid, networks: HierarchicalNetworks, table: Tensor, offset: Tensor | None, gain: float
    ):
        first, a, b, last = networks.decoder.layers
        channels = table.shape[1]
        reads = channels * (8 + (0 if offset is None else 4))  # eight texels of two levels, four of the offset's
        numbers = 4 * networks.places + channels
        moved = 0 if networks.offset is None else networks.offset.architecture.flops
        # The first module answers all but two places at each border, the second the one in the middle.
        flops = SIDE**2 * (moved + 2 * reads + 2 * numbers * CHANNELS) + a.flops(SIDE - 4) + b.flops(1)
        flops += 2 * CHANNELS * (first.in_features - numbers) + 2 * last.weight.numel() + 2 * 9
        cost = DecoderCost(
            parameters=sum(p.numel() for p in networks.parameters()),
            texture_channels=channels * (1 if offset is None else 2),
            texture_floats=table.numel() + (0 if offset is None else offset.numel()),
            flops_per_sample=flops,
            bytes_per_sample=SIDE**2 * reads * table.element_size(),
        )
        super().__init__(pyramid.levels[0], cost)
        self.networks = networks
        self.pyramid = pyramid
        self.table = table
        self.offset = offset
        self.gain = gain
        self.chunk = ANSWERED

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
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

    name, version = "hierarchical", 2
    sizes = ("channels",)
    recipes: ClassVar = {"paper": PAPER}
    objective, material = HierarchicalObjective, HierarchicalMaterial

    @dataclass(frozen=True)
    class Settings(PyramidSettings):
        batch: BatchSize = 4_096  # samples a step, in whole patches
        patch: Annotated[int, Range(1, 1024)] = 8  # texels a side of a patch, whose samples share their directions
        recipe: Literal["ours", "paper"] = "ours"  # "paper": its inputs, start, Adam, blur, loss, rate and batch
        octaves: Octaves = 0  # octaves of the sines of each of these inputs; 0: the inputs themselves
        places: Octaves = 10  # octaves of the sines of u and of v; those that texels cannot show are 0
        loss: Literal["both", "l1", "root"] = "both"  # log errors; or the absolute error of fourth roots, as published
        gradient: NotNegative = 0.0  # weight of the squared error of Sobel gradients, from a quarter of the steps on
