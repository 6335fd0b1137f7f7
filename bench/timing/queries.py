"""Draws the queries with which materials are timed."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from bench.directions.hemisphere import from_degrees, uniform
from bench.material import texel_centres


@dataclass(frozen=True)
class Queries:
    """A batch: incoherent, uv and directions up to 75° at random, or coherent, slices of one pair row by row."""

    batch: int
    coherent: bool = False
    footprint: float = 0.0  # in texels

    def draw(self, size: tuple[int, int], device: torch.device) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """uv (n, 2), wo and wi (n, 3), footprint (n,), for a material of `size`; the same each time."""
        rng = np.random.default_rng(0)
        if self.coherent:
            centres = texel_centres(*size)
            uv = centres.repeat(-(-self.batch // len(centres)), 1)[: self.batch]
            pair = from_degrees([40, 20], [30, 200])
            wo, wi = (torch.from_numpy(w).expand(self.batch, 3) for w in pair)
        else:
            uv = torch.from_numpy(rng.random((self.batch, 2), np.float32))
            wo, wi = (torch.from_numpy(uniform(rng, self.batch)) for _ in range(2))
        footprint = torch.full((self.batch,), self.footprint / max(size))
        return uv.to(device), wo.to(device), wi.to(device), footprint.to(device)
