"""Block-compressed features: a neural texture stored in the blocks that graphics processors decode as they fetch.

Weinreich et al., "Real-time neural materials using block-compressed features" (Eurographics 2024), learn features in
the layout of BC6 blocks, emulate their decoding in training, and decode channels of a material from them. The blocks
here are BC1's, three latents in four bits a texel, and a network like NeuBTF's answers with radiance. From halfway
through the fit ends and places between them are rounded as in the file. Further textures may lie at half and a quarter
of the resolution, as in Intel's texture set neural compression. See docs/recipes.md.

A texel has three latents for each of T *textures*. B *blocks* of 4 × 4 texels cover a texture. A block has two *ends*,
colours of three channels, and each of its texels lies on the line between them: its *share* of the way, from 0 to 1,
becomes one of four *steps*. The network answers log radiance.
"""

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from baselines import bc1
from bench.btf import BTF
from bench.codec import Codec, Fit, Parts
from bench.inputs.errors import InputError
from bench.inputs.settings import IF_SET, Layers, Width
from bench.material import Material
from bench.training import Batch, DirectedObjective, FitSettings, Samples, first_latents, fitted
from bench.training.decoder import Architecture, Decoder
from bench.training.gridded import DirectedGriddedMaterial, GriddedNetwork
from bench.training.grids import Further, on_grids, size_of
from bench.training.inputs import COUNTS, Directions
from bench.training.stored_network import load_network

CHANNELS = 3  # of a texture
OMEGA = 2.0  # frequency of the network's sine, as NeuBTF's
ROUNDED_FROM = 0.5  # share of the steps after which latents are those of real blocks
LEAST_HALF_LENGTH = 0.05  # of a block's line at the start, because ends that meet would always move together
HIGHEST_CODES = torch.tensor([2**b - 1 for b in bc1.BITS])  # the highest code of each channel of an end: 31, 63, 31


class BCF(Codec):
    """Block-compressed features: latents in BC1 blocks, half a byte for three of them, and a small network.

    @article{weinreich2024realtime,
      author = {Weinreich, Clément and de Oliveira, Louis and Houdard, Antoine and Nader, Georges},
      title = {Real-Time Neural Materials using Block-Compressed Features},
      journal = {Computer Graphics Forum},
      volume = {43},
      number = {2},
      year = {2024},
      doi = {10.1111/cgf.15013}
    }
    """

    name, version = "bcf", 3
    sizes = ("textures", "width")

    @dataclass(frozen=True)
    class Settings(FitSettings):
        textures: Width = 8  # of BC1 blocks, three latents each
        half: Further = field(default=0, metadata=IF_SET)  # further textures at half the resolution
        quarter: Further = field(default=0, metadata=IF_SET)  # further textures at a quarter of it
        offset: Further = field(default=0, metadata=IF_SET)  # hidden channels of what moves a look-up along the view
        directions: Directions = "xyzh"  # inputs: x and y of both, or all of both and of their half vector
        layers: Layers = 3  # hidden layers of the network
        width: Width = 32  # channels of each hidden layer

        @property
        def channels(self) -> dict[str, int]:
            """The number of latents of each grid of textures that there is: see `bench.training.grids`."""
            textures = {"latents": self.textures, "latents2": self.half, "latents4": self.quarter}
            if self.offset:
                textures["offset"] = 1
            return {grid: CHANNELS * count for grid, count in textures.items() if count}

        @property
        def latents(self) -> int:
            """The latents that the network sees of all grids."""
            return CHANNELS * (self.textures + self.half + self.quarter)

        @property
        def architecture(self) -> Architecture:
            """The network that reads the latents of all textures and the directions."""
            inputs = self.latents + COUNTS[self.directions]
            widths = (self.width,) * self.layers
            return Architecture(inputs, widths, activation="sine", omega=OMEGA, norm=True, residual=True)

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        """Fit blocks and network to the training pairs; returns the parts of the file."""
        fitting = fitted(BCFObjective, self.settings, btf, fit)
        textures: dict[str, Tensor] = {}
        for grid, texture in fitting.textures.items():
            stored_blocks = texture.stored()
            textures |= {f"{grid}.{name}": tensor for name, tensor in stored_blocks._asdict().items()}
        return fitting.parts(textures, size=torch.tensor(btf.shape, dtype=torch.int32))

    def decode(self, parts: Parts, device: torch.device) -> Material:
        """The material of a file's parts, on a device. `InputError` if there are too few or too many blocks."""
        settings = self.settings
        height, width = parts.other["size"].tolist()
        grids = {}
        for grid, channels in settings.channels.items():
            blocks, low, span = (parts.texture[f"{grid}.{name}"] for name in StoredBlocks._fields)
            size = size_of(grid, (height, width))
            expected_bytes = math.prod(blocks_across(size)) * channels // CHANNELS * bc1.BYTES
            if min(size) < 1 or blocks.shape != (expected_bytes,):
                raise InputError(f"its blocks do not fit {height} × {width} texels: encode it again")
            colours = colours_of_blocks(blocks.view(-1, channels // CHANNELS, bc1.BYTES), size)  # (h, w, T, 3)
            grids[grid] = low.float() + span.float() * (colours.flatten(2) / 255)  # (h, w, 3 · T), from eight bits
        network = GriddedNetwork(Decoder(settings.architecture), settings, (height, width), offset_channels=CHANNELS)
        load_network(network, parts.decoder)
        flops, gain = settings.architecture.flops, float(parts.other["gain"])
        return DirectedGriddedMaterial(network, grids, flops, gain, settings.directions).to(device)


def blocks_across(size: tuple[int, ...]) -> tuple[int, int]:
    """The numbers of rows and columns of blocks that cover a picture (H, W): its sides over 4, rounded up."""
    return math.ceil(size[0] / bc1.SIDE), math.ceil(size[1] / bc1.SIDE)


def texels_of_blocks(size: tuple[int, int]) -> Tensor:
    """The texel (B, 16) of each of the 16 places in each of B blocks of a picture (H, W), as row · W + column.

    Blocks and the places in them go row by row. Beyond its borders the picture repeats.
    """
    rows, cols = blocks_across(size)
    # Rows and columns that whole blocks cover; those beyond the border are the first ones again.
    row = torch.arange(rows * bc1.SIDE) % size[0]
    col = torch.arange(cols * bc1.SIDE) % size[1]
    texel = row[:, None] * size[1] + col  # (rows · 4, columns · 4)
    blocks = texel.unflatten(1, (-1, bc1.SIDE)).unflatten(0, (-1, bc1.SIDE))  # (rows, 4, columns, 4)
    return blocks.transpose(1, 2).flatten(2).flatten(0, 1)  # (rows, columns, 16), then (B, 16)


def colours_of_blocks(blocks: Tensor, size: tuple[int, ...]) -> Tensor:
    """The colours (H, W, T, 3), 0 … 255, of blocks (B, T, 8), bytes, that cover a picture of `size` (H, W)."""
    rows, cols = blocks_across(size)
    colours = bc1.read(blocks.flatten(0, 1))  # (B · T, 16, 3)
    by_place = colours.unflatten(0, (rows, cols, -1)).unflatten(3, (bc1.SIDE, bc1.SIDE))  # (rows, columns, T, 4, 4, 3)
    by_row = by_place.permute(0, 3, 1, 4, 2, 5)  # (rows, 4, columns, 4, T, 3)
    picture = by_row.flatten(2, 3).flatten(0, 1)  # (rows · 4, columns · 4, T, 3)
    return picture[: size[0], : size[1]]


class StoredBlocks(NamedTuple):
    """The fitted blocks of a grid as the file holds them."""

    blocks: Tensor  # (B · T · 8,), uint8
    low: Tensor  # (3 · T,), the latent of each channel that is stored as 0
    span: Tensor  # (3 · T,), the highest latent, stored as the highest code, less `low`


class BlockTexture(nn.Module):
    """T textures of a grid (h, w): the ends (2, B, T, 3) of each block's lines and each texel's share (h · w, T) of the
    way, all of them fitted."""

    def __init__(self, first: Tensor):
        """Start at lines through the first latents (h, w, 3 · T) of the blocks' texels."""
        super().__init__()
        self.size = first.shape[0], first.shape[1]
        block_texels = texels_of_blocks(self.size)  # (B, 16)
        # (texels, 3, T): channel c of texture t is the latent c · T + t.
        latents = first.flatten(0, 1).unflatten(1, (CHANNELS, -1))
        ends, shares = lines(latents.mT[block_texels])  # of latents (B, 16, T, 3)
        self.ends = nn.Parameter(ends)
        count, textures = latents.shape[0], latents.shape[2]
        block = torch.empty(count, dtype=torch.long)  # of each texel
        share = torch.empty(count, textures)  # of each texel on the lines of that block
        # A texel that repeats beyond the border is in several blocks. Blocks are gone through backwards, and each
        # overwrites the one before, so that the first of several stays.
        texels = block_texels.flatten().flip(0)  # (B · 16,)
        places = torch.arange(block_texels.numel()).flip(0)  # the place of each of these texels in `block_texels`
        block[texels] = places // block_texels.shape[1]
        share[texels] = shares.flatten(0, 1)[places]
        self.share = nn.Parameter(share)
        self.block = nn.Buffer(block, persistent=False)  # (texels,)
        self.block_texels = nn.Buffer(block_texels, persistent=False)  # (B, 16)
        self.highest_codes = nn.Buffer(HIGHEST_CODES, persistent=False)  # (3,)
        # The range of each channel's codes; a span of 0 means that there are none yet.
        self.low = nn.Buffer(torch.zeros(textures, CHANNELS))
        self.span = nn.Buffer(torch.zeros(textures, CHANNELS))
        # Whether the range is set: kept on the host, which else would wait for a GPU at each step.
        self.has_range = False

    def forward(self, as_stored: bool) -> Tensor:
        """The latents (h, w, 3 · T): on the lines of their blocks, or with `as_stored` as the file gives them back.

        The gradient ignores the rounding. Clamps the fitted shares to 0 and 1 in place.
        """
        with torch.no_grad():
            self.share.clamp_(0, 1)
        first, second = self.ends.index_select(1, self.block)  # (texels, T, 3) each
        latents = first + self.share[..., None] * (second - first)
        if as_stored:
            with torch.no_grad():  # so that the gradient passes as if nothing were rounded
                change_by_rounding = self.rounded(first, second) - latents
            latents = latents + change_by_rounding
        return latents.view(*self.size, -1)

    def codes(self, ends: Tensor) -> Tensor:
        """The codes of ends (…, T, 3) in 5, 6 and 5 bits, int64.

        The first call sets the range that the codes span, that of all ends then; later ends beyond it are clamped.
        """
        if not self.has_range:
            low, high = torch.aminmax(self.ends.flatten(0, 1), dim=0)
            self.low.copy_(low)
            self.span.copy_((high - low).clamp_min(1e-6))
            self.has_range = True
        codes = ((ends - self.low) / self.span * self.highest_codes).round()
        return codes.clamp_min(0).minimum(self.highest_codes).long()

    def rounded(self, first: Tensor, second: Tensor) -> Tensor:
        """The latents (texels, T, 3) that a file gives back for the fitted shares between ends (texels, T, 3)."""
        first_colour = bc1.widened(self.codes(first))
        second_colour = bc1.widened(self.codes(second))
        colour = bc1.between(first_colour, second_colour, (3 * self.share).round().long())  # four steps, 0 … 3
        return self.low + self.span * (colour / 255)

    @torch.no_grad()
    def stored(self) -> StoredBlocks:
        """The blocks and the channels' ranges for the file."""
        latents = self(as_stored=True).flatten(0, 1).unflatten(1, (-1, CHANNELS))  # (texels, T, 3)
        # The steps are found anew from the latents: a texel that a block repeats from beyond the border was fitted on
        # the line of another block.
        ends = self.codes(self.ends)  # (2, B, T, 3)
        start, end = (self.low + self.span * (bc1.widened(codes) / 255) for codes in ends)  # (B, T, 3)
        line = (end - start)[:, None]  # (B, 1, T, 3)
        from_start = latents[self.block_texels] - start[:, None]  # (B, 16, T, 3)
        # The share of the line at which a texel's projection lies; a line may have no length.
        share = (from_start * line).sum(3) / line.square().sum(3).clamp_min(1e-12)  # (B, 16, T)
        steps = (3 * share).round().clamp(0, 3).long().transpose(1, 2).flatten(0, 1)  # (B · T, 16)
        ends_of_block = ends.movedim(0, 2).flatten(0, 1)  # (B · T, 2, 3)
        blocks = bc1.write(ends_of_block.cpu(), steps.cpu())
        return StoredBlocks(blocks.flatten(), self.low.flatten().cpu(), self.span.flatten().cpu())


class BCFObjective(DirectedObjective):
    """The textures of each grid and the network, all of them fitted."""

    def __init__(self, samples: Samples, settings: BCF.Settings, generator: torch.Generator):
        """Start the blocks at lines through the first latents of their texels; the network's weights are the first
        numbers of the generator."""
        super().__init__(samples, settings, generator)
        shape = samples.shape
        self.network: Any = GriddedNetwork(self.network, settings, shape, generator, offset_channels=CHANNELS)
        latents = first_latents(samples, settings.latents, settings.start, generator)
        grids = on_grids(latents, shape, settings.channels)
        self.textures: Any = nn.ModuleDict({grid: BlockTexture(first) for grid, first in grids.items()})

    def restored(self) -> None:
        """Set `has_range` again, once the tensors came from a state."""
        super().restored()
        for texture in self.textures.values():
            texture.has_range = bool(texture.span.any())

    def predict(self, batch: Batch, progress: float) -> Tensor:
        """Log radiance (n, 3). From halfway through the fit on the network sees the latents that the file will give."""
        as_stored = progress >= ROUNDED_FROM
        grids = {grid: texture(as_stored) for grid, texture in self.textures.items()}
        return self.answers(self.network.fetch_batch(grids, self.samples, batch), batch.pair)


def lines(latents: Tensor) -> tuple[Tensor, Tensor]:
    """The line of each block along the principal axis of its latents (B, 16, T, 3), of 16 texels in T textures.

    Returns the lines' ends (2, B, T, 3), and at which share of the way from the first to the second end each texel's
    projection lies, (B, 16, T).
    """
    middle = latents.mean(1, keepdim=True)  # (B, 1, T, 3)
    centred = latents - middle
    scatter = torch.einsum("bptc,bptd->btcd", centred, centred)  # (B, T, 3, 3)
    _, eigenvectors = torch.linalg.eigh(scatter)
    axis = eigenvectors[..., -1]  # (B, T, 3); the last has the largest eigenvalue
    along = torch.einsum("bptc,btc->bpt", centred, axis)  # (B, 16, T)
    # The ends' distances (B, T) from the middle.
    low = along.amin(1).clamp(max=-LEAST_HALF_LENGTH)
    high = along.amax(1).clamp_min(LEAST_HALF_LENGTH)
    ends = torch.stack([middle[:, 0] + end[..., None] * axis for end in (low, high)])
    shares = (along - low[:, None]) / (high - low)[:, None]
    return ends, shares
