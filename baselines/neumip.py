"""NeuMIP (Kuznetsov et al., "NeuMIP: Multi-resolution neural materials", ACM Trans. Graph. 40(4), 2021).

A pyramid of latents fetched trilinearly by footprint, a small decoder, and a neural offset that moves the look-up along
the view, as parallax does. Details that the paper leaves open follow the authors' published configuration, but
for what docs/recipes.md lists.

A *table* (rows, C) holds the latents of all levels of detail, the finest first, a row a texel. From half of the fit on,
textures are looked up *rounded*, as the file stores them: see `bench.training.stored_texture`.
"""

import math
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import torch
from torch import Tensor, nn
from torch.nn import functional

from baselines import pyramids
from baselines.pyramids import Levels, drawn_samples, fitted_level_count, mixed_rows, queries_of, sample_levels
from bench.btf import BTF, periods
from bench.codec import Codec, Fit, Parts
from bench.inputs.errors import InputError
from bench.inputs.settings import IF_SET, Natural, Positive, Width
from bench.material import DecoderCost, Material, sample_texture, to_radiance
from bench.metrics.display import LOG_SCALE
from bench.training import (
    Batch,
    FromHost,
    Objective,
    ParameterGroup,
    Samples,
    TextureSettings,
    gain_of,
    groups_of,
    on_host,
    phase_by_halves,
    train,
)
from bench.training.decoder import Architecture, Decoder
from bench.training.initial_latents import RANDOM_SPREAD, Start, first_latents
from bench.training.inputs import COUNTS, Directions, direction_inputs
from bench.training.stored_network import load_network, store_network
from bench.training.stored_texture import Bits, Rounding, load_texture, store_texture

WIDTHS = (25, 25, 25)  # of the offset network; the decoder has as many hidden layers
OFFSET_SCALE = 0.05  # texture units; the authors' 0.1 counts in uv from −1 to 1
# The most that an offset can be. While textures are blurred a depth costs nothing, so it must not be larger than the
# blur: a fit that drifted to four times it kept that depth, 7 dB below others.
DEEPEST = 1.0
LOWEST_COSINE = 0.6  # least z of the view: below it, the offset stops growing
COARSE_ONE_IN = 4  # one of this many samples is of a coarser level
# Gaussian blur, σ in texels. That of the latents falls exponentially from the first to the last.
FIRST_BLUR = 8.0
FADING = 3 * math.log(8)  # the exponent's rate, over the whole fit
LAST_BLUR = 0.1  # least σ of the latents' blur
FAR_SAMPLES = 4_096  # samples that tell how far the offset of a fit that ended moves look-ups
OFFSET_BLUR = 1.0  # least σ of the offset texture's blur
SHUT = 0.1  # share of the colour that a mask of 0 leaves
HALF_OPEN = SHUT + 0.5  # the mask of an output of 0, whose sigmoid is 1/2
YUV_TO_RGB = ((1.0, 0.0, 1.13983), (1.0, -0.39465, -0.58060), (1.0, 2.03211, 0.0))
# Weights of the loss: squared error of log radiance, its absolute error, absolute error of radiance.
LOSSES = {"balanced": (1.0, 0.0, 0.01), "highlights": (1.0, 0.0, 0.1), "l1": (0.0, 1.0, 0.0), "both": (1.0, 1.0, 0.0)}
PAPER = {"bits": 8, "directions": "xy", "start": "random", "optimiser": "adam", "blur": True, "loss": "balanced"}
PAPER |= {"weights_start": "pytorch", "rate": 1e-3}


@dataclass(frozen=True)
class PyramidSettings(TextureSettings):
    """The settings that `neumip` and `hierarchical` share."""

    patience: Natural = 0  # steps without a gain of 0.02 dB on its probe that end the fit; 0: never
    start: Start = "mixed"  # of finest latents and offsets: components, both; or random, and zeros
    weights_start: Literal["mean", "pytorch"] = field(default="mean", metadata=IF_SET)  # a mean first; or as published
    rate: Positive = 1e-2  # highest learning rate
    directions: Directions = "xyzh"  # inputs: x and y of both as published, or all of both and of their half vector
    channels: Width = 7  # of the pyramid, and of the offset texture
    offset: bool = True  # the neural offset; without it the decoder alone
    blur: bool = False  # blur the textures at first, less and less, as NeuMIP's authors do
    bits: Bits = 0  # bits of a stored number of the textures on average; 0: chosen by the fit; 16, 32: floats


def level_count(size: tuple[int, int]) -> int:
    """The number of levels of a picture of `size` (H, W), at least 1.

    It is the authors' ⌊log2 of the longer side⌋, or fewer: further ones would have no texel along the shorter side.
    """
    as_published = int(math.log2(max(size)))
    return max(1, min(as_published, pyramids.level_count(size)))


class Pyramid(Levels):
    """The latents of all levels in one table, and the reach of an offset."""

    def __init__(self, size: tuple[int, int], levels: int | None = None):
        """Lay out the levels of a picture of `size` (H, W): so many `levels`, or all if it is None."""
        super().__init__(size, level_count(size) if levels is None else levels)
        # (2,): how far in uv an offset of 1 moves a place along u and along v, equally far on the surface.
        self.reach = nn.Buffer(OFFSET_SCALE * torch.tensor(periods(size)), persistent=False)

    def fetch(self, table: Tensor, uv: Tensor, level: Tensor) -> Tensor:
        """Values (n, C) of a table (rows, C) at uv (n, 2), bilinear, periodic, and linear between two levels.

        Levels (n,) are floats or of an integer type: see `Levels.around`. It is for a fit: it has a gradient.
        """
        return mixed_rows(table, *self.around(uv, level))


class Networks(nn.Module):
    """The decoder and, if the settings ask for it, the offset network."""

    def __init__(self, settings: Any, generator: torch.Generator | None = None):
        """Make the networks, with weights drawn from the generator. `settings` are those of `NeuMIP`, or of a codec
        made of it."""
        super().__init__()
        self.directions = settings.directions
        self.decoder: Any = self.first_decoder(settings, generator)
        of_offset = Architecture(settings.channels + 2, WIDTHS, outputs=1)  # of latents, and of x and y of the view
        self.offset = Decoder(of_offset, generator) if settings.offset else None
        # (3, 3): rows of YUV times it are rows of RGB.
        self.to_rgb = nn.Buffer(torch.tensor(YUV_TO_RGB).T.contiguous(), persistent=False)

    def first_decoder(self, settings: Any, generator: torch.Generator | None) -> nn.Module:
        """The decoder, as a fit starts with it; its inputs are those of two directions, then the latents."""
        inputs = COUNTS[settings.directions] + settings.channels
        return Decoder(Architecture(inputs, (settings.width,) * len(WIDTHS), settings.outputs), generator)

    @torch.no_grad()
    def start_as_pytorch(self, generator: torch.Generator) -> None:
        """Draw all weights and biases anew, as PyTorch draws those of a linear layer: uniform within 1 / √inputs."""
        for layer in self.modules():
            if isinstance(layer, nn.Linear):
                bound = 1 / math.sqrt(layer.in_features)
                layer.weight.uniform_(-bound, bound, generator=generator)
                layer.bias.uniform_(-bound, bound, generator=generator)

    def start_at(self, level: Tensor) -> None:
        """Set the networks to answer one log radiance (3,) for any latents, with the mask half open."""
        # Three outputs are the colour; further ones are the mask, which outputs of 0 leave half open.
        outputs = torch.zeros(len(self.decoder.layers[-1].bias))
        radiance = level.cpu().expm1()  # times the gain
        if len(outputs) > 3:  # the mask will multiply the colour
            radiance = radiance / HALF_OPEN
        # The colour's outputs are log radiance in YUV: solve YUV · to_rgb = log radiance.
        outputs[:3] = torch.linalg.solve(self.to_rgb.T, radiance.log1p())
        self.decoder.start_at(outputs)

    def moved(self, uv: Tensor, latents: Tensor, wo: Tensor, reach: Tensor) -> Tensor:
        """uv (n, 2) shifted along the view wo (n, 3) by the offset network's output for latents (n, C) of its texture.

        `reach` (2,) is that of `Pyramid`: uv of an offset of 1.
        """
        assert self.offset is not None
        output = self.offset(torch.cat([latents, wo[:, :2]], 1))  # (n, 1)
        depth = DEEPEST * (output / DEEPEST).tanh()  # without a limit, some fits moved look-ups by hundreds of pictures
        return uv + depth.to(uv.dtype) * (wo[:, :2] * reach) / wo[:, 2:].clamp_min(LOWEST_COSINE)

    def colour(self, latents: Tensor, wo: Tensor, wi: Tensor) -> Tensor:
        """gain · radiance (n, 3), not clamped, of latents (n, C): YUV → RGB → expm1, times a mask if there is one."""
        outputs = self.decoder(torch.cat([*direction_inputs(wo, wi, self.directions), latents], 1))
        rgb = to_radiance(outputs[:, :3] @ self.to_rgb.to(outputs.dtype), gain=1.0)  # callers divide by the gain
        if outputs.shape[1] > 3:  # three more outputs, a mask for each colour
            mask = SHUT + outputs[:, 3:].sigmoid()
            rgb = rgb * mask
        return rgb


def answer(
    networks: Networks, pyramid: Pyramid, table: Tensor, offset: Tensor | None, queries: tuple[Tensor, ...]
) -> Tensor:
    """gain · radiance (n, 3) of queries: uv (n, 2), wo and wi (n, 3), level (n,).

    `table` (rows, C) has the latents of all levels. `offset` (H · W, C) is the texture of the offset network, of the
    size of the finest level; None: uv is not moved.
    """
    uv, wo, wi, level = queries
    if offset is not None:
        finest = torch.zeros_like(level, dtype=torch.long)
        uv = networks.moved(uv, pyramid.fetch(offset, uv, finest), wo, pyramid.reach)
    return networks.colour(pyramid.fetch(table, uv, level), wo, wi)


class NeuMIPObjective(Objective):
    """The textures and both networks, fitted at the finest level and, for a share of each step's samples, at a random
    coarser one."""

    networks_class: ClassVar[type[Networks]] = Networks

    def __init__(self, levels: list[Samples], settings: Any, generator: torch.Generator):
        """Start textures and networks. `levels` are the samples of the BTF at each level of detail, the finest
        first; `settings` are the codec's. The networks' weights are the first numbers of the generator."""
        super().__init__(levels[0], settings)  # `self.samples` are those of the finest level
        self.levels = levels
        self.pyramid = Pyramid(self.samples.shape, len(levels))
        self.networks = self.networks_class(settings, generator)
        if settings.weights_start == "pytorch":
            self.networks.start_as_pytorch(generator)
        else:
            self.networks.start_at(self.samples.mean(generator))
        finest = first_latents(self.samples, settings.channels, settings.start, generator)
        self.table = nn.Parameter(self._first_table(finest, generator))
        # Components that separate texels also separate heights; from zeros the offset is found late or never.
        first_offset = torch.zeros_like(finest) if settings.start == "random" else finest.clone()
        self.offset = nn.Parameter(first_offset) if settings.offset else None
        self.rounded_table = Rounding(settings.channels, settings.bits, sizes=self.pyramid.level_sizes)
        one_level = [self.samples.shape]  # of the offset's texture
        self.rounded_offset = Rounding(settings.channels, settings.bits, sizes=one_level) if settings.offset else None

    def _first_table(self, finest: Tensor, generator: torch.Generator) -> Tensor:
        """The first latents (rows, C) of all levels: the finest ones (H · W, C), and box averages of them.

        With `start=random` the coarser ones are random, too, and spread as widely; averages would be less spread.
        """
        if self.settings.start == "random":
            count = sum(self.pyramid.counts[1:])
            channels = finest.shape[1]
            coarser = RANDOM_SPREAD * torch.randn(count, channels, generator=generator)
            return torch.cat([finest, coarser])
        picture = finest.T.unflatten(1, self.samples.shape)  # (C, H, W)
        averages = (functional.adaptive_avg_pool2d(picture, size) for size in self.pyramid.level_sizes)
        return torch.cat([average.flatten(1).T for average in averages])  # (rows of all levels, C)

    def phase(self, progress: float) -> Hashable:
        return phase_by_halves(progress)

    def stored_networks(self) -> list[nn.Module]:
        return [self.networks]

    def groups(self) -> list[ParameterGroup]:
        """The networks' groups, then both textures, all at the setting `rate`."""
        settings = self.settings
        networks = groups_of([self.networks], settings.rate, settings.optimiser, settings.hidden_rate)
        textures = [self.table] if self.offset is None else [self.table, self.offset]
        return [*networks, {"params": textures, "lr": settings.rate}]

    def blurred_textures(self, progress: float) -> tuple[Tensor, Tensor | None]:
        """The table and the offset texture as they are looked up at some progress of the fit, from 0 to 1.

        The offset's is always blurred, the table only by the setting `blur`. σ in texels is halved from each level to
        the next, so it is as wide on the surface. The offset's texture is None if there is no offset.
        """
        table: Tensor = self.table
        of_offset = falloff_factor(OFFSET_BLUR)
        if self.settings.blur:
            of_offset, *of_levels = on_host(self._falloff_factors, progress, self.table.device).tensors
            parts = zip(table.split(self.pyramid.counts), self.pyramid.level_sizes, of_levels, strict=True)
            table = torch.cat([blur(values, size, factor) for values, size, factor in parts])
        if self.offset is None:
            return table, None
        return table, blur(self.offset, self.samples.shape, of_offset)

    def _falloff_factors(self, progress: float) -> FromHost:
        """What `blur` takes with the setting `blur`, another number at each step: for the offset's texture, then for
        the levels of the table."""
        sigma = max(LAST_BLUR, FIRST_BLUR * math.exp(-FADING * progress))
        of_levels = [falloff_factor(sigma / 2**level) for level in range(len(self.pyramid.level_sizes))]
        return FromHost([falloff_factor(max(sigma, OFFSET_BLUR)), *of_levels], plan=())

    def textures(self, progress: float) -> tuple[Tensor, Tensor | None]:
        """The table and the offset texture of `blurred_textures`, rounded as in the file once bits are chosen."""
        table, offset = self.blurred_textures(progress)
        if offset is not None and self.rounded_offset is not None:
            offset = self.rounded_offset(offset)
        return self.rounded_table(table), offset

    @torch.no_grad()
    def faults(self) -> list[str]:
        """A sentence if the offset moves look-ups by more than the picture is wide: no parallax does."""
        if self.offset is None:
            return []
        batch = self.samples.draw(FAR_SAMPLES, torch.Generator().manual_seed(0))
        uv, wo, _, level = queries_of(self.levels, 0, batch)
        _, offset = self.textures(1.0)
        assert offset is not None
        latents = self.pyramid.fetch(offset, uv, torch.zeros_like(level, dtype=torch.long))
        moved_uv = self.networks.moved(uv, latents, wo, self.pyramid.reach)
        farthest = float((moved_uv - uv).abs().max())
        if farthest <= 1:
            return []
        return [f"its offset moves look-ups by up to {farthest:.3g} pictures"]

    def predict(self, batch: Batch, progress: float) -> Tensor:
        """Log radiance (n, 3) of a batch, whose texels are those of the finest level."""
        queries = queries_of(self.levels, 0, batch)
        return log_of(answer(self.networks, self.pyramid, *self.textures(progress), queries))

    def loss(self, generator: torch.Generator, progress: float) -> Tensor:
        """Three errors by the weights of `LOSSES`, the last of radiance × exposure; or the loss `display`."""
        queries, target, pair = drawn_samples(self.levels, self.settings.batch, COARSE_ONE_IN, generator)
        ours = answer(self.networks, self.pyramid, *self.textures(progress), queries)
        if self.settings.loss == "display":
            return self.distance(log_of(ours), target, pair, progress)
        # `ours` and the exponential of the target are gain · radiance, hence LOG_SCALE × radiance × exposure.
        squared_weight, absolute_weight, linear_weight = LOSSES[self.settings.loss]
        squared = functional.mse_loss(log_of(ours), target)
        absolute = functional.l1_loss(log_of(ours), target)
        linear = functional.l1_loss(ours, target.expm1())
        return squared_weight * squared + absolute_weight * absolute + linear_weight * linear / LOG_SCALE


def log_of(values: Tensor) -> Tensor:
    """Log radiance of gain · radiance x, any shape, by the authors' curve log1p(max(x, −0.1)).

    Between −0.1 and 0 there is still a gradient.
    """
    return values.clamp_min(-0.1).log1p()


def falloff_factor(sigma: float) -> Tensor:
    """−2 π² σ², a float64 scalar, for a Gaussian of σ in texels: its spectrum is exp(−2 π² σ² f²)."""
    return torch.tensor(-2 * (math.pi * sigma) ** 2, dtype=torch.float64)


def blur(texture: Tensor, size: tuple[int, int], factor: Tensor) -> Tensor:
    """A periodic texture (H · W, C) of a size (H, W), convolved with a Gaussian, whose `falloff_factor` is `factor`."""
    height, width = size
    device = texture.device
    down = torch.fft.fftfreq(height, device=device)  # (H,), frequencies
    across = torch.fft.rfftfreq(width, device=device)  # (W // 2 + 1,)
    squared_frequency = down.square()[:, None] + across.square()  # (H, W // 2 + 1)
    gaussian = (factor * squared_frequency).exp()
    spectrum = torch.fft.rfft2(texture.reshape(height, width, -1), dim=(0, 1))  # (H, W // 2 + 1, C)
    smooth = torch.fft.irfft2(spectrum * gaussian[..., None], s=size, dim=(0, 1))
    return smooth.reshape(height * width, -1)


def texture_costs(table: Tensor, offset: Tensor | None) -> tuple[int, int, int]:
    """The channels a texel, the stored numbers, and the numbers that one look-up reads, of a table (rows, C) and an
    offset texture (H · W, C) or None."""
    channels = table.shape[1]
    of_table = 8 * channels  # four texels of each of two levels
    if offset is None:
        return channels, table.numel(), of_table
    of_offset = 4 * channels  # its texture has one level
    return 2 * channels, table.numel() + offset.numel(), of_table + of_offset


class NeuMIPMaterial(Material):
    """A table (rows, C) of all levels, an offset texture (H · W, C) or None, and the networks."""

    def __init__(self, pyramid: Pyramid, networks: Networks, table: Tensor, offset: Tensor | None, gain: float):
        """Count the cost of an answer term by term, and keep the parts."""
        decoder = networks.decoder.architecture
        parameters, network_flops = decoder.parameters, decoder.flops
        if networks.offset is not None:
            parameters += networks.offset.architecture.parameters
            network_flops += networks.offset.architecture.flops
        texture_channels, texture_floats, numbers_read = texture_costs(table, offset)
        yuv_to_rgb = 2 * 9  # a matrix of 3 × 3
        cost = DecoderCost(
            parameters=parameters,
            texture_channels=texture_channels,
            texture_floats=texture_floats,
            flops_per_sample=network_flops + 2 * numbers_read + yuv_to_rgb,  # what is read is multiplied and added
            bytes_per_sample=numbers_read * table.element_size(),
        )
        super().__init__(pyramid.level_sizes[0], cost)
        self.networks = networks
        self.pyramid = pyramid
        self.table = table
        self.offset = offset
        self.gain = gain

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        """Linear radiance (n, 3) of queries, each (n, …); see `Material`. The offset moves uv first."""
        if self.offset is not None:
            latents = sample_texture(self.offset.unflatten(0, self.size), uv)
            uv = self.networks.moved(uv, latents, wo, self.pyramid.reach)
        latents = sample_levels(self.pyramid, self.table, uv, self.pyramid.level(footprint))
        return self.networks.colour(latents, wo, wi) / self.gain


class NeuMIP(Codec):
    """NeuMIP: a pyramid of latents, a parallax offset and a decoder; answers at any footprint.

    Code: https://github.com/straintensor/NeuMIP

    @article{kuznetsov2021neumip,
      author = {Kuznetsov, Alexandr and Mullia, Krishna and Xu, Zexiang and Hašan, Miloš and Ramamoorthi, Ravi},
      title = {{NeuMIP}: Multi-Resolution Neural Materials},
      journal = {ACM Transactions on Graphics},
      volume = {40},
      number = {4},
      articleno = {175},
      year = {2021},
      doi = {10.1145/3450626.3459795}
    }
    """

    name, version = "neumip", 7
    sizes = ("channels",)
    recipes: ClassVar = {"paper": PAPER}
    recipe_versions: ClassVar = {"paper": 8}
    objective: ClassVar[type[NeuMIPObjective]] = NeuMIPObjective
    material: ClassVar[Callable[..., Material]] = NeuMIPMaterial

    @dataclass(frozen=True)
    class Settings(PyramidSettings):
        recipe: Literal["ours", "paper"] = "ours"  # "paper": its inputs, start, rate, Adam, the authors' blur and loss
        steps: Natural = 10_000  # steps of the fit
        width: Width = 25  # of the decoder's hidden layers
        outputs: int = 6  # of the decoder: colour and mask, as in the authors' code, or 3, colour, as in their text
        loss: Literal["both", "l1", "display", "balanced", "highlights"] = "both"  # the last two are the authors'

        def __post_init__(self) -> None:
            """`InputError` if there are neither 3 outputs, a colour, nor 6, a colour and a mask."""
            if self.outputs not in (3, 6):
                raise InputError(f"codec neumip has 3 or 6 outputs, not {self.outputs}")

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        """Fit all levels, and store the pyramid and the offset's texture as they are looked up at the fit's end."""
        gain = gain_of(btf, fit)
        count = fitted_level_count(btf, fit, level_count(btf.shape))  # all, or those that a scene sees
        levels = Samples.levels(btf, count, gain, fit)
        objective = self.objective(levels, self.settings, fit.generator())
        progress = train(objective, fit, self.settings.steps, self.settings.patience)  # share of the steps taken
        # As blurred in the last step, because the file holds what is looked up.
        pyramid, offset = objective.blurred_textures(progress=progress)
        level_sizes = objective.pyramid.level_sizes
        texture = store_texture("pyramid", pyramid.detach(), objective.rounded_table, level_sizes)
        if offset is not None and objective.rounded_offset is not None:
            texture |= store_texture("offset", offset.detach(), objective.rounded_offset, [btf.shape])
        other = {"gain": torch.tensor([gain]), "size": torch.tensor(btf.shape, dtype=torch.int32)}
        if count < level_count(btf.shape):  # in a fit to a scene; otherwise a file need not say it
            other["levels"] = torch.tensor([count], dtype=torch.uint8)
        return Parts(store_network(objective.networks, self.settings.weights), texture, other=other)

    def decode(self, parts: Parts, device: torch.device) -> Material:
        """The material of a file's parts, on a device. `ValueError` if its pyramid has no such levels, or its textures
        have another size or other channels."""
        networks = load_network(self.objective.networks_class(self.settings), parts.decoder)
        height, width = parts.other["size"].tolist()
        levels = int(parts.other["levels"]) if "levels" in parts.other else None  # None: all of them
        too_small = min(height, width) < 1
        if too_small or (levels is not None and not 1 <= levels <= level_count((height, width))):
            raise ValueError(f"a pyramid of {levels} levels over {height} × {width} texels")
        pyramid = Pyramid((height, width), levels)
        offset = load_texture("offset", parts.texture, [(height, width)]) if self.settings.offset else None
        table = load_texture("pyramid", parts.texture, pyramid.level_sizes)
        channels = self.settings.channels
        table_fits = table.shape == (sum(pyramid.counts), channels)
        offset_fits = offset is None or offset.shape == (height * width, channels)
        if not (table_fits and offset_fits):
            raise ValueError(f"its textures do not fit {height} × {width} texels of {channels} channels")
        return self.material(pyramid, networks, table, offset, float(parts.other["gain"])).to(device)
