"""The table itself, at half precision, interpolated between its samples: the reference for quality."""

import numpy as np
import torch
from torch import Tensor

from bench.btf import BTF
from bench.codec import Codec, Fit, Parts
from bench.directions import PairInterpolator, pack_layout, unpack_layout
from bench.material import DecoderCost, Material, texel_corners
from bench.quantise import half_scale


class Table(Codec):
    """The half-float table itself, interpolated over directions: exact at its samples, and as large as the data."""

    name, version = "table", 1
    interpolates = True

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        peak = max(float(np.abs(picture).max()) for picture in fit.progress(btf, "finding the range", len(btf)))
        scale = half_scale(peak)
        values = torch.empty(len(btf), *btf.shape, 3, dtype=torch.float16)
        for i, picture in enumerate(fit.progress(btf, total=len(btf))):
            values[i] = torch.from_numpy(picture / scale)
        return Parts(texture={"values": values}, other={**pack_layout(btf.layout), "scale": torch.tensor([scale])})

    def decode(self, parts: Parts, device: torch.device) -> Material:
        interpolator = PairInterpolator(unpack_layout(parts.other))
        return TableMaterial(parts.texture["values"].to(device), interpolator, float(parts.other["scale"]))


class TableMaterial(Material):
    def __init__(self, values: Tensor, interpolator: PairInterpolator, scale: float):
        pairs, height, width, channels = values.shape
        reads = 4 * interpolator.reads * channels
        cost = DecoderCost(
            texture_channels=pairs * channels,
            texture_floats=values.numel(),
            flops_per_sample=2 * reads,
            bytes_per_sample=reads * values.element_size(),
        )
        super().__init__((height, width), cost)
        self.values, self.interpolator, self.scale = (
            values.reshape(pairs, height * width, channels),
            interpolator,
            scale,
        )

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        texel, texel_weight = texel_corners(self.size, uv)
        pair, pair_weight = self.interpolator(wo, wi)
        corners = self.values[pair[:, :, None], texel[:, None, :]].to(wo.dtype)
        rgb = torch.einsum("np,nt,nptc->nc", pair_weight, texel_weight.to(wo.dtype), corners)
        return rgb * self.scale
