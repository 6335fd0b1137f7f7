"""Where a decoder is asked for what it is scored on."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from bench.btf import BTF, ArraySource
from bench.hemisphere import from_degrees
from bench.material import DecoderCost, Material
from bench.metrics.scoring import score_footprints
from bench.runs.evaluation import Slices

WAVES = torch.tensor([3.0, 2.0])  # of the picture, across and down


class Exact(Material):
    """Radiance 1/2 + 1/4 · cos(2π a u) cos(2π b v), and its integral over any box: the mean of a cosine is a sinc."""

    def __init__(self, size):
        super().__init__(size, DecoderCost())

    def evaluate(self, uv, wo, wi, footprint):
        texels = footprint[:, None] * max(self.size)
        sides = texels / torch.tensor([self.size[1], self.size[0]])
        waves = torch.cos(2 * torch.pi * WAVES * uv) * torch.sinc(WAVES * sides)
        return (0.5 + 0.25 * waves.prod(1, keepdim=True)).expand(-1, 3)


@pytest.mark.parametrize("size", [(40, 48), (37, 41), (23, 46)])
def test_an_exact_material_is_exact_at_every_footprint_whatever_its_size(size):
    material = Exact(size)
    wo, wi = from_degrees([0, 40], [0, 70]), from_degrees([30, 10], [0, 0])
    values = np.stack([material.slice(o, i).numpy() for o, i in zip(wo, wi, strict=True)])
    btf = BTF("waves", wo, wi, ArraySource(values), periodic=True)
    decoder = Slices(SimpleNamespace(btf=btf, name="waves"), material, lambda *_: None)
    found = score_footprints(btf, [0, 1], decoder.slice, 1.0)
    # Rounding of float32 leaves 130 dB and more; half a texel of misregistration 40.
    assert all(entry["psnr_display"] is None or entry["psnr_display"] > 120 for entry in found.values())
