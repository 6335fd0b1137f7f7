"""Leather-like relief: glossy pebbles parted by creases."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from bench.btf import Array
from bench.data.materials.maps import Maps
from bench.data.materials.noise import mix, smooth, srgb, to_scattered


@dataclass(frozen=True)
class Leather:
    """Pebbles are the cells of scattered points (Worley 1996): they rise with the distance from the borders."""

    resolution: int = 256
    height: float = 0.02
    cells: int = 10  # pebbles along a side
    crease: float = 0.9  # width of a crease, as a share of a pebble
    roughness: float = 0.38
    skin_srgb: tuple[float, float, float] = (112, 58, 30)
    crease_srgb: tuple[float, float, float] = (52, 24, 14)

    def maps(self, seed: int) -> Maps:
        rng = np.random.default_rng(seed)
        coarse = self._pebbles(rng, self.cells, self.crease)
        fine = self._pebbles(rng, 3 * self.cells, 0.9)
        sag = smooth(rng, self.resolution, 0.1, 0.1)
        pores = smooth(rng, self.resolution, 0.005, 0.005)
        height = coarse * (0.85 + 0.08 * sag) + 0.15 * fine * coarse + 0.015 * pores
        wear = np.clip(0.5 + 0.25 * sag + 0.3 * (coarse - 0.6), 0, 1)
        colour = mix(srgb(*self.crease_srgb), srgb(*self.skin_srgb), np.clip(0.2 + 0.8 * coarse, 0, 1))
        return Maps(
            height=self.height * height,
            base_colour=np.clip(colour * (0.85 + 0.3 * wear)[..., None], 0, 1),
            roughness=np.clip(self.roughness + 0.2 * (1 - coarse) - 0.08 * wear, 0.05, 1),
        )

    def _pebbles(self, rng: np.random.Generator, cells: int, crease: float) -> Array:
        """Height in [0, 1]: 0 on the border of two cells, rounded up to 1 inside."""
        one, other = to_scattered(rng, self.resolution, cells, 0.42)
        border = np.clip((other - one) * cells / crease, 0, 1)
        return gaussian_filter(np.sqrt(1 - (1 - border) ** 2), 0.007 * self.resolution, mode="wrap")
