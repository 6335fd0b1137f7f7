"""Compares a normal map with a displacement map, and finds which of the two is inverted.

Normals that lean against the slopes, n ∝ (−∂h/∂x, −∂h/∂y, 1), agree. Both possible mistakes change signs: an inverted
displacement (dark is high) flips both axes, a normal map with green downwards (DirectX) flips only y. So the sign along
x decides on the displacement, and then the sign along y on the normal map.
"""

from dataclasses import dataclass

import numpy as np

from bench.btf import Array

CLEAR = 0.2  # from this correlation on, the maps decide instead of their names; maps of one asset reach 0.6 to 0.9


@dataclass(frozen=True)
class Agreement:
    """Correlations of normals and slopes along x and y; 0 if there is nothing to compare. `depth` is the height of
    white over black, in widths of the picture, with which the slopes fit the normals best."""

    x: float = 0.0
    y: float = 0.0
    depth: float | None = None

    def verdict(self, named_depth: bool, normal_role: str) -> tuple[bool, bool]:
        """Whether the displacement is inverted (dark is high), and whether green points down; by names if unclear."""
        named_down = normal_role == "normal_dx"
        y = -self.y if named_down else self.y
        if abs(self.x) >= CLEAR:
            inverted = self.x < 0
            down = (self.y < 0) != inverted if abs(self.y) >= CLEAR else named_down
            return inverted, down
        if abs(y) >= CLEAR and normal_role != "normal":  # ridges only along x: use the normal map's name
            return y < 0, named_down
        return named_depth, named_down

    def evidence(self, normal_role: str) -> str:
        """The evidence for the verdict, in words."""
        if min(abs(self.x), abs(self.y)) >= CLEAR:
            return f"told by the displacement (r = {self.x:+.2f}, {self.y:+.2f})"
        return "assumed" if normal_role == "normal" else "by its name"


def agreement(normal: Array, height: Array) -> Agreement:
    """Compare unit normals (H, W, 3) with a displacement (H, W), periodic, of square texels, row 0 at the top."""
    cell = 1 / height.shape[1]
    slope_x = (np.roll(height, -1, 1) - np.roll(height, 1, 1)) / (2 * cell)
    slope_y = (np.roll(height, 1, 0) - np.roll(height, -1, 0)) / (2 * cell)
    lean = -normal[..., :2] / np.maximum(normal[..., 2:], 0.1)
    x, y = _correlation(lean[..., 0], slope_x), _correlation(lean[..., 1], slope_y)
    if max(abs(x), abs(y)) < CLEAR:
        return Agreement(x, y)
    # Least squares of lean = depth · slope over both axes, whatever their signs.
    fit = abs((lean[..., 0] * slope_x).mean()) + abs((lean[..., 1] * slope_y).mean())
    return Agreement(x, y, float(fit / (slope_x**2 + slope_y**2).mean()))


def _correlation(a: Array, b: Array) -> float:
    a, b = a - a.mean(), b - b.mean()
    spread = np.sqrt((a * a).mean() * (b * b).mean())
    return float((a * b).mean() / spread) if spread > 1e-9 else 0.0
