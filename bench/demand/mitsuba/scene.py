"""Casts the rays of a Mitsuba 3 scene, an XML file, at the surfaces of one BSDF: see `bench.demand.collect`.

Each sensor of the file is a frame, so a camera's path is a list of sensors. Only direct light from emitters counts,
with its shadows; light reflected by other surfaces does not. A unit of a shape's uv is the longer side of the texture.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from bench.btf import Array
from bench.demand.collect import Light, Points
from bench.inputs.errors import InputError, did_you_mean
from bench.program.llvm import unusable

SAMPLES = 8  # of an extended emitter, at each visible point

Values = Any  # Dr.Jit arrays


class MitsubaScene:
    """A loaded scene that answers what its sensors see of the BSDF with one id, and which light reaches it."""

    def __init__(self, path: Path, bsdf: str):
        """Load a scene, and find the BSDF with the id `bsdf`. `InputError` says what is wrong with the file.

        Sets Mitsuba's variant.
        """
        set_variant()
        self.name = path.stem
        self.scene = loaded(path, lambda: mi.load_file(str(path)))
        self.sensors = self.scene.sensors()
        if any(sample_angle(sensor, samples=1) == 0 for sensor in self.sensors):  # `Points` has an eye for each frame
            raise InputError(f"{path}: the rays of a sensor are parallel: give it a perspective camera")
        self.bsdf = _chosen(self.scene, path, bsdf)
        sizes = {tuple(map(int, sensor.film().crop_size())) for sensor in self.sensors}
        if len(sizes) > 1:
            raise InputError(f"{path}: its sensors differ in size: give all of them one width and one height")
        ((width, height),) = sizes
        self.frames = len(self.sensors)
        self.picture = (height, width)
        self.emitters: list[tuple[Values, int]] = []  # each with the number of samples that it takes at a point
        for emitter in self.scene.emitters():
            from_one_place = mi.has_flag(emitter.flags(), mi.EmitterFlags.Delta)  # a point or a direction
            self.emitters.append((emitter, 1 if from_one_place else SAMPLES))
        if not self.emitters:
            raise InputError(f"{path}: it has no emitter, so nothing lights the material: add one")
        self.samples = sum(count for _, count in self.emitters)

    def cast(self, frame: int, col: Array, row: Array) -> Points:
        """What a sensor sees of the BSDF's surfaces, through points (n,) of the picture, in pixels."""
        sensor = self.sensors[frame]
        height, width = self.picture

        def rays_through(col: Array, row: Array) -> Values:
            """Rays through points of the picture, in pixels; Mitsuba takes them as shares of it."""
            place = mi.Point2f(mi.Float(col / width), mi.Float(row / height))
            rays, _ = sensor.sample_ray(0.0, 0.5, place, mi.Point2f(0.5, 0.5))  # time, wavelength, place, lens
            return rays

        rays, right, below = rays_through(col, row), rays_through(col + 1, row), rays_through(col, row + 1)
        hit = self.scene.ray_intersect(rays)
        hits_bsdf = hit.is_valid() & (hit.bsdf() == mi.BSDFPtr(self.bsdf))
        chosen = np.flatnonzero(np.asarray(hits_bsdf))
        position = _rows(hit.p)
        normal = _rows(hit.sh_frame.n)
        eye = np.broadcast_to(np.asarray(sensor.world_transform().translation()).ravel(), position.shape)
        return Points(
            pixel=chosen,  # the numbers of the rays that hit; one is cast through each cell of the frame
            uv=_rows(hit.uv)[chosen],
            position=position[chosen],
            normal=normal[chosen],
            dp_du=_rows(hit.dp_du)[chosen],
            dp_dv=_rows(hit.dp_dv)[chosen],
            eye=eye[chosen],
            ahead_x=_rows(right.d)[chosen],
            ahead_y=_rows(below.d)[chosen],
        )

    def lights(self, points: Points, rng: np.random.Generator) -> list[Light]:
        """Every emitter that reaches the points without a shadow; for extended emitters, a few samples."""
        here = dr.zeros(mi.SurfaceInteraction3f, len(points))
        here.p, here.n = _vector(mi.Point3f, points.position), _vector(mi.Normal3f, points.normal)
        samples = []
        for emitter, count in self.emitters:
            for _ in range(count):
                chance = mi.Point2f(mi.Float(rng.random(len(points))), mi.Float(rng.random(len(points))))
                toward, arriving = emitter.sample_direction(here, chance)
                free = ~self.scene.ray_test(here.spawn_ray_to(toward.p))
                irradiance = _rows(arriving) * np.asarray(free)[:, None] / count
                samples.append(Light(_rows(toward.d), np.nan_to_num(irradiance)))  # of NaN, no light
        return samples


def loaded(path: Path, load: Callable[[], Values]) -> Values:
    """The scene that `load` reads from a file. `InputError` if Mitsuba cannot load it, or if it has no sensor."""
    try:
        scene = load()
    except Exception as error:  # Mitsuba raises RuntimeError for any fault in a file
        message = " ".join(str(error).split())[:300]
        raise InputError(f"{path}: Mitsuba cannot load it: {message}") from error
    if not scene.sensors():
        raise InputError(f"{path}: it has no sensor: add a camera")
    return scene


def sample_angle(sensor: Values, samples: int | None) -> float:
    """The angle that one sample of the pixel in the middle covers, in radians; 0 if all rays are parallel.

    The samples of a pixel share its area, so each has a side 1 / √samples as long. None: the sensor says how many.
    """
    middle = mi.Point2f(0.5, 0.5)
    # Arguments: time, wavelength, place in the picture, place on the lens. The second result is the ray's importance.
    ray, _ = sensor.sample_ray_differential(0.0, 0.5, middle, middle)
    apart = dr.maximum(dr.norm(ray.d_x - ray.d), dr.norm(ray.d_y - ray.d))
    return float(apart[0]) / math.sqrt(samples or sensor.sampler().sample_count())


def set_variant() -> None:
    """Make the fastest variant that can cast many rays at once Mitsuba's current one. `InputError` if none works
    here."""
    if "cuda_ad_rgb" in mi.variants() and dr.has_backend(dr.JitBackend.CUDA):
        mi.set_variant("cuda_ad_rgb")
        return
    reason = unusable(plugins=True)
    if reason:
        raise InputError(f"Mitsuba finds no CUDA device, and {reason}")
    mi.set_variant("llvm_ad_rgb")


def _chosen(scene: Values, path: Path, bsdf: str) -> Values:
    """The BSDF of that id. `InputError` if no shape has it, or if a shape that has it lacks texture coordinates."""
    shapes = [shape for shape in scene.shapes() if shape.bsdf() is not None]
    ids = {shape.bsdf().id() for shape in shapes}
    if bsdf not in ids:
        names = ", ".join(sorted(ids)) or "none"
        raise InputError(f"{path}: no shape has a BSDF with the id {bsdf!r}{did_you_mean(bsdf, ids)} (there: {names})")
    shapes_with_bsdf = [shape for shape in shapes if shape.bsdf().id() == bsdf]
    for shape in shapes_with_bsdf:
        if shape.is_mesh() and not shape.has_vertex_texcoords():
            raise InputError(f"{path}: shape {shape.id()!r} has no texture coordinates: give its mesh uv")
    return shapes_with_bsdf[0].bsdf()


def _rows(values: Values) -> Array:
    """Dr.Jit vectors as rows (n, k) float64."""
    return np.asarray(values, np.float64).T


def _vector(kind: Values, rows: Array) -> Values:
    """Rows (n, k) as Dr.Jit vectors of some kind."""
    return kind(*(mi.Float(column) for column in rows.T))
