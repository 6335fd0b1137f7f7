"""Casts the rays of a scene that was read from a text: see `bench.demand.scene`."""

import numpy as np

from bench.btf import Array
from bench.demand.demand import unit
from bench.demand.points import Light, Points
from bench.demand.scene import Lamp, LightSource, Scene
from bench.demand.shapes import distance, texture


class TextScene:
    """A scene of one surface that answers what its camera sees, and which light reaches it."""

    def __init__(self, scene: Scene):
        self.scene = scene
        self.name, self.frames = scene.name, len(scene.cameras)
        self.picture = (scene.cameras[0].height, scene.cameras[0].width)
        self.samples = sum(light.samples if light.kind == "environment" else 1 for light in scene.lights)

    def cast(self, frame: int, col: Array, row: Array) -> Points:
        """The points of the surface that the camera sees in a frame, through points (n,) of the picture, in pixels."""
        camera = self.scene.cameras[frame]
        ahead = camera.ahead(col, row)
        eye = np.asarray(camera.position, np.float64)
        far = distance(self.scene.surface, eye, ahead)
        hit = np.flatnonzero(np.isfinite(far))
        position = eye + ahead[hit] * far[hit, None]
        uv, normal, dp_du, dp_dv, inside = texture(self.scene.surface, position)
        hit = hit[inside]
        uv, position, normal, dp_du, dp_dv = (value[inside] for value in (uv, position, normal, dp_du, dp_dv))
        neighbours = camera.ahead(col[hit] + 1, row[hit]), camera.ahead(col[hit], row[hit] + 1)
        return Points(hit, uv, position, normal, dp_du, dp_dv, np.broadcast_to(eye, position.shape), *neighbours)

    def lights(self, points: Points, rng: np.random.Generator) -> list[Light]:
        """Every light that may reach the points; for an environment, a few samples at each."""
        return [light for source in self.scene.lights for light in _reaching(source, points, rng)]


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
    lamps = [Lamp((0.0, 0.0, 1.0), 180.0, source.radiance or (0.0, 0.0, 0.0)), *source.lamps]
    angles = np.radians([lamp.cone_deg for lamp in lamps])
    solid = 2 * np.pi * (1 - np.cos(angles))
    power = solid * [np.mean(lamp.radiance) for lamp in lamps]
    shares = power / power.sum()
    chosen = rng.choice(len(lamps), len(points), p=shares)
    for index, lamp in enumerate(lamps):
        here = np.flatnonzero(chosen == index)
        if len(here):
            toward[here] = _in_cone(unit(np.asarray(lamp.toward)), angles[index], len(here), rng)
            irradiance[here] = np.asarray(lamp.radiance) * solid[index] / shares[index]
    return Light(toward, irradiance / source.samples)


def _in_cone(axis: Array, angle: float, count: int, rng: np.random.Generator) -> Array:
    """Directions (count, 3) uniform in solid angle within an angle of an axis."""
    cos = 1 - rng.random(count) * (1 - np.cos(angle))
    phi = rng.random(count) * 2 * np.pi
    sin = np.sqrt(np.maximum(1 - cos**2, 0))
    across = unit(np.cross(axis, [0.0, 0.0, 1.0] if abs(axis[2]) < 0.9 else [1.0, 0.0, 0.0]))
    other = np.cross(axis, across)
    return cos[:, None] * axis + (sin * np.cos(phi))[:, None] * across + (sin * np.sin(phi))[:, None] * other
