"""The lower bound of quality and of time: one colour per texel, linear radiance, for all directions."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from bench.btf import BTF
from bench.codec import Codec, Fit, Parts
from bench.material import DecoderCost, Material, sample_texture
from bench.training.quantise import FloatPrecision, pack, unpack


class MeanColour(Codec):
    """Each texel's mean over all pairs: the lower bound of quality and of time."""

    name, version = "mean-colour", 1
    interpolates = True  # the answer is the same for every pair

    @dataclass(frozen=True)
    class Settings:
        half: bool = True  # store the texture as float16

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        """Store the mean (H, W, 3) of all slices, added up in float64."""
        mean = np.zeros((*btf.shape, 3))
        for picture in fit.progress(btf):
            mean += picture / len(btf)
        precision: FloatPrecision = "half" if self.settings.half else "float32"
        return Parts(texture=pack("mean", torch.from_numpy(mean), precision))

    def decode(self, parts: Parts, device: torch.device) -> Material:
        """The material of a file's parts, on a device."""
        return MeanColourMaterial(unpack("mean", parts.texture)).to(device)


class MeanColourMaterial(Material):
    """A texture (H, W, 3) of linear radiance, which is the answer for all directions and footprints."""

    def __init__(self, texture: Tensor):
        """Count the cost of an answer, and keep the texture."""
        super().__init__((texture.shape[0], texture.shape[1]), DecoderCost.of_texture(texture))
        self.texture = texture

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        """Linear radiance (n, 3) of queries, each (n, …); see `Material`. Only uv is used: bilinear, periodic."""
        return sample_texture(self.texture, uv)
