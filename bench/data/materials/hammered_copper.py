"""Hammered copper: shallow dents side by side, polished, with a patina in the low places."""

from dataclasses import dataclass

import numpy as np

from bench.data.materials.maps import Maps
from bench.data.materials.noise import mix, normalised, smooth, srgb, to_scattered


@dataclass(frozen=True)
class HammeredCopper:
    """Each dent is a bowl about one of many scattered points; the ridges between them catch the light in turn."""

    resolution: int = 256
    height: float = 0.018
    dents: int = 7  # along a side
    roughness: float = 0.34
    copper_srgb: tuple[float, float, float] = (222, 148, 118)
    patina_srgb: tuple[float, float, float] = (70, 116, 100)

    def maps(self, seed: int) -> Maps:
        rng = np.random.default_rng(seed)
        away = to_scattered(rng, self.resolution, self.dents, 0.35)[0] * self.dents
        tarnish = smooth(rng, self.resolution, 0.08, 0.08)
        grain = smooth(rng, self.resolution, 0.006, 0.006)
        low = np.clip(1.1 - 1.6 * away + 0.5 * tarnish, 0, 1) * 0.6
        return Maps(
            height=self.height * normalised(away * away + 0.01 * grain),
            base_colour=np.clip(mix(srgb(*self.copper_srgb), srgb(*self.patina_srgb), low), 0, 1),
            roughness=np.clip(self.roughness + 0.35 * low + 0.03 * grain, 0.1, 1),
            metalness=1 - 0.8 * low,
        )
