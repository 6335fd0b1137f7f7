"""Seeded random samples of a BTF, as log radiance, and its gain.

A sample is the radiance of one texel at one pair. In a fit to a scene, samples follow a `Density`: what the pictures of
the scene ask of texels and directions, and how often.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from bench.btf import BTF, box_filter
from bench.codec import Density, Fit
from bench.metrics.display import LOG_SCALE, exposure

MEMORY_LIMIT = 640 << 20  # bytes of log radiance kept in memory; a larger BTF is read batch by batch
COARSE_PAIRS = 2_048  # pairs of a larger BTF whose coarser levels of detail are kept
PROBE = 8_192  # samples for the mean, and for the PSNR of a fit's curve


class Batch(NamedTuple):
    """Random samples of a BTF."""

    texel: Tensor  # (n,), row · W + column
    pair: Tensor  # (n,), of `Samples.wo` and `wi`: a pair, or in a fit to a scene a direction between pairs
    target: Tensor  # (n, 3), log radiance


class Samples:
    """A BTF as log radiance, log1p(gain · radiance), for random reads; negative radiance counts as 0.

    Within `MEMORY_LIMIT` it is read once and kept as half floats, whose rounding (5e-4 of a value) is far below any
    codec's error. Random numbers are the CPU's, so that a fit is the same on any device; no step waits for a GPU.
    """

    density: Density | None = None  # density of the scene, in a fit to one

    def __init__(self, btf: BTF, gain: float, fit: Fit, memory_limit: int = MEMORY_LIMIT):
        """Read the BTF once and keep it, if its log radiance stays within `memory_limit` bytes."""
        self.btf = btf
        self.gain = gain
        self.device = fit.device
        self.shape = btf.shape
        self.pairs = len(btf)
        self.texels = btf.shape[0] * btf.shape[1]
        self.trained_texels = self.texels  # so many are trained on, the first ones; others are for the curve
        self.wo = torch.from_numpy(btf.wo).to(fit.device)
        self.wi = torch.from_numpy(btf.wi).to(fit.device)
        if fit.density:  # the scene's directions follow those of the pairs
            self.density = fit.density.to(fit.device)
            self.wo = torch.cat([self.wo, self.density.wo.to(fit.device)])
            self.wi = torch.cat([self.wi, self.density.wi.to(fit.device)])
        self.table: Tensor | None = None  # (texels, pairs, 3)
        if self.table_bytes <= memory_limit:
            # As the only level, which averages 1 texel a side: each picture as it is.
            (table,) = _filled_tables({1: self}, fit.progress(btf))
            self.table = table.to(fit.device)

    @property
    def table_bytes(self) -> int:
        """The size of its table: three halves for each texel and pair."""
        return 6 * self.texels * self.pairs

    @classmethod
    def levels(cls, btf: BTF, count: int, gain: float, fit: Fit) -> "list[Samples]":
        """The samples of the BTF at each of `count` levels of detail, box-filtered over 2^level texels, finest first.

        If the finest does not fit into memory, the others hold `COARSE_PAIRS` random pairs: all would take minutes. In
        a fit to a scene they hold all, because its density is of all pairs.
        """
        # A limit of 0: no table is filled yet. Below all of them are filled in one pass over the BTF.
        finest = cls(btf, gain, fit, memory_limit=0)
        if finest.table_bytes > MEMORY_LIMIT and len(btf) > COARSE_PAIRS and not fit.density:
            shuffled = torch.randperm(len(btf), generator=fit.generator())
            btf = btf.subset(shuffled[:COARSE_PAIRS].sort().values.numpy())
        levels = {1: finest}  # by the texels a side that each averages
        for level in range(1, count):
            levels[2**level] = cls(btf.downsample(2**level), gain, fit, memory_limit=0)
        # Those that fit into memory; others read the BTF batch by batch.
        small_enough = {factor: level for factor, level in levels.items() if level.table_bytes <= MEMORY_LIMIT}
        if small_enough:
            tables = _filled_tables(small_enough, fit.progress(btf))
            for samples, table in zip(small_enough.values(), tables, strict=True):
                samples.table = table.to(fit.device)
        return list(levels.values())

    def _log(self, radiance: np.ndarray) -> Tensor:
        """Radiance as log radiance, in the same shape, on the CPU."""
        not_negative = np.maximum(radiance, 0)  # a copy, because a source may be read-only
        return torch.from_numpy(not_negative).mul_(self.gain).log1p_()

    def _to_device(self, drawn: Tensor) -> Tensor:
        """Random numbers, drawn on the CPU, on the fit's device; no step waits for the copy."""
        return drawn.to(self.device, non_blocking=True)

    def draw(self, count: int, generator: torch.Generator) -> Batch:
        """Draw `count` samples, uniform over the texels of training and pairs; in a fit to a scene, by its density."""
        if self.density:
            drawn = self.density.draw(count, self.shape, generator)
            return self.seen(self._to_device(drawn.texel), self._to_device(drawn.direction))
        # One random number a sample: texel · pairs + pair.
        flat = self._to_device(torch.randint(self.trained_texels * self.pairs, (count,), generator=generator))
        return self.at(flat // self.pairs, flat % self.pairs)

    def draw_at(self, texel: Tensor, generator: torch.Generator) -> Batch:
        """Draw a sample at each of some texels (n,), uniform over pairs; in a fit to a scene, by its density."""
        if self.density:
            drawn = self.density.draw(len(texel), self.shape, generator)
            return self.seen(texel, self._to_device(drawn.direction))
        pair = torch.randint(self.pairs, (len(texel),), generator=generator)
        return self.at(texel, self._to_device(pair))

    def draw_unseen(self, count: int, generator: torch.Generator) -> Batch:
        """Draw `count` samples of the texels kept out of training, of which there must be some."""
        texel = self.trained_texels + torch.randint(self.texels - self.trained_texels, (count,), generator=generator)
        return self.draw_at(self._to_device(texel), generator)

    def mean(self, generator: torch.Generator) -> Tensor:
        """The mean log radiance (3,) of `PROBE` random samples."""
        return self.draw(PROBE, generator).target.mean(0)

    def at(self, texel: Tensor, pair: Tensor) -> Batch:
        """The samples at some texels and pairs, both (n,)."""
        if self.table is not None:
            return Batch(texel, pair, self.table.view(-1, 3)[texel * self.pairs + pair].float())
        row, col = np.divmod(texel.cpu().numpy(), self.shape[1])
        radiance = self.btf.gather(pair.cpu().numpy(), row, col)
        return Batch(texel, pair, self._log(radiance).to(self.device))

    def seen(self, texel: Tensor, direction: Tensor) -> Batch:
        """The samples at some texels and directions, both (n,).

        A direction is the number of a pair; in a fit to a scene it is the number of one of the directions of its
        density, which lie between pairs: there the sample is the weighted mean of the k pairs around it.
        """
        if not self.density:
            return self.at(texel, direction)
        pair, weight = self.density.around(direction)  # both (n, k)
        around = self.at(texel.repeat_interleave(pair.shape[1]), pair.flatten())
        corners = around.target.unflatten(0, pair.shape)  # (n, k, 3)
        mean = (corners.expm1() * weight[..., None]).sum(1)  # of radiance times the gain, not of its logarithm
        return Batch(texel, direction, mean.log1p())

    def abrdfs(self, texel: Tensor) -> Tensor:
        """The log ABRDFs (n, pairs, 3) of some texels (n,)."""
        if self.table is not None:
            return self.table[texel].float()
        row, col = np.divmod(texel.cpu().numpy(), self.shape[1])
        return self._log(self.btf.texels(row, col)).to(self.device)

    def slices(self, pair: Tensor) -> Tensor:
        """The log radiance (texels, n, 3) of some pairs (n,)."""
        if self.table is not None:
            return self.table[:, pair.to(self.device)].float()
        chosen = self.btf.subset(pair.cpu().numpy())
        return torch.stack([self._log(picture).reshape(-1, 3) for picture in chosen], 1).to(self.device)

    def centres(self, texel: Tensor) -> Tensor:
        """uv (n, 2) of the centres of some texels (n,)."""
        return centres(texel, self.shape)


def centres(texel: Tensor, shape: tuple[int, int]) -> Tensor:
    """uv (n, 2), in the frame of `bench.btf`, of the centres of texels (n,), row · W + column, of a picture (H, W)."""
    height, width = shape
    row = texel.div(width, rounding_mode="floor")
    return torch.stack([(texel - row * width + 0.5) / width, 1 - (row + 0.5) / height], 1)


def _filled_tables(levels: dict[int, Samples], pictures: Iterable[np.ndarray]) -> list[Tensor]:
    """The log radiance (texels, pairs, 3) of each of several samples, in halves.

    `levels` are the samples by the texels a side that each averages; `pictures` (H, W, 3), one a pair, are read once
    for all of them.
    """
    tables = [torch.empty(samples.texels, samples.pairs, 3, dtype=torch.float16) for samples in levels.values()]
    for pair, picture in enumerate(pictures):
        for (factor, samples), table in zip(levels.items(), tables, strict=True):
            coarse = picture if factor == 1 else box_filter(picture, factor)
            table[:, pair] = samples._log(coarse).reshape(-1, 3)
    return tables


def gain_of(btf: BTF, fit: Fit) -> float:
    """The gain, 8 × the exposure of the training pairs; a codec predicts log1p(gain · radiance) and stores the gain."""
    return LOG_SCALE * exposure(btf, fit.seed)
