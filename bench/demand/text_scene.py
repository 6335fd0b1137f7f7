"""Casts the rays of a scene that was read from a text: see `bench.demand.scene`."""

import numpy as np

from bench.demand.demand import unit
from bench.demand.points import Array, Light, Points
from bench.demand.scene import LightSource, Scene, Surface


class TextScene:
    """A scene of one surface, ready to be asked what its camera sees and what lights it."""

    def __init__(self, scene: Scene):
        self.scene = scene
        self.name, self.frames = scene.name, len(scene.cameras)
        self.picture = (scene.cameras[0].height, scene.cameras[0].width)
        self.samples = sum(light.samples if light.kind == "environment" else 1 for light in scene.lights)

    def cast(self, frame: int, col: Array, row: Array) -> Points:
        """What the camera sees of the surface in a frame, through points (n,) of the picture, in pixels."""
        camera = self.scene.cameras[frame]
        ahead = camera.ahead(col, row)
        eye = np.asarray(camera.position, np.float64)
        distance = _plane_distance(self.scene.surface, eye, ahead)
        if self.scene.surface.shape == "sphere":
            distance = _sphere_distance(self.scene.surface, eye, ahead)
        hit = np.flatnonzero(np.isfinite(distance))
        position = eye + ahead[hit] * distance[hit, None]
        uv, normal, dp_du, dp_dv, inside = _texture(self.scene.surface, position)
        hit = hit[inside]
        kept = (value[inside] for value in (uv, position, normal, dp_du, dp_dv))
        uv, position, normal, dp_du, dp_dv = kept
        neighbours = camera.ahead(col[hit] + 1, row[hit]), camera.ahead(col[hit], row[hit] + 1)
        return Points(hit, uv, position, normal, dp_du, dp_dv, np.broadcast_to(eye, position.shape), *neighbours)

    def lights(self, points: Points, rng: np.random.Generator) -> list[Light]:
        """Every light that may reach the points; of an environment a few samples each."""
        return [light for source in self.scene.lights for light in _reaching(source, points, rng)]


def _axes(surface: Surface) -> tuple[Array, Array, Array]:
    """Unit vectors along +u, +v and the normal of a plane; of a sphere two across its axis, and the axis."""
    normal = unit(np.asarray(surface.normal, np.float64))
    x = unit(np.cross(surface.up, normal))
    return x, np.cross(normal, x), normal


def _plane_distance(surface: Surface, eye: Array, ahead: Array) -> Array:
    normal = _axes(surface)[2]
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (np.asarray(surface.centre) - eye) @ normal / (ahead @ normal)
    return np.where(distance > 0, distance, np.inf)


def _sphere_distance(surface: Surface, eye: Array, ahead: Array) -> Array:
    """The nearer of the two crossings, for a camera outside."""
    offset = eye - np.asarray(surface.centre)
    half = ahead @ offset
    with np.errstate(invalid="ignore"):
        distance = -half - np.sqrt(half**2 - (offset @ offset - surface.radius**2))
    return np.where(distance > 0, distance, np.inf)


def _texture(surface: Surface, position: Array) -> tuple[Array, Array, Array, Array, Array]:
    """uv (n, 2), normal, dp/du and dp/dv (n, 3) of points of a surface, and which of them lie on it (n,)."""
    x, y, axis = _axes(surface)
    local = (position - np.asarray(surface.centre)) @ np.stack([x, y, axis], 1)
    repeat = np.asarray(surface.repeat)
    if surface.shape == "plane":
        size = np.asarray(surface.size)
        uv = (local[:, :2] / size + 0.5) * repeat
        ones = np.ones((len(position), 1))
        step = size / repeat
        return uv, ones * axis, ones * x * step[0], ones * y * step[1], (np.abs(local[:, :2]) <= size / 2).all(1)
    east_angle, height = np.arctan2(local[:, 1], local[:, 0]), local[:, 2] / surface.radius
    north_angle = np.arcsin(np.clip(height, -1, 1))
    uv = np.stack([east_angle / (2 * np.pi) + 0.5, north_angle / np.pi + 0.5], 1) * repeat
    east = -np.sin(east_angle)[:, None] * x + np.cos(east_angle)[:, None] * y
    normal = unit(position - np.asarray(surface.centre))
    north = np.cross(normal, east)
    # The poles have no east; a ring of a thousandth of the radius around them is left out.
    ring = np.hypot(local[:, 0], local[:, 1]) / surface.radius
    per_u = 2 * np.pi * surface.radius * ring / repeat[0]
    return uv, normal, east * per_u[:, None], north * np.pi * surface.radius / repeat[1], ring > 1e-3


def _reaching(source: LightSource, points: Points, rng: np.random.Generator) -> list[Light]:
    ones = np.ones((len(points), 1))
    match source.kind:
        case "directional":
            return [Light(ones * unit(np.asarray(source.toward)), ones * np.asarray(source.irradiance))]
        case "point":
            offset = np.asarray(source.position) - points.position
            square = np.maximum((offset**2).sum(1, keepdims=True), 1e-12)
            return [Light(offset / np.sqrt(square), np.asarray(source.intensity) / square)]
        case _:
            return [_environment_sample(source, points, rng) for _ in range(source.samples)]


def _environment_sample(source: LightSource, points: Points, rng: np.random.Generator) -> Light:
    """One sample of an environment at each point: the sphere, or one of the lamps, in proportion to their power."""
    toward, irradiance = np.zeros((2, len(points), 3))
    solid = [2 * np.pi * (1 - np.cos(np.radians(lamp.cone_deg))) for lamp in source.lamps]
    radiance = [np.asarray(lamp.radiance) for lamp in source.lamps]
    around = np.asarray(source.radiance or (0.0, 0.0, 0.0))
    power = np.array([4 * np.pi * around.mean(), *(s * r.mean() for s, r in zip(solid, radiance, strict=True))])
    chosen = rng.choice(len(power), len(points), p=power / power.sum())
    for index, share in enumerate(power / power.sum()):
        here = np.flatnonzero(chosen == index)
        if not len(here):
            continue
        if index:
            lamp = source.lamps[index - 1]
            toward[here] = _in_cone(unit(np.asarray(lamp.toward)), np.radians(lamp.cone_deg), len(here), rng)
            irradiance[here] = radiance[index - 1] * solid[index - 1] / share
        else:
            toward[here] = _in_cone(np.array([0.0, 0.0, 1.0]), np.pi, len(here), rng)
            irradiance[here] = around * 4 * np.pi / share
    return Light(toward, irradiance / source.samples)


def _in_cone(axis: Array, angle: float, count: int, rng: np.random.Generator) -> Array:
    """Directions (count, 3) uniform in solid angle within an angle of an axis."""
    cos = 1 - rng.random(count) * (1 - np.cos(angle))
    phi = rng.random(count) * 2 * np.pi
    sin = np.sqrt(np.maximum(1 - cos**2, 0))
    across = unit(np.cross(axis, [0.0, 0.0, 1.0] if abs(axis[2]) < 0.9 else [1.0, 0.0, 0.0]))
    other = np.cross(axis, across)
    return cos[:, None] * axis + (sin * np.cos(phi))[:, None] * across + (sin * np.sin(phi))[:, None] * other
