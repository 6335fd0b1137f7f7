"""Block-compressed features: a neural texture stored in the blocks that graphics processors decode as they fetch.

Weinreich et al., "Real-time neural materials using block-compressed features" (Eurographics 2024), learn features in
the layout of BC6 blocks, emulate their decoding in training, and decode channels of a material from them. The blocks
here are BC1's, three latents in four bits a texel, and a network like NeuBTF's answers with radiance. From halfway
through the fit ends and places between them are rounded as in the file. See docs/recipes.md.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from baselines import bc1
from bench.btf import BTF
from bench.codec import Codec, Fit, Parts
from bench.inputs.errors import InputError
from bench.inputs.settings import Layers, Width
from bench.material import Material
from bench.training import Batch, DirectedObjective, FitSettings, Samples, TextureMaterial, first_latents, fitted
from bench.training.decoder import Architecture, Decoder
from bench.training.inputs import COUNTS, Directions
from bench.training.stored_network import load_network

OMEGA = 2.0  # frequency of the network's sine, as NeuBTF's
ROUNDED_FROM = 0.5  # share of the steps after which latents are those of real blocks
LEAST = 0.05  # least half length of a block's line at the start, because ends that meet would always move together
LEVELS = torch.tensor([2**b - 1 for b in bc1.BITS])


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

    name, version = "bcf", 2
    sizes = ("textures", "width")

    @dataclass(frozen=True)
    class Settings(FitSettings):
        textures: Width = 8  # of BC1 blocks, three latents each
        directions: Directions = "xyzh"  # inputs: x and y of both, or all of both and of their half vector
        layers: Layers = 3  # hidden layers of the network
        width: Width = 32  # channels of each hidden layer

        @property
        def architecture(self) -> Architecture:
            inputs = 3 * self.textures + COUNTS[self.directions]
            widths = (self.width,) * self.layers
            return Architecture(inputs, widths, activation="sine", omega=OMEGA, norm=True, residual=True)

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        fitting = fitted(BCFObjective, self.settings, btf, fit)
        blocks, low, span = fitting.blocks()
        texture = {"blocks": blocks.flatten(), "low": low, "span": span}
        return fitting.parts(texture, size=torch.tensor(btf.shape, dtype=torch.int32))

    def decode(self, parts: Parts, device: torch.device) -> Material:
        network = load_network(Decoder(self.settings.architecture), parts.decoder)
        size = tuple(parts.other["size"].tolist())
        textures = self.settings.textures
        low, span = parts.texture["low"].float(), parts.texture["span"].float()
        if min(size) < 1 or parts.texture["blocks"].shape != (math.prod(across(size)) * textures * bc1.BYTES,):
            raise InputError(f"its blocks do not fit {size[0]} × {size[1]} texels: encode it again")
        codes = decoded(parts.texture["blocks"].view(-1, textures, bc1.BYTES), size)  # (H, W, T, 3)
        texture = low + span * (codes.flatten(2) / 255)  # (H, W, 3 · T)
        return TextureMaterial(network, texture, float(parts.other["gain"]), self.settings.directions).to(device)


def across(size: tuple[int, ...]) -> tuple[int, int]:
    """The numbers of rows and columns of blocks that cover a picture (H, W): its sides over 4, rounded up."""
    return -(-size[0] // bc1.SIDE), -(-size[1] // bc1.SIDE)


def members(size: tuple[int, int]) -> Tensor:
    """The texel (B, 16) of each place in each block of a picture (H, W), which repeats beyond its borders."""
    # Rows and columns that whole blocks cover; those beyond the border are the first ones again.
    row, col = (torch.arange(count * bc1.SIDE) % side for count, side in zip(across(size), size, strict=True))
    texel = row[:, None] * size[1] + col  # (rows · 4, columns · 4)
    blocks = texel.unflatten(1, (-1, bc1.SIDE)).unflatten(0, (-1, bc1.SIDE))  # (rows, 4, columns, 4)
    return blocks.transpose(1, 2).flatten(2).flatten(0, 1)  # (rows, columns, 16), then (B, 16)


def decoded(blocks: Tensor, size: tuple[int, ...]) -> Tensor:
    """The codes (H, W, T, 3), 0 … 255, of blocks (B, T, 8) that cover a picture (H, W)."""
    rows, cols = across(size)
    colours = bc1.read(blocks.flatten(0, 1))  # (B · T, 16, 3)
    by_place = colours.unflatten(0, (rows, cols, -1)).unflatten(3, (bc1.SIDE, bc1.SIDE))  # (rows, columns, T, 4, 4, 3)
    # (rows, 4, columns, 4, T, 3), then (rows · 4, columns · 4, T, 3).
    picture = by_place.permute(0, 3, 1, 4, 2, 5).flatten(2, 3).flatten(0, 1)
    return picture[: size[0], : size[1]]


class BCFObjective(DirectedObjective):
    """The ends (2, B, T, 3) of each block's lines, each texel's share (H · W, T) of the way, and the network."""

    def __init__(self, samples: Samples, settings: BCF.Settings, generator: torch.Generator):
        super().__init__(samples, settings, generator)
        within = members(samples.shape)
        latents = first_latents(samples, 3 * settings.textures, settings.start, generator).unflatten(1, (3, -1))
        ends, shares = lines(latents.mT[within])  # of latents (B, 16, T, 3)
        self.ends = nn.Parameter(ends)
        block = torch.empty(samples.texels, dtype=torch.long)
        share = torch.empty(samples.texels, settings.textures)
        # The block of each texel, and its share there. Backwards: a texel that several blocks hold is set by each in
        # turn, so the first block stays.
        places = within.flatten().flip(0)  # (B · 16,)
        order = torch.arange(within.numel()).flip(0)
        block[places] = order // within.shape[1]
        share[places] = shares.flatten(0, 1)[order]
        self.share = nn.Parameter(share)
        self.block, self.within, self.levels = (nn.Buffer(x, persistent=False) for x in (block, within, LEVELS))
        # The range of each channel's codes; a span of 0 means that there are none yet.
        self.low, self.span = (nn.Buffer(torch.zeros(settings.textures, 3)) for _ in range(2))
        self.ranged = False  # whether the range is set: kept on the host, which else would wait for a GPU at each step

    def restored(self) -> None:
        super().restored()
        self.ranged = bool(self.span.any())

    def predict(self, batch: Batch, progress: float) -> Tensor:
        """The network sees latents on the lines of their blocks; later rounded ones, whose gradients ignore this."""
        with torch.no_grad():
            self.share.clamp_(0, 1)
        first, second = self.ends[:, self.block[batch.texel]]  # (n, T, 3) each
        share = self.share.index_select(0, batch.texel)  # (n, T)
        latents = first + share[..., None] * (second - first)
        if progress >= ROUNDED_FROM:
            with torch.no_grad():
                change = self.rounded(first, second, share) - latents
            latents = latents + change
        return self.answers(latents.flatten(1), batch.pair)

    def codes(self, ends: Tensor) -> Tensor:
        """Ends (…, T, 3) in 5, 6 and 5 bits, int64; the first call sets their range."""
        if not self.ranged:
            low, high = torch.aminmax(self.ends.flatten(0, 1), dim=0)
            self.low.copy_(low)
            self.span.copy_((high - low).clamp_min(1e-6))
            self.ranged = True
        return ((ends - self.low) / self.span * self.levels).round().clamp_min(0).minimum(self.levels).long()

    def rounded(self, first: Tensor, second: Tensor, share: Tensor) -> Tensor:
        """The latents (n, T, 3) that a file gives back for texels with those ends (n, T, 3) and shares (n, T)."""
        a, b = (bc1.widened(self.codes(end)) for end in (first, second))
        return self.low + self.span * (bc1.between(a, b, (3 * share).round().long()) / 255)

    @torch.no_grad()
    def blocks(self) -> tuple[Tensor, Tensor, Tensor]:
        """The blocks (B · T, 8) of the file, and the lowest value and the range (3 · T,) of its channels."""
        self.share.clamp_(0, 1)
        first, second = self.ends
        latents = self.rounded(first[self.block], second[self.block], self.share)
        # The steps anew: a texel that a block repeats from beyond the border was fitted on the line of another block.
        ends = self.codes(self.ends)
        a, b = (self.low + self.span * (bc1.widened(end) / 255) for end in ends)  # (B, T, 3)
        along = (b - a)[:, None]  # (B, 1, T, 3)
        wanted = latents[self.within] - a[:, None]  # (B, 16, T, 3)
        share = (wanted * along).sum(3) / along.square().sum(3).clamp_min(1e-12)
        steps = (3 * share).round().clamp(0, 3).long().transpose(1, 2).flatten(0, 1)  # (B · T, 16)
        blocks = bc1.write(ends.movedim(0, 2).flatten(0, 1).cpu(), steps.cpu())  # of ends (B · T, 2, 3)
        return blocks, self.low.flatten().cpu(), self.span.flatten().cpu()


def lines(latents: Tensor) -> tuple[Tensor, Tensor]:
    """The ends (2, B, T, 3) of the principal axis of each block's latents (B, 16, T, 3), and the shares (B, 16, T)."""
    middle = latents.mean(1, keepdim=True)  # (B, 1, T, 3)
    apart = latents - middle
    # The last eigenvector has the largest eigenvalue.
    axis = torch.linalg.eigh(torch.einsum("bptc,bptd->btcd", apart, apart))[1][..., -1]  # (B, T, 3)
    along = torch.einsum("bptc,btc->bpt", apart, axis)  # (B, 16, T)
    low, high = along.amin(1).clamp(max=-LEAST), along.amax(1).clamp_min(LEAST)  # (B, T)
    ends = torch.stack([middle[:, 0] + end[..., None] * axis for end in (low, high)])
    return ends, (along - low[:, None]) / (high - low)[:, None]
