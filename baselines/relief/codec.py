"""Relief: the height of the surface, found in the training slices and marched at decoding, under a neural texture.

A neural texture whose look-up does not move blurs a texel over the places where its views saw it. Here a plane sweep
first finds the height of each texel; latents then belong to surface points, and the network learns only their
reflectance. A height that fails the test on other views is not written. See docs/relief.md.

The material marches the view ray to the surface, or without a height moves the look-up by a small network; fetches
the latents there, from grids at full, half and quarter resolution; and shades. The network sees ω_o, ω_i and the half
vector h in xyz, and with a height how far the relief rises into the ray to the light.

*Samples* are the radiances that a fit learns, at texels and pairs; *queries* are the same questions as uv, directions
and level of detail. A *grid* is a texture of latents, named `latents`, `latents2`, `latents4` (full, half, quarter
resolution) or `offset`; a *pyramid* is a grid with its coarser levels, its *table* (rows, C) all their texels. To
*march* is to search where a ray meets the surface.
"""

import math
from collections.abc import Hashable
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from baselines.pyramids import Pyramid, Queries, drawn_samples, fitted_level_count, level_count, level_of, queries_of
from baselines.relief import geometry, sweep
from baselines.relief.geometry import Surface, restored, slope, smoothed, stepped, wrapped
from bench.btf import BTF
from bench.codec import Codec, Fit, Parts
from bench.inputs.errors import InputError
from bench.inputs.settings import Layers, Natural, Positive, Range, Width
from bench.machine.devices import records_graphs
from bench.material import DecoderCost, Material, sample_texture, to_radiance
from bench.training import (
    Batch,
    Loss,
    Objective,
    ParameterGroup,
    Samples,
    TextureSettings,
    better_start,
    compress,
    expand,
    gain_of,
    groups_of,
    phase_by_halves,
    train,
)
from bench.training.decoder import Architecture, Decoder
from bench.training.grids import (
    FACTORS,
    Further,
    Grids,
    GridSettings,
    Offset,
    channels,
    load_grids,
    size_of,
    total_channels,
)
from bench.training.initial_latents import first_latents
from bench.training.inputs import COUNTS, direction_inputs
from bench.training.stored_network import WeightPrecision, load_network, store_network

COARSE_ONE_IN = 8  # one of this many samples is of a coarser level
# Share of the steps of a fit after which the height moves. Earlier, latents are still misplaced, and would pull the
# height with them.
REFINED_FROM = 0.5
RENEWED_EVERY = 10  # steps between two surfaces that are marched, while the height is refined
HIGHEST = 2 * geometry.REACH  # and −HIGHEST the lowest height, in widths of the picture: what a decoder reads
HEIGHT_RATE = 0.02  # texels, the highest learning rate of the height
DEEPEST_LEVEL = 3.0  # level of detail of footprints of 8 texels, which the network sees as 1
SHADOW_SHARPNESS = 0.5  # per texel: the network sees the tanh of this times the excess


class Network(nn.Module):
    """Latents and directions (n, 3) → log radiance (n, 3); with a relief it may also shadow: see `forward`.

    Without one it has the network that moves a look-up, if the settings give that channels.
    """

    def __init__(self, settings: Any, size: tuple[int, int], relief: bool, generator: torch.Generator | None = None):
        """Make the networks of a picture of `size` (H, W), with weights drawn from the generator; `relief` says whether
        the surface has a height."""
        super().__init__()
        self.shadow: bool = relief and settings.shadow
        # Latents, the level of detail, directions and, with a shadow, how far the relief rises into the light's ray.
        inputs = total_channels(settings) + 1 + COUNTS["xyzh"] + self.shadow
        widths = (settings.width,) * settings.layers
        outputs = 6 if self.shadow else 3  # radiance in RGB, and a mask of it in RGB
        self.decoder = Decoder(Architecture(inputs, widths, outputs, activation="silu"), generator)
        has_offset = settings.offset and not relief
        # Not by the view: where no height stands, the surface is so flat that every view sees the same depth.
        self.offset = Offset(settings.offset, size, generator, by_view=False) if has_offset else None

    @property
    def flops(self) -> int:
        """Operations of one sample, a fused multiply-add counted as two."""
        offset_flops = self.offset.flops if self.offset is not None else 0
        return self.decoder.architecture.flops + offset_flops

    def start_at(self, level: Tensor) -> None:
        """Set the network to answer one log radiance (3,) for any inputs, with the mask nearly open."""
        mask_outputs = self.decoder.architecture.outputs - 3
        outputs = functional.pad(level.cpu(), (0, mask_outputs), value=2.0)  # the sigmoid of 2 is 0.88
        self.decoder.start_at(outputs)

    def forward(self, latents: list[Tensor], level: Tensor, wo: Tensor, wi: Tensor, excess: Tensor | None) -> Tensor:
        """Log radiance (n, 3) of the latents (n, C) of each grid, of which C may differ.

        `wo` and `wi` are unit vectors (n, 3), `level` (n, 1) is the level of detail. `excess` (n, 1) is how far the
        relief rises above the ray to the light, in texels; None without a relief or without its shadow. With it the
        decoder also answers a mask in [0, 1], the share of the radiance that the shadow leaves.
        """
        numbers = [level / DEEPEST_LEVEL, *direction_inputs(wo, wi, "xyzh")]  # (n, columns) each
        if excess is not None:
            numbers.append((excess * SHADOW_SHARPNESS).tanh())
        dtype = latents[0].dtype  # as that of the network; directions may be more precise
        inputs = [*latents, *(values.to(dtype) for values in numbers)]
        outputs = self.decoder(torch.cat(inputs, 1)).to(wo.dtype)
        if excess is None:  # without a mask the outputs are log radiance
            return outputs
        # The mask multiplies radiance, not its logarithm, because a shadow takes a share of the light. The limits keep
        # exponential and logarithm finite.
        radiance = outputs[:, :3].clamp(max=60).expm1()
        mask = outputs[:, 3:].sigmoid()
        return (radiance * mask).clamp_min(-0.5).log1p()


class Pyramids(nn.Module):
    """The layout of each grid and its coarser levels, by name; a file holds the finest level of each.

    The numbers themselves are in tables, which are given to its methods.
    """

    def __init__(self, settings: Any, size: tuple[int, int], relief: bool):
        """Lay out the levels of each grid over a picture of `size` (H, W); with a relief there is no offset's grid."""
        super().__init__()
        self.side = max(size)
        self.level_count = level_count(size)  # of the picture
        names = channels(settings, offset=not relief)
        self.pyramids: Any = nn.ModuleDict({name: Pyramid(size_of(name, size)) for name in names})

    def tables(self, grids: dict[str, Tensor]) -> dict[str, Tensor]:
        """The table of all levels (rows, C) of each grid (h, w, C), by the grid's name."""
        return {name: self.pyramids[name].table(values.flatten(0, 1)) for name, values in grids.items()}

    def level(self, footprint: Tensor) -> Tensor:
        """The level (n,) of the picture, a float, of footprints (n,): see `level_of`."""
        return level_of(footprint, self.side, self.level_count)

    def fetch(self, tables: dict[str, Tensor], uv: Tensor, level: Tensor) -> list[Tensor]:
        """The channels (n, C) of each grid but the offset's, at uv (n, 2) and levels (n,) of the texture."""
        channels_of_grids = []
        for name, pyramid in self.pyramids.items():
            if name != "offset":  # which the network does not see; `moved` fetches it
                # A grid of half the resolution is one level coarser, so its own level is one less.
                coarser = int(math.log2(FACTORS[name]))  # levels between the picture and this grid
                grid_level = (level - coarser).clamp(0, len(pyramid.level_sizes) - 1)
                channels_of_grids.append(pyramid.fetch(tables[name], uv, grid_level))
        return channels_of_grids

    def moved(self, network: Network, tables: dict[str, Tensor], uv: Tensor, wo: Tensor) -> Tensor:
        """uv (n, 2) as the offset moves it along the views wo (n, 3); unchanged if the network has no offset."""
        if network.offset is None:
            return uv
        finest = torch.zeros(len(uv), dtype=torch.long, device=uv.device)
        offset_channels = self.pyramids["offset"].fetch(tables["offset"], uv, finest)
        return network.offset.moved(uv, offset_channels, wo)


def answer(
    network: Network,
    pyramids: Pyramids,
    relief: Surface | None,
    tables: dict[str, Tensor],
    queries: Queries,
    height: Tensor | None = None,
) -> Tensor:
    """Log radiance (n, 3) of queries, from the `tables` of all grids.

    Without a relief the offset moves the look-up. `height` (H, W) is given in a fit that refines it: the place where a
    ray hits the relief then has a gradient to it. Otherwise it is None.
    """
    uv, wo, wi, level = queries
    excess = None  # unless there is a relief with a shadow: see `Network.forward`
    if relief is None:
        uv = pyramids.moved(network, tables, uv, wo)
    else:
        with torch.no_grad():
            uv, z = relief.meet(uv, wo)  # z (n, 1) is the height there
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
        """Count the cost of an answer term by term, and keep the parts.

        `grids` (h, w, C) are those of a file by name; `gain` is the factor of log radiance.
        """
        # Channels at full resolution: those of the latents, and the height.
        texture_channels = grids["latents"].shape[2] if "latents" in grids else 0
        heights = heights_read = 0
        if relief is not None:
            texture_channels += 1
            heights = relief.height.numel() + relief.padded.numel()  # as stored, and the finer copy
            heights_read = geometry.VIEW_STEPS + 1  # the linear search along the view
            heights_read += 4 * geometry.SECANTS  # four texels each
            if network.shadow:
                heights_read += geometry.LIGHT_STEPS  # the search toward the light
        tables = pyramids.tables(grids)
        numbers_read = 0
        for name, table in tables.items():
            texels = 4 if name == "offset" else 8  # bilinearly of one level, or of two
            numbers_read += texels * table.shape[1]
        # Each number is multiplied and added; a step of a search takes about eight operations.
        flops = network.flops + 2 * numbers_read + 8 * heights_read
        bytes_of_number = next(iter(tables.values())).element_size()  # the same in all tables
        cost = DecoderCost(
            parameters=sum(p.numel() for p in network.parameters()),
            texture_channels=texture_channels,
            texture_floats=sum(table.numel() for table in tables.values()) + heights,
            flops_per_sample=flops,
            bytes_per_sample=numbers_read * bytes_of_number + 4 * heights_read,  # heights have four bytes, as float32
        )
        super().__init__(size, cost)
        # The relief is separate from the network: it holds places, which stay float32 even if the network is in halves.
        self.network = network
        self.pyramids = pyramids
        self.relief = relief
        self.gain = gain
        self.names = list(tables)
        for name, table in tables.items():  # as attributes, because `Material.to` moves only tensors that are
            setattr(self, f"table_{name}", table)

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        """Linear radiance (n, 3) of queries, each (n, …); see `Material`."""
        tables = {name: getattr(self, f"table_{name}") for name in self.names}
        queries = (uv, wo, wi, self.pyramids.level(footprint))
        return to_radiance(answer(self.network, self.pyramids, self.relief, tables, queries), self.gain)


def rectified(samples: Samples, height: Tensor, pair: Tensor) -> Tensor:
    """The log radiance (texels, pairs, 3) of the surface points of all texels at some pairs, given as indices (pairs,).

    `Samples.slices` gives the radiance of texels of the plane. Here each slice is read where its view sees the surface
    point of a texel, at its height in `height` (H, W).
    """
    centres = samples.centres(torch.arange(samples.texels, device=samples.device))
    rise = height.reshape(-1, 1).to(samples.device)  # (texels, 1)
    surface_slices = []
    for index, plane_slice in zip(pair.tolist(), samples.slices(pair).unbind(1), strict=True):
        wo = samples.wo[index : index + 1]  # (1, 3)
        place = wrapped(centres - rise * slope(wo, samples.shape))
        surface_slices.append(sample_texture(plane_slice.reshape(*samples.shape, 3), place))
    return torch.stack(surface_slices, 1)


def in_steps(height: Tensor) -> Tensor:
    """A height (H, W), rounded to the steps that a file holds."""
    _, _, height_in_steps = stepped(height)
    return height_in_steps


class ReliefObjective(Objective):
    """What a fit changes: the latents of the finest level, the network and, where a height is refined, its shift."""

    def __init__(self, levels: list[Samples], height: Tensor | None, settings: Any, fit: Fit):
        """Start network and latents, with the generator of the fit.

        `levels` are the samples at each level of detail, the finest first; `height` (H, W) is what the sweep found,
        None without a relief.
        """
        super().__init__(levels[0], settings)
        self.levels = levels
        generator = fit.generator()
        has_height = height is not None
        self.network = Network(settings, self.samples.shape, relief=has_height, generator=generator)
        self.network.start_at(self.samples.mean(generator))  # answers the mean log radiance at first
        self.pyramids = Pyramids(settings, self.samples.shape, relief=has_height)
        self.first_height: Tensor | None  # as the sweep found it, which a fit does not change
        self.register_buffer("first_height", height, persistent=False)
        # The shift of the first height in texels, before smoothing; None if no height is refined.
        self.height_shift: nn.Parameter | None = None
        self.relief: Surface | None = None  # the surface that is marched
        # What gives the slices of some pairs, from which the first latents are made; None: `Samples.slices`.
        slices = None
        if height is not None:
            if settings.refine:
                self.height_shift = nn.Parameter(torch.zeros_like(height))
            # Where the steps of a fit are recorded, a surface that is renewed stays in the memory that they read.
            self.relief = Surface(in_steps(height), renewable=settings.refine and records_graphs(fit.device))
            slices = partial(rectified, self.samples, height)  # takes the pairs
        self.surface_moved = False  # whether the marched surface differs from the first one
        # (H · W, channels)
        latents = first_latents(self.samples, total_channels(settings), settings.start, generator, slices)
        self.grids = Grids(latents, self.samples.shape, settings, offset=not has_height)

    def moves_height(self, progress: float) -> bool:
        """Whether a step moves the height."""
        return self.height_shift is not None and progress >= REFINED_FROM

    def phase(self, progress: float) -> Hashable:
        """By halves, and by whether the height moves."""
        return phase_by_halves(progress), self.moves_height(progress)

    def prepare(self, fit: Fit, progress: float) -> None:
        """Also renew the surface while the height moves."""
        super().prepare(fit, progress)
        # By the number of the step, so that a resumed fit marches the same surface. If a fit was set back to before the
        # height moved, `surface_moved` is still set, and the first height is marched again.
        moves_height = self.moves_height(progress)
        step = round(progress * self.settings.steps)
        if (moves_height or self.surface_moved) and step % RENEWED_EVERY == 0:
            self.renew_surface()
            self.surface_moved = moves_height

    def stored_networks(self) -> list[nn.Module]:
        return [self.network]

    def groups(self) -> list[ParameterGroup]:
        """The network's groups, the grids' at `latent_rate`, and that of the height's shift if it is refined."""
        settings = self.settings
        networks = groups_of([self.network], settings.rate, settings.optimiser, settings.hidden_rate)
        groups = [*networks, {"params": list(self.grids.parameters()), "lr": settings.latent_rate}]
        if self.height_shift is not None:
            groups.append({"params": [self.height_shift], "lr": HEIGHT_RATE})
        return groups

    @property
    def height(self) -> Tensor | None:
        """The height (H, W) as refined so far, not rounded; None without a relief."""
        if self.first_height is None or self.height_shift is None:
            return self.first_height
        shift = smoothed(self.height_shift) / self.samples.shape[1]  # in widths of the picture, as the height
        return (self.first_height + shift).clamp(-HIGHEST, HIGHEST)

    @torch.no_grad()
    def renew_surface(self) -> None:
        """March the height as it is now, in the steps that the file will hold."""
        height = self.height
        # If it is not finite, the fit diverges, and its loop handles that.
        if self.relief is None or height is None or not height.isfinite().all():
            return
        if self.relief.renewable:
            self.relief.renew(in_steps(height))
        else:
            self.relief = Surface(in_steps(height))

    def tables(self) -> dict[str, Tensor]:
        """The table of each pyramid by name, of grids as they are looked up: from half of the fit on those of the
        file."""
        return self.pyramids.tables(self.grids.rounded())

    def predict(self, batch: Batch, progress: float) -> Tensor:
        """Log radiance (n, 3) at the finest level; at the end of a fit, on the height as the file will hold it."""
        if progress == 1 and self.height_shift is not None:
            self.renew_surface()
        queries = queries_of(self.levels, level=0, batch=batch)
        return answer(self.network, self.pyramids, self.relief, self.tables(), queries)

    def loss(self, generator: torch.Generator, progress: float) -> Tensor:
        """The loss at random samples of all levels, which in the second half also moves a height that is refined."""
        queries, target, pair = drawn_samples(self.levels, self.settings.batch, COARSE_ONE_IN, generator)
        height = self.height if self.moves_height(progress) else None
        ours = answer(self.network, self.pyramids, self.relief, self.tables(), queries, height)
        return self.distance(ours, target, pair, progress)


class Relief(Codec):
    """Relief: heights found in the slices and marched where they stand, latents of few bits on three grids."""

    name, version = "relief", 5
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
            """`InputError` if no grid has channels."""
            if not total_channels(self):
                raise InputError("codec relief needs a channel: give latents, half or quarter")

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        """Look for a height, fit latents and network on it, or without one, and store all as bytes.

        The texture holds the grids and, with a height, `height` (codes of as few bits as they need) and `height.range`
        (the lowest height and the step); `other` has the gain and the size (H, W).
        """
        gain = gain_of(btf, fit)
        levels = Samples.levels(btf, fitted_level_count(btf, fit, level_count(btf.shape)), gain, fit)
        swept = sweep.find(btf, gain, fit) if self.settings.relief else None
        height = swept.height if swept is not None and swept.stands else None
        make_objective = partial(ReliefObjective, levels, height, self.settings)  # takes the fit
        if height is None and self.settings.offset:  # some starts find depths that are periods apart, and stay there
            fit = better_start(make_objective, fit, self.settings.steps)
        fitting = make_objective(fit)
        train(fitting, fit, self.settings.steps)
        texture = fitting.grids.stored()
        if fitting.height is not None:
            codes, low_and_step, _ = stepped(fitting.height.detach().cpu())
            # A flat height has the code 0 alone, and takes one bit.
            bits = max(1, int(codes.max()).bit_length())
            texture |= {"height": compress(codes[..., None], [bits]), "height.range": low_and_step}
        other = {"gain": torch.tensor([gain]), "size": torch.tensor(btf.shape, dtype=torch.int32)}
        return Parts(store_network(fitting.network, self.settings.weights), texture, other=other)

    def decode(self, parts: Parts, device: torch.device) -> Material:
        """The material of a file's parts, on a device. `InputError` if the grids do not fit the size."""
        height, width = parts.other["size"].tolist()
        surface = None
        if "height" in parts.texture:  # `encode` found one
            codes = expand(parts.texture["height"], (height, width, 1))[..., 0]
            heights = restored(codes, parts.texture["height.range"])
            # Larger heights, and NaN, are from an altered file, but a search through them must still end.
            surface = Surface(heights.nan_to_num(0).clamp(-HIGHEST, HIGHEST))
        has_height = surface is not None
        network = load_network(Network(self.settings, (height, width), relief=has_height), parts.decoder)
        pyramids = Pyramids(self.settings, (height, width), relief=has_height)
        grids = load_grids(parts.texture, self.settings, (height, width), offset=not has_height)
        gain = float(parts.other["gain"])
        return ReliefMaterial(network, pyramids, (height, width), grids, surface, gain).to(device)
