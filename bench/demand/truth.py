"""Computes the reference answers to a demand: the BTF interpolated over texels, pairs and levels of detail.

Radiance is interpolated over directions as in `bench.directions.interpolation`, and over the texture in a pyramid of
box filters: bilinear and periodic within the two levels around a footprint, linear between them.
"""

import numpy as np
import torch

from bench.btf import BTF, Array, box_filter
from bench.codec import Progress, silent
from bench.demand.demand import Demand
from bench.demand.pair_weights import pair_weights
from bench.material import sample_texture


def truth(btf: BTF, demand: Demand, show: Progress = silent) -> Array:
    """Linear radiance (n, 3) float32, not negative, for the queries of a demand. Each slice is read at most once."""
    weights = pair_weights(btf.layout, demand, radiance=True)
    pair, weight = weights.sample.numpy().ravel(), weights.weight.numpy().ravel()
    used = np.flatnonzero(weight > 0)
    used = used[np.argsort(pair[used], kind="stable")]
    places = np.searchsorted(pair[used], np.arange(len(btf) + 1))
    uv, deepest = torch.from_numpy(demand.uv(btf.shape)), int(np.log2(min(btf.shape)))
    # The level of detail of each query: log2 of its footprint in texels, within the pyramid.
    texels = np.maximum(demand.footprint, 1e-9) * max(btf.shape)
    level = torch.from_numpy(np.clip(np.log2(texels), 0, deepest).astype(np.float32))
    answers = np.zeros((len(demand), 3), np.float32)
    for index in range(len(btf)):
        show(f"reference of {demand.name}", index + 1, len(btf))
        rows = used[places[index] : places[index + 1]]
        if len(rows):
            query = rows // weights.sample.shape[1]
            values = _filtered(btf[index], uv[query], level[query])
            np.add.at(answers, query, values.numpy() * weight[rows, None])
    return np.maximum(answers, 0)


def _filtered(picture: Array, uv: torch.Tensor, level: torch.Tensor) -> torch.Tensor:
    """A slice (H, W, 3) at uv (n, 2) and levels (n,): (n, 3)."""
    out = torch.zeros(len(uv), 3)
    for number in range(int(level.max()) + 2):
        share = (1 - (level - number).abs()).clamp_min(0)
        some = share > 0
        if some.any():
            texture = torch.from_numpy(np.ascontiguousarray(box_filter(picture, 2**number), np.float32))
            # A level omits texels that do not fill a box; see `bench.btf` for the frame.
            height, width = (side / (side // 2**number * 2**number) for side in picture.shape[:2])
            within = torch.stack([uv[some, 0] * width, 1 - (1 - uv[some, 1]) * height], 1)
            out[some] += share[some, None] * sample_texture(texture, within)
    return out
