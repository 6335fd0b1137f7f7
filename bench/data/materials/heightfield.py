"""A periodic height field: its intersections with a bundle of parallel rays, and its shadows under a distant light.

All rays of a view are parallel and start on a regular grid, so one marching step of the whole bundle is a shift of the
height map, and no scattered reads are needed. Heights and grid cells are in units of the picture's width, heights
relative to the reference plane z = 0, the mean. Grid row i has its centre at y = (H − i − 0.5) · cell_y: rows grow
downwards, y up.
"""

import math

import numpy as np

from bench.btf import Array


class HeightField:
    """`height` is (H, W) float32, periodic; `aspect` is the picture's physical height over its width."""

    def __init__(self, height: Array, aspect: float):
        above = height - height.min()  # exactly 0 on a plane of any height
        self.height = np.ascontiguousarray(above - above.mean(dtype=np.float64), np.float32)
        self.shape = self.height.shape
        self.cell = (aspect / self.shape[0], 1 / self.shape[1])
        self.bottom, self.top = float(self.height.min()), float(self.height.max())
        # Doubled so that any shift of the whole field is one view of this array.
        self._tiled = np.pad(np.tile(self.height, (2, 2)), ((0, 1), (0, 1)), mode="wrap")

    def normals(self) -> Array:
        """Unit normals (3, H, W) float32 from central differences."""
        h = self.height.astype(np.float64)
        dx = (np.roll(h, -1, 1) - np.roll(h, 1, 1)) / (2 * self.cell[1])
        dy = (np.roll(h, 1, 0) - np.roll(h, -1, 0)) / (2 * self.cell[0])
        normal = np.stack([-dx, -dy, np.ones_like(h)])
        return (normal / np.linalg.norm(normal, axis=0)).astype(np.float32)

    def trace(self, wo: Array, stride: tuple[int, int]) -> Array:
        """Height (H / stride, W / stride) above the reference plane at which each ray first meets the surface.

        Ray (i, j) passes through the centre of the block (i, j) of stride grid cells on the reference plane, along `wo`
        (unit, z > 0). It meets the surface at that centre + z · `offset(wo)`.
        """
        per_height = self.offset(wo)
        steps = math.ceil((self.top - self.bottom) * max(map(abs, per_height)))
        if steps == 0:
            return self._along((0.0, 0.0), 0.0, stride)
        step = (self.top - self.bottom) / steps
        before = self._along(per_height, self.top, stride) - np.float32(self.top)
        hit = np.full(before.shape, self.bottom, np.float32)
        alive = np.ones(before.shape, bool)
        for k in range(1, steps + 1):
            z = self.top - k * step
            above = self._along(per_height, z, stride) - np.float32(z)
            crossed = np.flatnonzero((above >= 0) & alive)
            if len(crossed):
                a, b = above.flat[crossed], before.flat[crossed]
                hit.flat[crossed] = z + step * a / np.maximum(a - b, 1e-20)
                alive.flat[crossed] = False
                if not alive.any():
                    break
            before = above
        return hit

    def offset(self, direction: Array) -> tuple[float, float]:
        """(rows, columns) of the grid that a ray along `direction` crosses while it rises by one unit of height."""
        x, y, z = (float(v) for v in direction)
        return -y / z / self.cell[0], x / z / self.cell[1]

    def _along(self, per_height: tuple[float, float], z: float, stride: tuple[int, int]) -> Array:
        """Bilinear heights under the whole bundle of rays at height z of the march."""
        (H, W), (sr, sc) = self.shape, stride
        row = ((sr - 1) / 2 + z * per_height[0]) % H
        col = ((sc - 1) / 2 + z * per_height[1]) % W
        r, c = int(row) % H, int(col) % W
        fr, fc = np.float32(row % 1), np.float32(col % 1)
        tiles = self._tiled
        low = tiles[r : r + H : sr, c : c + W : sc] * ((1 - fr) * (1 - fc))
        for dr, dc, weight in ((0, 1, (1 - fr) * fc), (1, 0, fr * (1 - fc)), (1, 1, fr * fc)):
            if weight:
                low += tiles[r + dr : r + dr + H : sr, c + dc : c + dc + W : sc] * weight
        return low

    def visibility(self, wi: Array) -> Array:
        """The share (H, W) of the light from `wi` that reaches each grid point, uint8 with 255 for all of it.

        The horizon, the maximum over j ≥ 1 of h(p + jδ) − jc with c the rise of the light's ray over a step δ of one
        cell, is built by doubling: M₂ₙ(p) = max(Mₙ(p), Mₙ(p + nδ) − nc). A shadow's edge is a ramp of half a step.
        """
        rows, cols = self.offset(wi)
        longest = max(abs(rows), abs(cols))
        if (self.top - self.bottom) * longest <= 1:
            return np.full(self.shape, 255, np.uint8)
        rise = 1 / longest
        rows, cols = rows * rise, cols * rise
        horizon = shift(self.height, rows, cols) - np.float32(rise)
        reached = 1
        while reached * rise < self.top - self.bottom:
            further = shift(horizon, reached * rows, reached * cols) - np.float32(reached * rise)
            np.maximum(horizon, further, out=horizon)
            reached *= 2
        lit = 1 + (self.height - horizon) / np.float32(0.5 * rise)
        return (np.clip(lit, 0, 1) * 255 + 0.5).astype(np.uint8)


def shift(field: Array, rows: float, cols: float) -> Array:
    """The periodic field (H, W) read at (row + rows, column + cols), bilinear."""
    return _shift_axis(_shift_axis(field, rows, 0), cols, 1)


def _shift_axis(field: Array, by: float, axis: int) -> Array:
    whole = math.floor(by)
    low = np.roll(field, -whole, axis)
    if by == whole:
        return low
    low += (np.roll(field, -whole - 1, axis) - low) * np.float32(by - whole)
    return low
