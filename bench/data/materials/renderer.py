"""Renders slices of a BTF from maps and directions: primary visibility with parallax, one light, self-shadowing.

A value is the mean of f_r · (n·ω_i)⁺ · V over the fixed sub-points of a texel: the radiance leaving toward ω_o per unit
irradiance on a plane that faces the light. Texel (row, col) is viewed through its place on the reference plane, the
mean height, as in rectified measurements. Only direct light counts: there is no inter-reflection.
"""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from bench.btf import Array
from bench.data.materials import brdf
from bench.data.materials.heightfield import HeightField
from bench.data.materials.maps import Maps
from bench.inputs.errors import InputError
from bench.machine.threads import cores

if TYPE_CHECKING:
    from bench.codec import Progress

DESCRIBED = {
    "values": "linear Rec. 709, f_r * cos(theta_i) * visibility, mean over the sub-points, no clamp",
    "reference_plane": "mean height",
    "transport": "direct light, self-shadowing; no inter-reflection",
    "reflectance": "GGX (Walter 2007, Burley 2012), Smith (Heitz 2014), Schlick Fresnel, coupled Lambert",
}
RENDERER_VERSION = 3  # increment when a value changes; part of the key of every cached rendering
SUB_POINTS = 2  # along each side of a texel


@dataclass(frozen=True)
class View:
    """The visible points of one view: a point for each sub-point s of each texel, in the order (s, H · W)."""

    wo: Array
    points: brdf.Points
    frame: Array  # (3 components, 3 axes t b n, s, H · W)
    cell: Array  # (s, H · W) grid cell of each point, for visibility


class Renderer:
    """A surface prepared to render pictures of `size` (H, W), each texel the mean of sub_points² fixed sub-points.

    The maps are resized to a working grid that is a whole multiple of the sub-points; shrink maps that are much finer
    than the sub-points first (`Maps.resized`), or their detail is aliased.
    """

    def __init__(self, maps: Maps, size: tuple[int, int], sub_points: int = 2):
        if min(*size, sub_points) < 1:
            raise InputError(f"size and sub_points must be at least 1, not {size}, {sub_points}")
        self.size, self.sub_points = size, sub_points
        rays = [side * sub_points for side in size]
        stride = [math.ceil(m / r) for m, r in zip(maps.shape, rays, strict=True)]
        self.stride = (stride[0], stride[1])
        self.aspect = maps.shape[0] / maps.shape[1]
        maps = maps.resized((rays[0] * stride[0], rays[1] * stride[1]))
        self.field = HeightField(maps.height, self.aspect)
        # All values of a surface point in one table, (H' · W', 12), so that one read fetches a whole point.
        normal = self.field.normals() if maps.normal is None else np.moveaxis(maps.normal, -1, 0)
        base = np.moveaxis(maps.base_colour, -1, 0)
        rest = [maps.roughness, maps.metalness, maps.specular, maps.anisotropy]
        direction = [np.cos(2 * maps.angle), np.sin(2 * maps.angle)]
        self._table = np.stack([*normal, *base, *rest, *direction], -1).reshape(-1, 12).astype(np.float32)

    def view(self, wo: Array) -> View:
        """Trace the rays toward `wo` (3,) and look up the surface where they meet it."""
        z = self.field.trace(wo, self.stride)
        starts = [np.arange(n, dtype=np.float32) * s + (s - 1) / 2 for n, s in zip(z.shape, self.stride, strict=True)]
        rows, cols = self.field.offset(wo)
        # Fractional grid row and column where the ray of each sub-point ends.
        row = self._by_sub_point(starts[0][:, None] + z * np.float32(rows))
        col = self._by_sub_point(starts[1][None, :] + z * np.float32(cols))
        sampled = _bilinear(self._table, self.field.shape, row, col)
        normal, base = sampled[:3], sampled[3:6]
        normal = normal / np.sqrt((normal * normal).sum(0))
        angle = 0.5 * np.arctan2(sampled[11], sampled[10])
        flat = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])
        tangent = flat - normal * (flat * normal).sum(0)  # the direction in the plane, dropped onto the surface
        tangent /= np.sqrt(np.maximum((tangent * tangent).sum(0), 1e-12))
        frame = np.stack([tangent, np.cross(normal, tangent, axis=0), normal], 1)
        names = ("roughness", "metalness", "specular", "anisotropy")
        surface = dict(zip(names, sampled[6:10], strict=True), base=base)
        H, W = self.field.shape
        cell = np.floor(row + 0.5).astype(np.intp) % H * W + np.floor(col + 0.5).astype(np.intp) % W
        return View(wo, brdf.points(_project(frame, wo), surface), frame, cell)

    def _by_sub_point(self, picture: Array) -> Array:
        """(H · s, W · s) → (s², H · W)."""
        (H, W), s = self.size, self.sub_points
        return picture.reshape(H, s, W, s).transpose(1, 3, 0, 2).reshape(s * s, H * W)

    def slice(self, view: View, wi: Array, light: Array) -> Array:
        """The picture (H, W, 3) float32 of one pair, linear Rec. 709, f_r · cos θ_i · V; V is `light`, see
        `HeightField.visibility`."""
        at = view.points
        cos_between = np.float32(view.wo @ wi)
        through, specular = brdf.reflect(at, _project(view.frame, wi), cos_between)
        visible = light.take(view.cell) * np.float32(1 / 255 / self.sub_points**2)
        through *= visible
        specular *= visible
        colour = at.diffuse * through
        colour += brdf.specular_colour(at, cos_between) * specular
        return np.moveaxis(colour.sum(1), 0, -1).reshape(*self.size, 3)


def _project(frame: Array, direction: Array) -> tuple[Array, Array, Array]:
    x, y, z = (np.float32(v) for v in direction)
    t, b, n = frame[0] * x + frame[1] * y + frame[2] * z
    return t, b, n


def _bilinear(table: Array, shape: tuple[int, ...], row: Array, col: Array) -> Array:
    """Rows of a table (H · W, C) blended at fractional grid places (...), periodic; (C, ...) contiguous."""
    (H, W), (r, c) = shape, (np.floor(row), np.floor(col))
    fr, fc = (row - r)[..., None], (col - c)[..., None]
    r, c = r.astype(np.intp) % H, c.astype(np.intp) % W
    below, right = (r + 1) % H * W, (c + 1) % W
    r *= W
    top = table.take(r + c, axis=0)
    top += (table.take(r + right, axis=0) - top) * fc
    low = table.take(below + c, axis=0)
    low += (table.take(below + right, axis=0) - low) * fc
    top += (low - top) * fr
    return np.ascontiguousarray(np.moveaxis(top, -1, 0))


def render(
    maps: Maps,
    wo: ArrayLike,
    wi: ArrayLike,
    size: tuple[int, int],
    sub_points: int = 2,
    out: Array | None = None,
    show: "Progress | None" = None,
    label: str = "rendering",
) -> Array:
    """Slices (N, H, W, 3) of a surface at N pairs, linear Rec. 709: each view is traced once and each light cast once.

    `wo` and `wi` are (N, 3) unit vectors with z > 0; `size` is (H, W), rows at the top first. `out`, any float array of
    that shape such as a memory map, receives the slices, with infinity for highlights that its type cannot hold; None
    makes a float32 array. `show(label, done, N)` is called after each view. Uses one thread for each processor that
    this process may use; the result does not depend on their number.
    """
    wo, wi = (np.asarray(d, np.float32).reshape(-1, 3) for d in (wo, wi))
    if wo.shape != wi.shape or not (np.minimum(wo[:, 2], wi[:, 2]) > 0).all():
        raise InputError("wo and wi must have the same number of directions, all above the horizon (z > 0)")
    renderer = Renderer(maps, size, sub_points)
    result = np.empty((len(wo), *size, 3), np.float32) if out is None else out
    views, view_of = np.unique(wo, axis=0, return_inverse=True)
    lights, light_of, uses = np.unique(wi, axis=0, return_inverse=True, return_counts=True)
    view_of, light_of = view_of.reshape(-1), light_of.reshape(-1)  # only numpy 2.0 gives (N, 1)

    def light(index: int) -> Array | None:
        return renderer.field.visibility(lights[index]) if uses[index] > 1 else None

    def paint(index: int) -> int:
        view = renderer.view(views[index])
        pairs = np.flatnonzero(view_of == index)
        for pair in pairs:
            cast = shared[light_of[pair]]
            picture = renderer.slice(view, wi[pair], renderer.field.visibility(wi[pair]) if cast is None else cast)
            with np.errstate(over="ignore"):
                result[pair] = picture
        return len(pairs)

    done = 0
    with ThreadPoolExecutor(cores()) as pool:
        shared = list(pool.map(light, range(len(lights))))
        for count in pool.map(paint, range(len(views))):
            done += count
            if show:
                show(label, done, len(wo))
    return result
