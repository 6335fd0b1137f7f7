"""The measured table at half precision, interpolated between its samples: the reference for quality.

The table holds the linear radiance of each texel at each pair. Numbers are divided by a *scale*, 1 or a power of two,
since halves end at 65,504.
"""

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from bench.btf import BTF
from bench.codec import Codec, Fit, Parts
from bench.directions.interpolation import PairInterpolator, pack_layout, unpack_layout
from bench.material import DecoderCost, Material, texel_corners
from bench.training.quantise import half_scale


class Table(Codec):
    """The half-float table itself, interpolated over directions: exact at its samples, and as large as the data."""

    name, version = "table", 2
    interpolates = True

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        """All values as halves, (pairs, H, W, 3), over a scale that brings the largest of them into range.

        The BTF is read twice: the scale must be known before the first value is stored.
        """
        peak = 0.0
        for picture in fit.progress(btf, "finding the range", len(btf)):
            peak = max(peak, float(np.abs(picture).max()))
        scale = half_scale(peak)
        values = torch.empty(len(btf), *btf.shape, 3, dtype=torch.float16)
        for i, picture in enumerate(fit.progress(btf)):
            values[i] = torch.from_numpy(picture / scale)
        return Parts(texture={"values": values}, other={**pack_layout(btf.layout), "scale": torch.tensor([scale])})

    def decode(self, parts: Parts, device: torch.device) -> Material:
        """The material of a file's parts, on a device, in float32."""
        values = parts.texture["values"].to(device).float()
        interpolator = PairInterpolator(unpack_layout(parts.other, len(values)))
        return TableMaterial(values, interpolator, float(parts.other["scale"])).to(device)


class TableMaterial(Material):
    """Linear radiance (pairs, H, W, 3) over `scale`, bilinear over texels and interpolated over pairs."""

    def __init__(self, values: Tensor, interpolator: PairInterpolator, scale: float):
        """Count the cost of an answer, and keep the parts. `values` are (pairs, H, W, 3)."""
        pairs, height, width, channels = values.shape
        numbers_read = 4 * interpolator.reads * channels  # of four texels at some pairs
        cost = DecoderCost(
            texture_channels=pairs * channels,
            texture_floats=values.numel(),
            flops_per_sample=2 * numbers_read,  # each is multiplied and added
            bytes_per_sample=numbers_read * values.element_size(),
        )
        super().__init__((height, width), cost)
        self.values = values.reshape(-1, channels)
        self.interpolator = interpolator
        self.scale = scale

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        """Linear radiance (n, 3) of queries, each (n, …); see `Material`. The footprint is ignored: there is one level
        of detail.

        It is the weighted sum of four texels at each of P pairs. A pair's weight includes the cosine of the query's
        light over that of the pair's.
        """
        texel, texel_weight = texel_corners(self.size, uv)
        pair, pair_weight = self.interpolator(wo, wi)
        # Rows of the flat table: H · W texels of the first pair, then of the second, and so on.
        row = pair[:, :, None] * (self.size[0] * self.size[1]) + texel[:, None, :]  # (n, P, 4)
        row = row.flatten(1)  # (n, P · 4)
        weight = (pair_weight[:, :, None] * texel_weight[:, None, :].to(wo.dtype)).flatten(1)  # (n, P · 4)
        if self.values.dtype == weight.dtype:
            rgb = functional.embedding_bag(row, self.values, per_sample_weights=weight, mode="sum")
        else:  # halves end at 65,504, and weights of grazing lights are above 1, so they are added in float32
            corners = self.values.index_select(0, row.flatten()).unflatten(0, row.shape)  # (n, P · 4, 3)
            rgb = torch.einsum("nk,nkc->nc", weight, corners.to(weight.dtype))
        return rgb * self.scale
