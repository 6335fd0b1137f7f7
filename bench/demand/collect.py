"""Collects the demand of a scene, with any ray caster, within a limit of queries.

A caster gives the points of the surface that camera rays hit, and the lights there; each light makes a query of each
point. A point's frame follows its texture: x along +u, y toward +v, z is the normal, so a material has the orientation
of its picture.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from bench.btf import Array
from bench.codec import Progress, followed, silent
from bench.demand.demand import CELLS, FARTHEST, NAMES, SNORM, Demand, is_lit, unit
from bench.inputs.errors import InputError

QUERIES = 250_000  # the most queries of a demand that a command collects
PREVIEW = 96  # cells along the longer side of the first picture, which estimates how much of it shows the material
FRAME = 1 << 21  # cells of one frame: its rays are cast at once
SPARE = 0.97  # share of the limit to aim at, because the first picture is coarse


@dataclass(frozen=True)
class Points:
    """Visible points of the surface, float64; `ahead_x`, `ahead_y` point from the camera through the next pixels."""

    pixel: Array  # (n,) the number of the ray that met each point
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

    @cached_property
    def axes(self) -> tuple[Array, Array, Array]:
        """The axes of the frame of each point, unit (n, 3): along +u, toward +v, and the normal."""
        x = unit(self.dp_du - self.normal * _dot(self.normal, self.dp_du))
        y = np.cross(self.normal, x)
        y *= np.where(_dot(y, self.dp_dv) < 0, -1.0, 1.0)  # where the texture is mirrored, so that y is toward +v
        return x, y, self.normal

    def local(self, directions: Array) -> Array:
        """Directions (n, 3) of the scene in the frame of each point."""
        return np.stack([(directions * axis).sum(-1) for axis in self.axes], -1)

    @property
    def wo(self) -> Array:
        """The direction to the camera (n, 3), in the frame of each point."""
        return self.local(unit(self.eye - self.position))

    @property
    def footprint(self) -> Array:
        """The longer side (n,) of a pixel on the surface, in units of uv: the footprint for isotropic filtering."""
        across = np.linalg.norm(self._uv_change(self._step_ahead(self.ahead_x)), axis=1)
        down = np.linalg.norm(self._uv_change(self._step_ahead(self.ahead_y)), axis=1)
        return np.minimum(np.maximum(across, down), FARTHEST)

    def _step_ahead(self, ahead: Array) -> Array:
        """The step (n, 3) from each point to where the ray of a neighbouring pixel meets its tangent plane."""
        along = _dot(ahead, self.normal)
        with np.errstate(divide="ignore", invalid="ignore"):  # a ray along the plane meets it nowhere
            distance = _dot(self.position - self.eye, self.normal) / along
            moved = self.eye + ahead * distance - self.position
        behind = ((moved + self.position - self.eye) * ahead).sum(-1) <= 0  # the plane is met behind the camera
        misses = ~np.isfinite(moved).all(-1) | behind
        # Such a pixel reaches the horizon, where it has the largest footprint.
        return np.where(misses[:, None], self.dp_du * FARTHEST, moved)

    def _uv_change(self, moved: Array) -> Array:
        """The change of uv (n, 2) of a step (n, 3) within the surface, by least squares."""
        # The normal equations: products (n, 1) of the two derivatives with each other, and with the step. They are two
        # equations for two unknowns, which Cramer's rule solves.
        dot_uu = _dot(self.dp_du, self.dp_du)
        dot_uv = _dot(self.dp_du, self.dp_dv)
        dot_vv = _dot(self.dp_dv, self.dp_dv)
        step_u = _dot(moved, self.dp_du)
        step_v = _dot(moved, self.dp_dv)
        change_u = step_u * dot_vv - step_v * dot_uv
        change_v = step_v * dot_uu - step_u * dot_uv
        return np.concatenate([change_u, change_v], 1) / (dot_uu * dot_vv - dot_uv * dot_uv)


def _dot(a: Array, b: Array) -> Array:
    """The dot product (n, 1) of each row of `a` (n, 3) with the same row of `b` (n, 3)."""
    return (a * b).sum(-1, keepdims=True)


@dataclass(frozen=True)
class Light:
    """Light at some points from one light, or from one sample of it: its direction, and RGB irradiance facing it."""

    toward: Array  # (n, 3) unit
    irradiance: Array  # (n, 3)


def queries_of(points: Points, lights: list[Light]) -> dict[str, Array]:
    """The queries of some points under some lights, as the columns of `Demand`: one for each point and light, without
    those whose view or light is at or below the horizon, and unlit ones."""
    parts: list[dict[str, Array]] = []
    wo, footprint = points.wo, points.footprint
    for light in lights:
        wi = points.local(light.toward)
        # The normal is z, so a direction is above the horizon where its z is above 0.
        is_seen_and_lit = (wo[:, 2] > 0) & (wi[:, 2] > 0) & (light.irradiance > 0).any(1)
        chosen = np.flatnonzero(is_seen_and_lit)
        parts.append(
            {
                "place": points.uv[chosen],
                "footprint": footprint[chosen],
                "wo": wo[chosen],
                "wi": wi[chosen],
                "weight": light.irradiance[chosen],
                "pixel": points.pixel[chosen],
            }
        )
    columns = {}
    for name in NAMES:
        kind = np.int32 if name == "pixel" else np.float32
        columns[name] = np.concatenate([part[name] for part in parts]).astype(kind)
    return columns


class Caster(Protocol):
    """A scene that can cast camera rays and sample its lights."""

    name: str
    frames: int  # how many
    picture: tuple[int, int]  # height and width in pixels
    samples: int  # samples of the lights at each point

    def cast(self, frame: int, col: Array, row: Array) -> Points:
        """The points that the rays of a frame meet, through places (n,) of its picture, in pixels."""
        ...

    def lights(self, points: Points, rng: np.random.Generator) -> list[Light]:
        """The light that reaches the points: of each light, or of each of its samples, which add up to the light."""
        ...


def collect(scene: Caster, limit: int, seed: int = 0, show: Progress = silent) -> Demand:
    """The queries of every frame of a scene, at most `limit`.

    If all pixels together need more, the picture is divided into larger cells, and one ray is cast through a random
    point of each. The frames are then smaller than the picture; footprints stay those of its pixels. `InputError` if
    no ray finds the material, or no light reaches the visible part.
    """
    size = _frame_size(scene, limit)
    cells = size[0] * size[1]
    rng = np.random.default_rng(seed)
    parts = []
    for frame in followed(show, range(scene.frames), "casting rays", scene.frames):
        col, row = _points_of_cells(scene.picture, size, rng)
        points = scene.cast(frame, col, row)
        if len(points):
            queries = queries_of(points, scene.lights(points, rng))
            queries["pixel"] += frame * cells  # pixels are numbered on from frame to frame
            parts.append(queries)
    if not parts:
        raise InputError(f"{scene.name}: too few rays hit the material: move the camera nearer")
    columns: dict[str, Any] = {}
    for name in NAMES:
        columns[name] = np.concatenate([part[name] for part in parts])
    if not is_lit(columns["weight"], np.round(columns["wi"] * SNORM)):  # as a file will hold them
        raise InputError(f"{scene.name}: no light reaches the side of the material that the camera sees: move a light")
    provenance = {"scene": scene.name, "picture": list(scene.picture), "limit": limit, "seed": seed}
    demand = Demand(**columns, frames=(scene.frames, *size), provenance=provenance)
    if len(demand) > limit:  # the size was only an estimate
        return demand.thinned(limit, rng)
    return demand


def _frame_size(scene: Caster, limit: int) -> tuple[int, int]:
    """Height and width of the frames that make about `limit` queries, at most those of the picture."""
    height, width = scene.picture
    of_limit = SPARE * limit / (_pixels_shown(scene) * scene.samples)  # of the queries that all pixels would make
    of_memory = min(FRAME, CELLS // scene.frames) / (height * width)
    # These are shares of the pixels; each of the two sides shrinks by the root.
    scale = min(1.0, math.sqrt(of_limit), math.sqrt(of_memory))
    return max(1, int(height * scale)), max(1, int(width * scale))


def _pixels_shown(scene: Caster) -> float:
    """About how many pixels of all frames show the material, by a coarse preview of each.

    `InputError` if no ray of it finds the material.
    """
    height, width = scene.picture
    shrink = min(1.0, PREVIEW / max(height, width))
    preview_height = max(1, round(height * shrink))
    preview_width = max(1, round(width * shrink))
    rng = np.random.default_rng(0)
    shown = []
    for frame in range(scene.frames):
        col, row = _points_of_cells(scene.picture, (preview_height, preview_width), rng)
        shown.append(len(scene.cast(frame, col, row)))
    if not any(shown):
        where = "it is behind the camera, out of the picture, or hidden: move the camera or the material"
        raise InputError(f"{scene.name}: no ray of the camera finds the material: {where}")
    return sum(shown) / (preview_height * preview_width) * height * width


def _points_of_cells(picture: tuple[int, int], size: tuple[int, int], rng: np.random.Generator) -> tuple[Array, Array]:
    """Column and row (H · W,), in pixels, of a point in each of `size` (H, W) cells that divide a picture.

    If the cells are its pixels, the point is the middle of each, else a random one: a regular grid would hit the same
    texels of a regular texture again and again.
    """
    row, col = np.mgrid[: size[0], : size[1]]  # (H, W) each, in cells
    down, across = (0.5, 0.5) if size == picture else rng.random((2, *size))  # from the corner of each cell
    rows_a_cell = picture[0] / size[0]
    cols_a_cell = picture[1] / size[1]
    return ((col + across) * cols_a_cell).ravel(), ((row + down) * rows_a_cell).ravel()
