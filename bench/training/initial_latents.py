"""The initial latents of a fit: principal components of the texels' log ABRDFs, random numbers, or a mixture of both.

Latents are the numbers of a texel that a network reads; an ABRDF is the radiance of one texel at all pairs of view and
light. A texel's scores say how much of each principal component its ABRDF has. Scores are whitened, since a network
ignores small inputs, and scaled down, since it makes little use of the directions beside strong latents. Mixed with as
much noise, they hold a fit less to the training directions.
"""

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Literal

import torch
from torch import Tensor

from bench.training.svd import truncated_svd

if TYPE_CHECKING:
    from bench.training.samples import Samples

Start = Literal["mixed", "components", "random"]
Slices = Callable[[Tensor], Tensor]  # the log radiance (texels, n, 3) of some pairs (n,)

RANDOM_SPREAD, COMPONENT_SPREAD = 0.1, 0.5  # standard deviation of a channel
MIXED_SPREAD = 0.2  # of the component in a mixed channel, and of the noise
MOST_PAIRS = 1_024  # pairs that the components are computed from: more pairs group the texels no better
PASSES = 2  # passes over the data: a start need not be exact
BLOCK_BYTES = 16 << 20  # bytes of the matrix in memory at once


def first_latents(
    samples: "Samples", channels: int, start: Start, generator: torch.Generator, slices: Slices | None = None
) -> Tensor:
    """The first latents (texels, channels), float32, found on `slices` instead of `Samples.slices` if they are given.

    Channels beyond the rank of the data are random.
    """
    noise = torch.randn(samples.texels, channels, generator=generator)
    latents = RANDOM_SPREAD * noise
    if start == "random":
        return latents
    scores = components(samples, channels, generator, slices).cpu()
    count = scores.shape[1]  # at most `channels`
    mixed = MIXED_SPREAD * (scores + noise[:, :count])
    latents[:, :count] = mixed if start == "mixed" else COMPONENT_SPREAD * scores
    return latents


def components(samples: "Samples", count: int, generator: torch.Generator, slices: Slices | None = None) -> Tensor:
    """The whitened scores (texels, k ≤ count) of the log ABRDFs on their strongest components, k at most their rank."""
    pairs = torch.randperm(samples.pairs, generator=generator)[:MOST_PAIRS].sort().values
    weight = samples.density.weights[pairs].repeat_interleave(3) if samples.density else None
    shape = (3 * len(pairs), samples.texels)
    read_slices = samples.slices if slices is None else slices
    pairs_a_block = max(1, BLOCK_BYTES // (12 * samples.texels))  # a texel of a pair has 12 bytes

    def read(label: str) -> Iterator[Tensor]:
        """The log radiance in blocks of rows, three of each pair, and a column a texel; the label is not shown."""
        for block in pairs.split(pairs_a_block):
            level = read_slices(block)  # (texels, pairs, 3)
            yield level.permute(1, 2, 0).flatten(0, 1).contiguous()  # a copy, which the decomposition overwrites

    factors = truncated_svd(read, shape, count, PASSES, generator, samples.device, weight)
    scores = factors.coefficients.T
    return scores / scores.square().mean(0).sqrt()
