"""Brushed metal: long fine scratches along x, highlights stretched across them."""

from dataclasses import dataclass

import numpy as np

from bench.data.materials.maps import Maps
from bench.data.materials.noise import smooth, srgb


@dataclass(frozen=True)
class BrushedMetal:
    """Scratches are white noise stretched along x; they tilt the surface across, and change its roughness and tint."""

    resolution: int = 256
    height: float = 0.0012  # deviation of the scratches' depth
    roughness: float = 0.34
    anisotropy: float = 0.85
    metal_srgb: tuple[float, float, float] = (222, 206, 184)

    def maps(self, seed: int) -> Maps:
        rng = np.random.default_rng(seed)
        scratches = 0.7 * smooth(rng, self.resolution, 0.006, 0.12) + 0.5 * smooth(rng, self.resolution, 0.012, 0.4)
        shade = smooth(rng, self.resolution, 0.005, 0.2)
        wander = smooth(rng, self.resolution, 0.02, 0.1)
        return Maps(
            height=self.height * scratches,
            base_colour=np.clip(srgb(*self.metal_srgb) * (1 + 0.06 * shade)[..., None], 0, 1),
            roughness=np.clip(self.roughness + 0.08 * shade, 0.15, 0.8),
            metalness=1.0,
            anisotropy=self.anisotropy,
            angle=np.pi / 2 + 0.15 * wander,
        )
