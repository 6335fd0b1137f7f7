"""Wicker: willow rods woven over and under stout stakes, with gaps that show the dark below."""

from dataclasses import dataclass

import numpy as np

from bench.btf import Array
from bench.data.materials.maps import Maps
from bench.data.materials.noise import grid, mix, smooth, srgb


@dataclass(frozen=True)
class Wicker:
    """Rods run along x, stakes along y. A rod passes over one stake and under the next; its neighbours do the other."""

    resolution: int = 256
    height: float = 0.09
    rods: int = 8  # in a tile; an even number, like the stakes
    stakes: int = 4
    roughness: float = 0.5
    willow_srgb: tuple[float, float, float] = (182, 134, 78)
    bark_srgb: tuple[float, float, float] = (96, 58, 30)

    def maps(self, seed: int) -> Maps:
        rng = np.random.default_rng(seed)
        u, v = grid(self.resolution)
        rod, stake = np.floor(v * self.rods).astype(int), np.floor(u * self.stakes).astype(int)
        sway = np.cos(np.pi * (u * self.stakes - 0.5)) * (-1.0) ** rod
        rod_top = 0.45 * sway + 0.5 * _round(v * self.rods, 0.46)
        stake_top = 0.55 * _round(u * self.stakes, 0.22)
        is_rod = rod_top >= stake_top
        top = np.maximum(np.maximum(rod_top, stake_top), -0.6)
        fibre = np.where(is_rod, smooth(rng, self.resolution, 0.003, 0.08), smooth(rng, self.resolution, 0.08, 0.003))
        shade = rng.normal(0, 0.25, self.rods + self.stakes)[np.where(is_rod, rod, stake + self.rods)]
        bark = np.clip(0.35 + shade + 0.2 * fibre, 0, 1)
        colour = mix(srgb(*self.willow_srgb), srgb(*self.bark_srgb), bark)
        return Maps(
            height=self.height * (top + 0.02 * fibre),
            base_colour=np.clip(colour * (1 + 0.08 * fibre)[..., None], 0, 1),
            roughness=np.clip(self.roughness + 0.06 * fibre, 0.2, 1),
            anisotropy=0.3,
            angle=np.where(is_rod, np.pi / 2, 0.0),
        )


def _round(across: Array, half_width: float) -> Array:
    """The profile of a row of cylinders, one a unit: 1 on top, −1 in the gaps."""
    x = (across % 1 - 0.5) / half_width
    return np.where(np.abs(x) < 1, np.sqrt(np.maximum(1 - x * x, 0)), -1.0)
