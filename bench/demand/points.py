"""Holds the surface points that camera rays hit, and makes queries for each light there.

A point's frame follows its texture: x along +u, y toward +v, z is the normal, so a material has the orientation of its
picture.
"""

from dataclasses import dataclass

import numpy as np

from bench.btf import Array
from bench.demand.demand import FARTHEST, NAMES, unit


@dataclass(frozen=True)
class Points:
    """Visible points of the surface, float64; `ahead_x`, `ahead_y` point from the camera through the next pixels."""

    pixel: Array  # (n,) index into the frames, row by row
    uv: Array  # (n, 2) of the surface, not wrapped: a unit is the longer side of the texture
    position: Array  # (n, 3)
    normal: Array  # (n, 3) unit
    dp_du: Array  # (n, 3) derivative of the position by u
    dp_dv: Array  # (n, 3) derivative of the position by v
    eye: Array  # (n, 3) position of the camera
    ahead_x: Array  # (n, 3) direction through the pixel to the right
    ahead_y: Array  # (n, 3) direction through the pixel below

    def __len__(self) -> int:
        return len(self.pixel)

    def take(self, which: Array) -> "Points":
        """Some of the points, by index or mask."""
        return Points(*(value[which] for value in vars(self).values()))

    def local(self, directions: Array) -> Array:
        """Directions (n, 3) of the scene in the frame of each point."""
        x = unit(self.dp_du - self.normal * _dot(self.normal, self.dp_du))
        y = np.cross(self.normal, x)
        y *= np.where(_dot(y, self.dp_dv) < 0, -1.0, 1.0)  # a mirrored texture
        return np.stack([(directions * axis).sum(-1) for axis in (x, y, self.normal)], -1)

    @property
    def wo(self) -> Array:
        """The direction to the camera (n, 3), in the frame of each point."""
        return self.local(unit(self.eye - self.position))

    @property
    def footprint(self) -> Array:
        """The longer side (n,) of a pixel on the surface, in units of uv: the footprint for isotropic filtering."""
        sides = [np.linalg.norm(self._uv_of(self._moved(ahead)), axis=1) for ahead in (self.ahead_x, self.ahead_y)]
        return np.minimum(np.maximum(*sides), FARTHEST)

    def _moved(self, ahead: Array) -> Array:
        """The step (n, 3) from each point to where the ray of a neighbouring pixel meets its tangent plane."""
        along = _dot(ahead, self.normal)
        with np.errstate(divide="ignore", invalid="ignore"):
            moved = self.eye + ahead * (_dot(self.position - self.eye, self.normal) / along) - self.position
        beyond = ~(np.isfinite(moved).all(-1)) | (((moved + self.position - self.eye) * ahead).sum(-1) <= 0)
        return np.where(beyond[:, None], self.dp_du * FARTHEST, moved)

    def _uv_of(self, moved: Array) -> Array:
        """The change of uv (n, 2) of a step (n, 3) within the surface, by least squares."""
        a, b = self.dp_du, self.dp_dv
        uu, uv, vv, u, v = (_dot(*pair)[:, 0] for pair in ((a, a), (a, b), (b, b), (moved, a), (moved, b)))
        return np.stack([u * vv - v * uv, v * uu - u * uv], -1) / (uu * vv - uv * uv)[:, None]


def _dot(a: Array, b: Array) -> Array:
    return (a * b).sum(-1, keepdims=True)


@dataclass(frozen=True)
class Light:
    """Light at some points from one light, or from one sample of it: its direction, and RGB irradiance facing it."""

    toward: Array  # (n, 3) unit
    irradiance: Array  # (n, 3)


def queries_of(points: Points, lights: list[Light]) -> dict[str, Array]:
    """The queries of some points under some lights, as the columns of `Demand`. Leaves out queries at or below a
    horizon, and unlit ones."""
    wo, footprint = points.wo, points.footprint
    parts = []
    for light in lights:
        wi = points.local(light.toward)
        seen = (wo[:, 2] > 0) & (wi[:, 2] > 0) & (light.irradiance > 0).any(1)
        some = np.flatnonzero(seen)
        parts.append((points.uv[some], footprint[some], wo[some], wi[some], light.irradiance[some], points.pixel[some]))
    columns = {name: np.concatenate(each) for name, each in zip(NAMES, zip(*parts, strict=True), strict=True)}
    return {name: each.astype(np.int32 if name == "pixel" else np.float32) for name, each in columns.items()}
