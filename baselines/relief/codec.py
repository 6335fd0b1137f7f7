"""Relief: the height of the surface, found in the training slices and marched at decoding, under a neural texture.

Every published neural texture blurs a texel over the places where its views saw it. Here a plane sweep first finds the
height of each texel; latents then belong to surface points, and the network learns only their reflectance. A height
that fails the test on other views is not written. See docs/relief.md.

The material marches the view ray to the surface, or without a height moves the look-up by a small network; fetches
the latents there, from grids at full, half and quarter resolution; and shades. The network sees ω_o, ω_i and the half
vector h in xyz, and with a height how far the relief rises into the ray to the light.
"""

import math
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from baselines.pyramids import Pyramid, Queries, drawn, fitted_levels, level_count, queries_of
from baselines.relief import geometry, sweep
from baselines.relief.geometry import Surface, restored, slope, smoothed, stepped, wrapped
from bench.btf import BTF
from bench.codec import Codec, Fit, Parts
from bench.inputs.errors import InputError
from bench.inputs.settings import Layers, Natural, Positive, Range, Width
from bench.material import DecoderCost, Material, sample_texture, to_radiance
from bench.training import (
    Batch,
    Loss,
    Objective,
    ParameterGroup,
    Samples,
    TextureSettings,
    compress,
    expand,
    gain_of,
    groups_of,
    train,
)
from bench.training.decoder import Architecture, Decoder
from bench.training.grids import FACTORS, Further, Grids, GridSettings, Offset, channels, load_grids, size_of, total
from bench.training.initial_latents import first_latents
from bench.training.inputs import COUNTS, direction_inputs
from bench.training.stored_network import WeightPrecision, load_network, store_network

COARSE_SHARE = 8  # one of this many samples is of a coarser level
# Share of the steps. Earlier, latents are still misplaced, and would pull the height with them.
REFINED_FROM = 0.5
RENEWED = 10  # steps between two surfaces that are marched, while the height is refined
HIGHEST = 2 * geometry.REACH  # and −HIGHEST the lowest height, in widths of the picture: what a decoder reads
HEIGHT_RATE = 0.02  # texels, the highest learning rate of the height
DEEPEST = 3.0  # level of detail of footprints of 8 texels, which the network sees as 1
SHADOW = 0.5  # texels: about half of the penumbra that a texel's width makes


class Network(nn.Module):
    """Latents and directions (n, 3) → log radiance (n, 3); with `relief` it also sees the light's horizon."""

    def __init__(self, settings: Any, relief: bool, generator: torch.Generator | None = None):
        super().__init__()
        self.shadow: bool = relief and settings.shadow
        # Latents, the level of detail, directions, and how far the relief rises into the ray to the light.
        inputs = total(settings) + 1 + COUNTS["xyzh"] + self.shadow
        widths = (settings.width,) * settings.layers
        outputs = 6 if self.shadow else 3  # radiance, and a mask of it
        self.decoder = Decoder(Architecture(inputs, widths, outputs, activation="silu"), generator)
        self.offset = Offset(settings.offset, generator) if settings.offset and not relief else None

    @property
    def flops(self) -> int:
        """Operations of one sample, a fused multiply-add counted as two."""
        return self.decoder.architecture.flops + (self.offset.flops if self.offset is not None else 0)

    def start_at(self, level: Tensor) -> None:
        """Set the network to answer one log radiance (3,) for any inputs, with the mask open."""
        rest = self.decoder.architecture.outputs - 3
        self.decoder.start_at(functional.pad(level.cpu(), (0, rest), value=2.0))

    def forward(self, latents: list[Tensor], level: Tensor, wo: Tensor, wi: Tensor, excess: Tensor | None) -> Tensor:
        """Log radiance (n, 3) of the latents (n, C) of each grid.

        `level` (n, 1) is that of detail, `excess` (n, 1) in texels, if there is a relief.
        """
        numbers = [level / DEEPEST, *direction_inputs(wo, wi, "xyzh")]
        if excess is not None:
            numbers.append((excess * SHADOW).tanh())
        inputs = [*latents, *(each.to(latents[0].dtype) for each in numbers)]
        out = self.decoder(torch.cat(inputs, 1)).to(wo.dtype)
        if excess is None:
            return out
        # log1p(mask · radiance): a mask removes light, but a log radiance would rarely go below 0.
        radiance = out[:, :3].clamp(max=60).expm1()
        return (radiance * out[:, 3:].sigmoid()).clamp_min(-0.5).log1p()


class Pyramids(nn.Module):
    """Each grid of a texture of `size`, and its coarser levels, by name; a file holds the finest level of each."""

    def __init__(self, settings: Any, size: tuple[int, int], relief: bool):
        super().__init__()
        self.side = max(size)
        self.coarsest = level_count(size) - 1
        names = channels(settings, offset=not relief)
        self.each: Any = nn.ModuleDict({name: Pyramid(size_of(name, size)) for name in names})

    def tables(self, grids: dict[str, Tensor]) -> dict[str, Tensor]:
        """All levels (rows, C) of each grid (h, w, C)."""
        return {name: self.each[name].table(values.flatten(0, 1)) for name, values in grids.items()}

    def level(self, footprint: Tensor) -> Tensor:
        """The level (n,) of footprints (n,) in texture units: log2 of texels, of those that the texture has."""
        return (footprint.float() * self.side).log2().clamp(0, self.coarsest)

    def fetch(self, tables: dict[str, Tensor], uv: Tensor, level: Tensor) -> list[Tensor]:
        """The channels (n, C) of each grid but the offset's at uv (n, 2), at its own level for those of the texture."""
        found = []
        for name, pyramid in self.each.items():
            if name != "offset":
                # A grid of half the resolution is one level coarser, so its own level is one less.
                coarser = int(math.log2(FACTORS[name]))
                own = (level - coarser).clamp(0, len(pyramid.levels) - 1)
                found.append(pyramid.fetch(tables[name], uv, own))
        return found

    def moved(self, network: Network, tables: dict[str, Tensor], uv: Tensor, wo: Tensor) -> Tensor:
        """uv (n, 2) as the offset moves it, if the network has one."""
        if network.offset is None:
            return uv
        finest = torch.zeros(len(uv), dtype=torch.long, device=uv.device)
        return network.offset.moved(uv, self.each["offset"].fetch(tables["offset"], uv, finest), wo)


def answer(
    network: Network,
    pyramids: Pyramids,
    relief: Surface | None,
    tables: dict[str, Tensor],
    queries: Queries,
    height: Tensor | None = None,
) -> Tensor:
    """Log radiance (n, 3) of queries; `height` (H, W) is that of the relief, in a fit that refines it."""
    uv, wo, wi, level = queries
    excess = None
    if relief is None:
        uv = pyramids.moved(network, tables, uv, wo)
    else:
        with torch.no_grad():
            uv, z = relief.meet(uv, wo)
            if network.shadow:
                excess = relief.excess(uv, z, wi)
        if height is not None:
            uv = relief.follow(height, uv, wo)
    return network(pyramids.fetch(tables, uv, level), level[:, None], wo, wi, excess)


class ReliefMaterial(Material):
    """The grids of a texture of `size` at their finest level, a height or none, and the network."""

    def __init__(
        self,
        network: Network,
        pyramids: Pyramids,
        size: tuple[int, int],
        grids: dict[str, Tensor],
        relief: Surface | None,
        gain: float,
    ):
        # Reads of the height: the linear search along the view, four texels a secant, the search toward the light.
        steps = geometry.VIEW_STEPS + 1 + 4 * geometry.SECANTS + (geometry.LIGHT_STEPS if network.shadow else 0)
        taps = 0 if relief is None else steps
        tables = pyramids.tables(grids)
        heights = 0 if relief is None else relief.height.numel() + relief.padded.numel()
        reads = 0
        for name, table in tables.items():
            texels = 4 if name == "offset" else 8
            reads += texels * table.shape[1]
        cost = DecoderCost(
            parameters=sum(p.numel() for p in network.parameters()),
            texture_channels=(grids["latents"].shape[2] if "latents" in grids else 0) + (relief is not None),
            texture_floats=sum(table.numel() for table in tables.values()) + heights,
            flops_per_sample=network.flops + 2 * reads + 8 * taps,
            bytes_per_sample=reads * next(iter(tables.values())).element_size() + 4 * taps,
        )
        super().__init__(size, cost)
        # The relief is separate from the network: it holds places, which stay float32 even if the network is shorter.
        self.network = network
        self.pyramids = pyramids
        self.relief = relief
        self.gain = gain
        self.names = list(tables)
        for name, table in tables.items():  # attributes, since `to` moves the tensors that are
            setattr(self, f"table_{name}", table)

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        tables = {name: getattr(self, f"table_{name}") for name in self.names}
        queries = (uv, wo, wi, self.pyramids.level(footprint))
        return to_radiance(answer(self.network, self.pyramids, self.relief, tables, queries), self.gain)


def rectified(samples: Samples, height: Tensor, pair: Tensor) -> Tensor:
    """`Samples.slices` of the surface points of a height (H, W), where each view sees them, not of the plane."""
    centres = samples.centres(torch.arange(samples.texels, device=samples.device))
    rise = height.reshape(-1, 1).to(samples.device)  # (texels, 1)
    slices = []
    for i, flat in zip(pair.tolist(), samples.slices(pair).unbind(1), strict=True):
        place = wrapped(centres - rise * slope(samples.wo[i : i + 1], samples.shape))
        slices.append(sample_texture(flat.reshape(*samples.shape, 3), place))
    return torch.stack(slices, 1)


class ReliefObjective(Objective):
    """The latents of the finest level, the network and, where there is a height, its refinement."""

    def __init__(self, levels: list[Samples], height: Tensor | None, settings: Any, fit: Fit):
        super().__init__(levels[0], settings)
        self.levels = levels
        self.fit = fit
        generator = fit.generator()
        self.network = Network(settings, height is not None, generator)
        self.network.start_at(self.samples.mean(generator))
        self.pyramids = Pyramids(settings, self.samples.shape, height is not None)
        self.first_height: Tensor | None
        self.register_buffer("first_height", height, persistent=False)
        # The shift of the found height in texels, before smoothing.
        self.offset = nn.Parameter(torch.zeros_like(height)) if height is not None and settings.refine else None
        self.relief = None if height is None else Surface(stepped(height)[2])
        self.moved = False  # whether the marched surface differs from the found one
        slices = None if height is None else partial(rectified, self.samples, height)
        first = first_latents(self.samples, total(settings), settings.start, generator, slices)
        self.grids = Grids(first, self.samples.shape, settings, offset=height is None)

    def stored_networks(self) -> list[nn.Module]:
        return [self.network]

    def groups(self) -> list[ParameterGroup]:
        """The network's groups, the grids' at `latent_rate`, and that of the height's shift if it is refined."""
        settings = self.settings
        networks = groups_of([self.network], settings.rate, settings.optimiser, settings.hidden_rate)
        refined = [] if self.offset is None else [{"params": [self.offset], "lr": HEIGHT_RATE}]
        return [*networks, {"params": list(self.grids.parameters()), "lr": settings.latent_rate}, *refined]

    @property
    def height(self) -> Tensor | None:
        """The height (H, W) as refined so far, not rounded; none without a relief."""
        if self.first_height is None or self.offset is None:
            return self.first_height
        moved = self.first_height + smoothed(self.offset) / self.samples.shape[1]
        return moved.clamp(-HIGHEST, HIGHEST)

    @torch.no_grad()
    def renew(self) -> None:
        """March the height as it is now, in the steps that the file will hold."""
        height = self.height
        if height is not None and height.isfinite().all():  # otherwise the fit diverges, and its loop handles that
            self.relief = Surface(stepped(height)[2]).to(height.device)

    def tables(self) -> dict[str, Tensor]:
        """The pyramids as they are looked up: from half of the fit on those of the file."""
        return self.pyramids.tables(self.grids.rounded())

    def predict(self, batch: Batch, progress: float) -> Tensor:
        """Log radiance (n, 3) at the finest level; at the end of a fit, on the height as the file will hold it."""
        if progress == 1 and self.offset is not None:
            self.renew()
        return answer(self.network, self.pyramids, self.relief, self.tables(), queries_of(self.levels, 0, batch))

    def loss(self, generator: torch.Generator, progress: float) -> Tensor:
        """The loss at random samples of all levels, which in the second half also moves a height that is refined."""
        queries, target, pair = drawn(self.levels, self.settings.batch, COARSE_SHARE, generator)
        height = self.height if self.offset is not None and progress >= REFINED_FROM else None
        # By the number of the step, so that a resumed fit marches the same surface. A fit that was set back to before
        # the height moved marches the found height.
        if (height is not None or self.moved) and round(progress * self.settings.steps) % RENEWED == 0:
            self.renew()
            self.moved = height is not None
        ours = answer(self.network, self.pyramids, self.relief, self.tables(), queries, height)
        return self.distance(ours, target, pair, progress)


class Relief(Codec):
    """Relief: heights found in the slices and marched, latents of few bits, directions in learned shading frames."""

    name, version = "relief", 4
    sizes = ("latents", "half", "quarter", "width")

    @dataclass(frozen=True)
    class Settings(TextureSettings, GridSettings):
        steps: Natural = 2_600  # steps of the fit
        latents: Further = 4  # channels of the neural texture at full resolution
        half: Further = 4  # further channels at half the resolution
        quarter: Further = 8  # further channels at a quarter of it
        offset: Further = 32  # without a height: hidden channels of the network that moves a look-up along the view
        bits: Annotated[int, Range(0, 8)] = 0  # bits of a stored latent on average; 0: as few as add little error
        layers: Layers = 3  # hidden layers of the network
        width: Width = 64  # channels of each hidden layer
        weights: WeightPrecision = "int8"  # precision of the stored network; eight bits are rounded in the fit, too
        relief: bool = True  # look for a height; it is written only if the slices show one
        refine: bool = True  # refine the height in the second half of the fit
        shadow: bool = True  # also march toward the light, if there is a height
        latent_rate: Positive = 1e-2  # highest learning rate of the latents
        loss: Loss = "display"  # error of log radiance: absolute, squared, or their sum; or later errors as displayed

        def __post_init__(self) -> None:
            if not total(self):
                raise InputError("codec relief needs a channel: give latents, half or quarter")

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        """Look for a height, fit latents and network on it, or without one, and store the height as bytes."""
        gain = gain_of(btf, fit)
        levels = Samples.levels(btf, fitted_levels(btf, fit, level_count(btf.shape)), gain, fit)
        swept = sweep.find(btf, gain, fit) if self.settings.relief else None
        height = swept.height if swept is not None and swept.stands else None
        fitting = ReliefObjective(levels, height, self.settings, fit)
        train(fitting, fit, self.settings.steps)
        texture = fitting.grids.stored()
        if fitting.height is not None:
            codes, extent, _ = stepped(fitting.height.detach().cpu())
            bits = max(1, int(codes.max()).bit_length())
            texture |= {"height": compress(codes[..., None], [bits]), "height.range": extent}
        other = {"gain": torch.tensor([gain]), "size": torch.tensor(btf.shape, dtype=torch.int32)}
        return Parts(store_network(fitting.network, self.settings.weights), texture, other=other)

    def decode(self, parts: Parts, device: torch.device) -> Material:
        height, width = parts.other["size"].tolist()
        surface = None
        if "height" in parts.texture:
            codes = expand(parts.texture["height"], (height, width, 1))[..., 0]
            # Larger heights, and NaN, are from an altered file, but a search through them must still end.
            surface = Surface(restored(codes, parts.texture["height.range"]).nan_to_num(0).clamp(-HIGHEST, HIGHEST))
        network = load_network(Network(self.settings, surface is not None), parts.decoder)
        pyramids = Pyramids(self.settings, (height, width), surface is not None)
        grids = load_grids(parts.texture, self.settings, (height, width), offset=surface is None)
        gain = float(parts.other["gain"])
        return ReliefMaterial(network, pyramids, (height, width), grids, surface, gain).to(device)
