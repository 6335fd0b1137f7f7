"""Reads a BTF as a matrix (3 · pairs, texels), in blocks of consecutive slices."""

from collections.abc import Iterator

import numpy as np
import torch
from torch import Tensor

from bench.btf import BTF
from bench.codec import Fit

BLOCK_BYTES = 16 << 20  # slices read together: enough for fast products, few enough for the cache


def blocks(btf: BTF, fit: Fit, label: str, gain: float | None, block_bytes: int = 0) -> Iterator[Tensor]:
    """The slices of a BTF as new blocks (3 · slices, texels) float32 of `block_bytes`, or `BLOCK_BYTES`, on its device.

    With a `gain` they are log1p(gain · radiance), negative radiance counting as 0; without, radiance as it is.
    """
    texels = btf.shape[0] * btf.shape[1]
    step = max(1, (block_bytes or BLOCK_BYTES) // (texels * 12))
    for pair, picture in enumerate(fit.progress(btf, label, len(btf))):
        place = pair % step
        if place == 0:
            block = np.empty((min(step, len(btf) - pair), 3, texels), np.float32)
        block[place] = picture.reshape(texels, 3).T
        if place == len(block) - 1:
            values = torch.from_numpy(block).flatten(0, 1).to(fit.device)
            yield values if gain is None else values.clamp_min_(0).mul_(gain).log1p_()
