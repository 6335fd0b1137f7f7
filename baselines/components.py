"""Common parts of codecs whose material is coefficients of texels times components interpolated over pairs.

A texel's ABRDF is about the mean of all plus the sum of k components, (N, 3) each of N pairs, times its k coefficients.
What is decomposed is radiance or log radiance.
"""

import math
from functools import partial

import torch
from torch import Tensor
from torch.nn import functional

from bench.btf import BTF
from bench.codec import Fit
from bench.directions.interpolation import PairInterpolator
from bench.material import DecoderCost, Material, sample_texture, to_radiance
from bench.training import Rounding, round_after
from bench.training.svd import Factors, blocks, truncated_svd

PROBED_PAIRS, PROBED_TEXELS = 32, 1_024  # the values that measure the error of rounding: these pairs at these texels


def principal_components(
    btf: BTF, fit: Fit, gain: float | None, count: int, passes: int, block_bytes: int = 0
) -> Factors:
    """The `count` strongest principal components of the texels' ABRDFs, found in `passes` passes over the data.

    ABRDFs hold log1p(gain · radiance), or radiance if `gain` is None, in the rows of `bench.training.svd.blocks`.
    `block_bytes` are those of slices read together; 0: its default.
    """
    read = partial(blocks, btf, fit, gain=gain, block_bytes=block_bytes)  # the label of the pass is left open
    shape = (3 * len(btf), btf.shape[0] * btf.shape[1])
    return truncated_svd(read, shape, count, passes, fit.generator(), fit.device, fit.row_weights)


def probed_values(btf: BTF, fit: Fit, gain: float | None) -> tuple[Tensor, Tensor]:
    """At most `PROBED_PAIRS` random pairs (P,) in order, and their values (3 · P, texels), three rows of each pair.

    Values are log1p(gain · radiance), or radiance if `gain` is None.
    """
    pairs = torch.randperm(len(btf), generator=fit.generator())[:PROBED_PAIRS].sort().values
    values = list(blocks(btf.subset(pairs.numpy()), fit, "some slices", gain))
    return pairs, torch.cat(values)


def probed_texels(count: int) -> slice:
    """At most `PROBED_TEXELS` of `count` texels, evenly spread: every so many."""
    return slice(None, None, math.ceil(count / PROBED_TEXELS))


def rounded_coefficients(
    texture: Tensor, bits: int, mean: Tensor, rows: Tensor, values: Tensor, least: int = 1
) -> Rounding:
    """The rounding of a texture of coefficients (H, W, C), chosen by the error that it causes in some values.

    The values (F, texels) are mean (F, 1) + rows (F, C) · coefficients (C, texels). `bits` is the setting: the bits of
    a number on average, 0 for as many as matter, 16 or 32 for floats. Each channel takes `least` bits or more.
    """
    of_texels = texture.flatten(0, 1)  # (texels, C)
    some_texels = probed_texels(len(of_texels))

    def answers(coefficients: Tensor) -> Tensor:
        """The values (F, n) of coefficients (n, C)."""
        return mean + rows @ coefficients.T

    rounding = round_after(of_texels[some_texels], bits, answers, values[:, some_texels], least)
    return rounding.fit_to(texture)  # the same bits, for the range of all texels


class ComponentsMaterial(Material):
    """Coefficients (H, W, k), bilinear, and 1 for the mean, times components: log radiance; without `gain` radiance."""

    def __init__(self, texture: Tensor, interpolator: PairInterpolator, gain: float | None, cost: DecoderCost):
        """Keep a texture (H, W, k) of coefficients, what interpolates over pairs, and the gain, None if components are
        of radiance, not of its logarithm."""
        super().__init__((texture.shape[0], texture.shape[1]), cost)
        self.texture = texture
        self.interpolator = interpolator
        self.gain = gain

    def combined(self, pair: Tensor, weight: Tensor, coefficients: Tensor) -> Tensor:
        """Σ weight · components of a pair · coefficients, over P pairs and k + 1 components: (n, 3).

        Pairs, which are indices, and their weights are (n, P), coefficients (n, k + 1), the mean's first.
        """
        raise NotImplementedError

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        """Linear radiance (n, 3) of queries, each (n, …); see `Material`. The footprint is ignored: there is one level
        of detail. Log radiance, if it was decomposed, is interpolated between pairs."""
        coefficients = functional.pad(sample_texture(self.texture, uv), (1, 0), value=1.0)  # (n, k + 1)
        if self.gain is None:
            pair, weight = self.interpolator(wo, wi)  # these weights include the cosines
            return self.combined(pair, weight, coefficients)
        pair, share = self.interpolator.shares(wo, wi)
        level = self.combined(pair, share, coefficients).clamp_min(0)
        return radiance_under(wi, level, self.gain, self.interpolator, pair, share)


def radiance_under(
    wi: Tensor, level: Tensor, gain: float, interpolator: PairInterpolator, pair: Tensor, share: Tensor
) -> Tensor:
    """Linear radiance (n, 3) for lights wi (n, 3), of log radiance `level` (n, 3) mixed by the shares of pairs (n, P).

    Radiance includes the cosine of the light. So it is divided by the mean cosine of the pairs' lights, and multiplied
    by the cosine of the query's.
    """
    cosine_ratio = wi[:, 2:] / interpolator.mean_cosine(pair, share, level)
    return to_radiance(level, gain) * cosine_ratio
