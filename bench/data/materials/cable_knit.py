"""Cable-knit wool: two twisted strands of V stitches over a ground of purl bumps."""

from dataclasses import dataclass

import numpy as np

from bench.btf import Array
from bench.data.materials.maps import Maps
from bench.data.materials.noise import grid, normalised, smooth, srgb


@dataclass(frozen=True)
class CableKnit:
    """One cable in a tile. Its relief is a seventh of the tile's width, so that at 75° it shifts by half the tile."""

    resolution: int = 256
    height: float = 0.14  # from the deepest gap to the top of the cable
    stitches: int = 10  # V stitches along a strand, rows of purl bumps on the ground
    bumps: int = 8  # purl bumps across the whole tile
    sway: float = 0.13  # how far a strand swings to each side
    radius: float = 0.15  # half the width of a strand
    yarn: float = 0.28  # relief of the yarns on a strand, as a share of the strand's
    roughness: float = 0.75
    colour_srgb: tuple[float, float, float] = (226, 208, 172)

    def maps(self, seed: int) -> Maps:
        rng = np.random.default_rng(seed)
        u, v = grid(self.resolution)
        ground = self._ground(u, v)
        strands = [self._strand(u, v, side) for side in (-1, 1)]
        layers = np.stack([ground, *strands])
        fuzz = smooth(rng, self.resolution, 0.004, 0.004)
        height = normalised(layers.max(0) + 0.008 * fuzz)
        tint = 1 + 0.05 * smooth(rng, self.resolution, 0.06, 0.06) + 0.05 * fuzz
        return Maps(
            height=self.height * height,
            base_colour=np.clip(srgb(*self.colour_srgb) * tint[..., None], 0, 1),
            roughness=self.roughness,
            specular=0.5,
        )

    def _strand(self, u: Array, v: Array, side: int) -> Array:
        """A round strand that winds about the other, covered by V stitches; below everything outside its width."""
        turn = 2 * np.pi * v
        centre = 0.5 + side * self.sway * np.sin(turn)
        lean = side * self.sway * 2 * np.pi * np.cos(turn)
        across = (u - centre) / (self.radius * np.sqrt(1 + lean * lean))
        body = np.sqrt(np.maximum(1 - across * across, 0))
        leg = np.abs(across)
        ridge = np.abs(np.cos(np.pi * (v * self.stitches - 0.9 * leg)))
        edge = np.sin(np.pi * np.clip(leg, 0, 1)) ** 0.5
        yarn = self.yarn * (np.sqrt(ridge) * edge - 1)
        lifted = 0.55 + 0.3 * side * np.cos(turn) + 0.6 * body + yarn
        return np.where(leg < 1, lifted, -1)

    def _ground(self, u: Array, v: Array) -> Array:
        """Rows of purl bumps, every other row shifted by half a bump."""
        row = v * self.stitches
        column = u * self.bumps + 0.5 * (np.floor(row) % 2)
        x, y = 2 * (column % 1) - 1, 2 * (row % 1) - 1
        return 0.35 * np.sqrt(np.maximum(1 - 0.8 * x * x - 0.9 * y * y, 0))
