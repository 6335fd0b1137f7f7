"""The initial latents of a fit: the principal components of the texels' log ABRDFs and noise, or random numbers.

The components already group texels that look alike; a random start must learn this first. Scores are whitened, since a
network ignores small inputs, and small, since it makes little use of the directions beside strong latents. As much
noise is added: components alone hold a fit to the training directions that they were found on.
"""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Literal

import torch
from torch import Tensor

from bench.training.svd import truncated_svd

if TYPE_CHECKING:
    from bench.training.fitting import Samples

Start = Literal["components", "random"]

RANDOM_SPREAD = 0.1  # standard deviation of a random channel
COMPONENT_SPREAD = 0.2  # of a component, and again of the noise that is added to it
MOST_PAIRS = 1_024  # pairs that the components are computed from: more pairs group the texels no better
PASSES = 2  # passes over the data: a start need not be exact
BLOCK_BYTES = 16 << 20  # bytes of the matrix in memory at once


def first_latents(samples: "Samples", channels: int, start: Start, generator: torch.Generator) -> Tensor:
    """The first latents (texels, channels) of a fit, float32. Channels beyond the rank of the data are random."""
    noise = torch.randn(samples.texels, channels, generator=generator)
    latents = RANDOM_SPREAD * noise
    if start == "components":
        scores = components(samples, channels, generator).cpu()
        count = scores.shape[1]
        latents[:, :count] = COMPONENT_SPREAD * (scores + noise[:, :count])
    return latents


def components(samples: "Samples", count: int, generator: torch.Generator) -> Tensor:
    """The whitened scores (texels, k ≤ count) of the log ABRDFs on their strongest components, k at most their rank."""
    pairs = torch.randperm(samples.pairs, generator=generator)[:MOST_PAIRS].sort().values
    weight = samples.density.weights[pairs].repeat_interleave(3) if samples.density else None
    shape = (3 * len(pairs), samples.texels)

    def read(label: str) -> Iterator[Tensor]:
        for block in pairs.split(max(1, BLOCK_BYTES // (12 * samples.texels))):
            yield samples.slices(block).permute(1, 2, 0).flatten(0, 1).contiguous()

    scores = truncated_svd(read, shape, count, PASSES, generator, samples.device, weight).coefficients.T
    return scores / scores.square().mean(0).sqrt()
