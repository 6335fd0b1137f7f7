"""Biplane (Fan 2023): a plane of features over half vectors, one over texels, and a decoder for all materials.

The decoder is trained once (`neubtf-bench pretrain biplane`) and kept in its own file. A material is its two planes and
for each texel a matrix and an offset that colour the decoder's answer; they are fitted while the decoder stays. Facts
are from the authors' code; here the answer is log radiance, not radiance up to 1. See docs/recipes.md.

*Features* are the numbers that a point of a plane gives the decoder. A texel's *colours* are its matrix and its offset,
12 numbers. From half of the fit on, planes are looked up *rounded*, as the file stores them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from baselines.planes import Difference, blurred, blurring, half_and_difference, places
from bench.btf import BTF
from bench.codec import Codec, Fit, Parts, SharedNetwork
from bench.inputs.settings import BatchSize, Count, Natural, NotNegative, Positive
from bench.material import HALF_MAX, DecoderCost, Material, sample_texture, saturated, texel_corners, to_radiance
from bench.training import (
    RANDOM_SPREAD,
    Batch,
    LogLoss,
    ParameterGroup,
    Samples,
    TextureObjective,
    distance,
    gain_of,
    train,
)
from bench.training.decoder import LEAK
from bench.training.stored_network import WeightPrecision, load_network, store_network
from bench.training.stored_texture import Bits, Rounding, load_texture, store_texture

FEATURES = 6  # of each plane
MATRIX, COLOURS = 9, 12  # numbers of a texel's matrix, and of matrix and offset
WIDTHS = (2 + 2 * FEATURES, 256, 128, 256, 128, 256, 3)  # numbers between the decoder's layers
SIDE = 20  # texels of the plane over half vectors
PAIRS = 400  # pairs of each training material
BLOCK = 256  # texels read at once
CHECKED_PAIRS = 64  # pairs of a material at which the decoder's answers are compared with the mean of each texel


@dataclass(frozen=True)
class PlaneSettings:
    """The settings of a fit of planes, with or without the decoder."""

    steps: Natural = 1_000  # steps of the fit
    batch: BatchSize = 2_048  # samples a step
    difference: Difference = "nearest"  # turn to the half vector: about z, then y as published, or the shortest way
    blur: NotNegative = 2.0  # σ in texels of the plane over half vectors
    plane_rate: Positive = 2e-2  # highest learning rate of planes, matrices and offsets
    loss: LogLoss = "both"  # error of log radiance: absolute, squared, or their sum


class BiplaneNetwork(SharedNetwork):
    """The decoder of all materials."""

    name, version = "biplane", 1
    shipped = Path(__file__).parent / "networks/biplane.nbtf"

    @dataclass(frozen=True)
    class Settings(PlaneSettings):
        steps: Natural = 10_000  # steps of the training
        kept: Count = 128  # training texels of each material
        rate: Positive = 2e-3  # highest learning rate of the decoder
        weights: WeightPrecision = "half"  # precision of the stored decoder

    def train(self, btfs: Sequence[BTF], fit: Fit) -> Parts:
        """Train the decoder for all materials on texels of each BTF; returns the parts of its file.

        The planes and colours of the training materials are fitted beside it, and dropped.
        """
        pool = Pool(btfs, self.settings.kept, fit)
        decoder = BiplaneDecoder(fit.generator())
        train(BiplaneObjective(pool, decoder, self.settings, fit.generator()), fit, self.settings.steps)
        return Parts(decoder=store_network(decoder, self.settings.weights))


class Biplane(Codec):
    """Biplane: planes over half vectors and over texels, and one wide decoder for all materials, in its own file.

    Code: https://github.com/sssssy/Biplane_release

    @inproceedings{fan2023neural,
      author = {Fan, Jiahui and Wang, Beibei and Hašan, Miloš and Yang, Jian and Yan, Ling-Qi},
      title = {Neural Biplane Representation for {BTF} Rendering and Acquisition},
      booktitle = {SIGGRAPH '23 Conference Proceedings},
      year = {2023},
      doi = {10.1145/3588432.3591505}
    }
    """

    name, version = "biplane", 3
    network = BiplaneNetwork

    @dataclass(frozen=True)
    class Settings(PlaneSettings):
        bits: Bits = 0  # bits of a stored number of all planes on average; 0: chosen by the fit; 16, 32: floats

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        """Fit planes and colours under the shared decoder, which stays.

        The file's part `decoder` is the plane over half vectors.
        """
        network = fit.shared(self.name)
        gain = gain_of(btf, fit)
        decoder = load_network(BiplaneDecoder(), network.parts.decoder).requires_grad_(False)
        fitting = BiplaneObjective(Samples(btf, gain, fit), decoder, self.settings, fit.generator())
        train(fitting, fit, self.settings.steps)
        texture = fitting.stored_texture().reshape(*btf.shape, -1)
        return Parts(
            decoder=store_texture("half", fitting.planes()[0], fitting.rounded_planes),  # of the only material
            texture=store_texture("texels", texture, fitting.rounded_texels),
            other={"gain": torch.tensor([gain])},
            network=network,
        )

    def decode(self, parts: Parts, device: torch.device) -> Material:
        """The material of a file's parts and of the shared network, on a device. `ValueError` if they do not fit each
        other."""
        if parts.network is None:
            raise ValueError("it names no shared network")
        decoder = load_network(BiplaneDecoder(), parts.network.parts.decoder)
        texture = load_texture("texels", parts.texture)
        half = load_texture("half", parts.decoder)
        if texture.shape[2] != FEATURES + COLOURS or half.shape[2] != FEATURES:
            raise ValueError(f"planes of {half.shape[2]} and {texture.shape[2]} channels")
        return BiplaneMaterial(decoder, texture, half, float(parts.other["gain"]), self.settings.difference).to(device)


class BiplaneDecoder(nn.Module):
    """Numbers (n, 14) → (n, 3) from 0 to 1: 14 → 256, two residual blocks 256 → 128 → 256, 256 → 3 and a sigmoid."""

    def __init__(self, generator: torch.Generator | None = None):
        """Draw weights and biases within 1 / √inputs, as PyTorch's linear layers do, but from the generator."""
        super().__init__()
        layers = [nn.Linear(inputs, outputs) for inputs, outputs in pairwise(WIDTHS)]
        for layer in layers:
            bound = layer.in_features**-0.5
            nn.init.uniform_(layer.weight, -bound, bound, generator)
            nn.init.uniform_(layer.bias, -bound, bound, generator)
        self.layers = nn.ModuleList(layers)

    @property
    def flops(self) -> int:
        """Operations of one sample, a fused multiply-add counted as two."""
        matrices = sum(2 * inputs * outputs for inputs, outputs in pairwise(WIDTHS))
        biases = sum(WIDTHS[1:])
        residuals = 2 * 256  # two sums of 256 channels
        return matrices + biases + residuals

    def forward(self, inputs: Tensor) -> Tensor:
        """Answers (n, 3) from 0 to 1 to numbers (n, 14): x, y of the difference vector, then both planes' features."""
        first, *inner, last = self.layers
        dtype = next(self.parameters()).dtype  # weights may be halves
        x = _leaky(first(inputs.to(dtype)))
        # A residual block is two layers, 256 → 128 → 256, whose answer is added to its input.
        for narrow, wide in zip(inner[::2], inner[1::2], strict=True):
            x = _leaky(x + wide(_leaky(narrow(x))))
        return last(x).to(inputs.dtype).sigmoid()


def _leaky(x: Tensor) -> Tensor:
    """Leaky ReLU, within the range of halves, so later layers stay finite in any precision."""
    return functional.leaky_relu(x, LEAK).clamp(-HALF_MAX, HALF_MAX)


def coloured(answer: Tensor, colours: Tensor) -> Tensor:
    """Log radiance (n, 3): the decoder's answers (n, 3) times a matrix, plus an offset.

    `colours` (n, 12) holds both for each sample: the matrix's nine numbers, row by row, then the offset's three. The
    matrix has a row for each of the three answers, and a column for each colour.
    """
    matrix, offset = colours.tensor_split([MATRIX], dim=1)
    return (answer[:, :, None] * matrix.unflatten(1, (3, 3))).sum(1) + offset


class Pool(Samples):
    """Some texels of each of many BTFs, each with its log radiance at `PAIRS` pairs of its BTF.

    The BTFs of `fit.unseen`, to which the decoder is not fitted, come last: texels from `trained_texels` on are theirs.
    Texel t is of the material number `material[t]`. `wo` and `wi` have `PAIRS` rows for each material, one after the
    other.
    """

    def __init__(self, btfs: Sequence[BTF], most_texels: int, fit: Fit):
        """Read at most `most_texels` random texels of each BTF, and of each of `fit.unseen`, for the fit's curve."""
        # `Samples.__init__` would read one BTF. This holds parts of several, in the same attributes.
        generator = fit.generator()
        abrdfs: list[Tensor] = []
        wo: list[Tensor] = []
        wi: list[Tensor] = []
        material: list[int] = []  # of each texel
        # Of each BTF some texels at some pairs, both drawn at random, and log radiance by the gain of the BTF.
        for number, btf in enumerate(fit.progress([*btfs, *fit.unseen], "materials")):
            texel = torch.randperm(btf.shape[0] * btf.shape[1], generator=generator)[:most_texels].to(fit.device)
            order = torch.randperm(len(btf), generator=generator)
            pair = order[torch.arange(PAIRS) % len(btf)]  # (PAIRS,), repeated in turns if the BTF has fewer
            gain = gain_of(btf.subset(btf.split().train), fit)  # as when the material itself is encoded
            samples = Samples(btf, gain, fit)
            abrdfs += [samples.abrdfs(block)[:, pair].half() for block in texel.split(BLOCK)]
            wo.append(samples.wo[pair])
            wi.append(samples.wi[pair])
            material += [number] * len(texel)
        self.device = fit.device
        self.table = torch.cat(abrdfs)  # (texels, PAIRS, 3)
        self.texels = len(material)
        self.pairs = PAIRS
        self.material = torch.tensor(material, device=fit.device)
        self.trained_texels = int((self.material < len(btfs)).sum())
        self.wo, self.wi = torch.cat(wo), torch.cat(wi)


class BiplaneObjective(TextureObjective):
    """Planes, matrices and offsets of one material or of a pool, and the decoder if it is fitted."""

    def __init__(self, samples: Samples, decoder: BiplaneDecoder, settings: Any, generator: torch.Generator):
        """Start both planes at small random features, and the colours so that each texel answers its mean.

        `samples` are a `Pool`, to train the decoder, or those of one material, under a decoder without gradients.
        `settings` are those of `BiplaneNetwork` or of `Biplane`.
        """
        super().__init__(samples, settings)
        self.network = decoder
        material = samples.material if isinstance(samples, Pool) else torch.zeros(samples.texels, dtype=torch.long)
        count = int(material.max()) + 1  # materials
        self.texture = nn.Parameter(RANDOM_SPREAD * torch.randn(samples.texels, FEATURES, generator=generator))
        # The planes over half vectors as they are fitted, before the blur.
        first_planes = RANDOM_SPREAD * torch.randn(count, SIDE, SIDE, FEATURES, generator=generator)
        self.half_planes = nn.Parameter(first_planes)
        # A first decoder answers about 1/2 three times, of which a matrix of thirds makes 1/2 in each colour. With
        # mean − 1/2 as offset each texel starts at its mean.
        colours = torch.full((samples.texels, COLOURS), 1 / 3)
        blocks = torch.arange(samples.texels, device=samples.device).split(BLOCK)
        means = torch.cat([samples.abrdfs(block).mean(1) for block in blocks]).cpu()  # (texels, 3)
        colours[:, MATRIX:] = means - 0.5
        self.colours = nn.Parameter(colours)
        bits = getattr(settings, "bits", 32)  # a pool has no such setting: nothing of it is stored
        self.rounded_texels = Rounding(FEATURES + COLOURS, bits)
        self.rounded_planes = Rounding(FEATURES, bits)
        h, d = half_and_difference(samples.wo, samples.wi, settings.difference)
        corner, weight = texel_corners((SIDE, SIDE), places(h, SIDE))
        self.material = nn.Buffer(material, persistent=False)  # (texels,), the number of each texel's material
        self.corner = nn.Buffer(corner, persistent=False)  # (pairs, 4), texels of the plane around a half vector
        self.weight = nn.Buffer(weight, persistent=False)  # (pairs, 4)
        self.d = nn.Buffer(d[:, :2], persistent=False)  # (pairs, 2), x and y of the difference vector
        self.kernel = nn.Buffer(blurring(SIDE, settings.blur), persistent=False)

    def stored_networks(self) -> list[nn.Module]:
        """The decoder, while it is trained for all materials."""
        fitted = any(p.requires_grad for p in self.network.parameters())
        return [self.network] if fitted else []  # the file of one material holds no network

    def groups(self) -> list[ParameterGroup]:
        """The planes and colours at `plane_rate`, then the decoder at `rate`, unless it is fixed."""
        groups = [{"params": [self.texture, self.half_planes, self.colours], "lr": self.settings.plane_rate}]
        decoder = [p for p in self.network.parameters() if p.requires_grad]
        if decoder:
            groups.append({"params": decoder, "lr": self.settings.rate})
        return groups

    def planes(self) -> Tensor:
        """The planes (materials, SIDE, SIDE, 6) over half vectors, blurred."""
        return blurred(self.half_planes, self.kernel)

    def loss(self, generator: torch.Generator, progress: float) -> Tensor:
        """The loss of one step, plus that of an equal share of the texels that the decoder does not learn from.

        Their planes and colours are fitted, too, because the curve of the training shows their error.
        """
        trained, texels, settings = self.samples.trained_texels, self.samples.texels, self.settings
        loss = super().loss(generator, progress)
        # Each unseen texel gets as many samples as a trained one; without unseen texels, as in the fit of one material,
        # there are none.
        unseen_count = math.ceil(settings.batch * (texels / trained - 1))
        if unseen_count:
            batch = self.samples.draw_unseen(unseen_count, generator)
            self.network.requires_grad_(False)  # only planes and colours learn from these
            loss = loss + distance(self.predict(batch, progress), batch.target, settings.loss)
            self.network.requires_grad_(True)
        return loss

    def predict(self, batch: Batch, progress: float) -> Tensor:
        """Log radiance (n, 3) of a batch."""
        return coloured(*self.answers(batch))

    def answers(self, batch: Batch) -> tuple[Tensor, Tensor]:
        """The decoder's answers (n, 3) to a batch, and the colours (n, 12) that turn them into log radiance; planes
        and colours are rounded."""
        material = self.material[batch.texel]
        # (n,): the row of the pair in `self.corner`, `self.weight` and `self.d`, which hold the `PAIRS` rows of a
        # pool's materials one after the other. A single material is number 0, and may have any number of pairs.
        row = batch.pair + material * PAIRS
        corner = self.corner[row] + (material * SIDE**2)[:, None]  # (n, 4) texels of all materials' planes
        texels = self.rounded_texels(torch.cat([self.texture, self.colours], 1)).index_select(0, batch.texel)
        features, colours = texels.tensor_split([FEATURES], dim=1)
        planes = self.rounded_planes(self.planes()).flatten(0, 2)  # (materials · SIDE², 6)
        rows = planes.index_select(0, corner.flatten()).unflatten(0, corner.shape)  # (n, 4, 6)
        half = (rows * self.weight[row][..., None]).sum(1)  # (n, 6)
        return self.network(torch.cat([self.d[row], half, features], 1)), colours

    @torch.no_grad()
    def stored_texture(self) -> Tensor:
        """The texture (texels, 18) for the file: features, matrices and offsets.

        A texel keeps its colours unless its mean is nearer to its ABRDF; then it gets a matrix of 0 and the mean as
        offset. Both are compared as rounded in the file, in the fit's steps (a step is the distance from one stored
        value to the next): new steps for the means would round every other texel anew. Only if the exact means of all
        texels are nearer are the means of all stored, in steps of their own.
        """
        pairs, device = self.samples.pairs, self.samples.device
        checked_pairs = torch.linspace(0, pairs - 1, min(pairs, CHECKED_PAIRS)).round().long().to(device)  # (P,)
        better_rows = list[Tensor]()  # of the texture, in blocks of texels: the fitted row or that of the mean
        mean_rows = list[Tensor]()
        means_suffice = True
        for texel in torch.arange(len(self.colours), device=device).split(BLOCK):
            abrdfs = self.samples.abrdfs(texel)
            # Each texel has two candidates for its row of the texture: with the fitted colours, and with its mean.
            fitted_row = torch.cat([self.texture[texel], self.colours[texel]], 1)  # (t, 18)
            mean_colours = functional.pad(abrdfs.mean(1), (MATRIX, 0))  # (t, 12): a matrix of 0, the mean as offset
            mean_row = torch.cat([self.texture[texel], mean_colours], 1)
            error, mean_error, exact_mean_error = self._errors(texel, checked_pairs, abrdfs[:, checked_pairs], mean_row)
            better_rows.append(torch.where((error < mean_error)[:, None], fitted_row, mean_row))
            mean_rows.append(mean_row)
            means_suffice = means_suffice and not bool((error < exact_mean_error).any())
        if not means_suffice:
            return torch.cat(better_rows)
        texture = torch.cat(mean_rows)
        self.rounded_texels.fit_to(texture)  # changes the steps that `store_texture` will use
        return texture

    def _errors(self, texel: Tensor, pair: Tensor, truth: Tensor, mean_row: Tensor) -> list[Tensor]:
        """The errors (t,) of texels (t,) at pairs (P,), whose log radiance is the truth (t, P, 3).

        They are those with the fitted colours, rounded, with the colours of `mean_row` (t, 18), rounded, and with
        these as they are.
        """
        count = len(pair)
        # Each texel with each pair: (t · P,), and targets (t · P, 3).
        batch = Batch(texel.repeat_interleave(count), pair.repeat(len(texel)), truth.flatten(0, 1))
        answer, fitted_colours = self.answers(batch)  # (t · P, 3), (t · P, 12)
        errors = [_error(answer, fitted_colours, truth)]
        for row in (self.rounded_texels(mean_row), mean_row):
            errors.append(_error(answer, row[:, FEATURES:].repeat_interleave(count, 0), truth))
        return errors


def _error(answer: Tensor, colours: Tensor, truth: Tensor) -> Tensor:
    """The mean squared error (t,) of log radiance of each of t texels, over P pairs.

    Answers (t · P, 3) of the decoder, coloured by `colours` (t · P, 12), should be the truth (t, P, 3).
    """
    level = coloured(answer, colours).reshape(truth.shape)
    return (level - truth).square().mean((1, 2))


class BiplaneMaterial(Material):
    """A texture (H, W, 6 + 12) of features and colours, a plane (SIDE, SIDE, 6) over half vectors, and the decoder."""

    def __init__(self, decoder: BiplaneDecoder, texture: Tensor, half: Tensor, gain: float, difference: Difference):
        """Count the cost of an answer, and keep the parts."""
        parameters = sum(p.numel() for p in decoder.parameters())
        colouring_flops = 2 * MATRIX + 3  # multiply and add the matrix, and add the offset
        plane_numbers_read = 4 * FEATURES  # of four texels of the plane
        flops = decoder.flops + colouring_flops + 2 * plane_numbers_read  # each is multiplied and added
        cost = DecoderCost.of_texture(texture, parameters, flops)  # adds the texture's own reads
        bytes_read = cost.bytes_per_sample + 4 * plane_numbers_read  # float32
        cost = replace(cost, table_floats=half.numel(), bytes_per_sample=bytes_read)
        super().__init__((texture.shape[0], texture.shape[1]), cost)
        self.decoder = decoder
        self.texture = texture
        self.half = half
        self.gain = gain
        self.difference = difference

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        """Linear radiance (n, 3) of queries, each (n, …); see `Material`. The footprint is ignored: there is one level
        of detail."""
        h, d = half_and_difference(wo, wi, self.difference)
        # Weights of halves may add up to a little more than 1.
        half = saturated(sample_texture(self.half, places(h, SIDE)))
        features, colours = saturated(sample_texture(self.texture, uv)).tensor_split([FEATURES], dim=1)
        answer = self.decoder(torch.cat([d[:, :2], half.to(d.dtype), features.to(d.dtype)], 1))
        return to_radiance(coloured(answer, colours.to(answer.dtype)), self.gain)
