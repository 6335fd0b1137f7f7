"""Woven satin: a five-end satin weave of glossy fibres, warp and weft of two colours."""

from dataclasses import dataclass

import numpy as np

from bench.btf import Array
from bench.data.materials.maps import Maps
from bench.data.materials.noise import grid, mix, smooth, srgb


@dataclass(frozen=True)
class Satin:
    """A warp-faced satin: each warp thread floats over four wefts and dips under the fifth, its neighbour two further.
    Fibres run along their thread with some twist, and highlights stretch across the fibres."""

    resolution: int = 256
    threads: int = 10  # warp threads and weft threads in a tile, a multiple of five
    height: float = 0.011  # height of a thread above the interlacing plane
    twist_deg: float = 12.0  # angle of the fibres to the axis of their thread
    roughness: float = 0.42
    anisotropy: float = 0.85
    warp_srgb: tuple[float, float, float] = (150, 22, 48)
    weft_srgb: tuple[float, float, float] = (214, 170, 84)

    def maps(self, seed: int) -> Maps:
        rng = np.random.default_rng(seed)
        u, v = grid(self.resolution)
        across_u, across_v = u * self.threads, v * self.threads
        warp, weft = np.floor(across_u).astype(int), np.floor(across_v).astype(int)
        warp_top = self._ride(warp, across_v, 2) + _bulge(across_u)
        weft_top = -self._ride(weft, across_u, 3) + _bulge(across_v)
        is_warp = warp_top >= weft_top
        thread = np.where(is_warp, warp, weft + self.threads)
        tint = rng.normal(1, 0.06, 2 * self.threads)[thread]
        fibre = np.where(is_warp, smooth(rng, self.resolution, 0.05, 0.004), smooth(rng, self.resolution, 0.004, 0.05))
        colour = mix(srgb(*self.weft_srgb), srgb(*self.warp_srgb), is_warp.astype(float))
        colour = colour * (tint * (1 + 0.12 * fibre))[..., None]
        twist = np.radians(self.twist_deg) + 0.06 * fibre
        along = np.where(is_warp, np.pi / 2, 0.0) + twist
        top = np.maximum(warp_top, weft_top)
        return Maps(
            height=self.height * (top + 0.05 * fibre),
            base_colour=np.clip(colour, 0, 1),
            roughness=np.clip(self.roughness + 0.04 * fibre, 0.2, 0.8),
            metalness=0.35,
            anisotropy=self.anisotropy,
            angle=along + np.pi / 2,
        )

    def _ride(self, thread: Array, along: Array, step: int) -> Array:
        """Height of a thread's axis: +0.5 over, −0.5 in the middle of the thread it dips under, smooth between."""
        away = np.abs((along - 0.5 - step * thread + 2.5) % 5 - 2.5)
        return 0.5 - np.where(away < 1, 0.5 + 0.5 * np.cos(np.pi * away), 0)


def _bulge(across: Array) -> Array:
    """The round cross-section of a thread, 0 at its edge and 1 at its middle."""
    x = 2 * (across % 1) - 1
    return np.sqrt(np.maximum(1 - x * x, 0))
