"""Path-traces a surface with Mitsuba 3: the values of `bench.data.materials.renderer`, plus inter-reflections.

Heights become a triangle mesh, repeated around the reference tile as far as rays reach. A path starts where the view
ray through a fixed sub-point of the reference plane meets the surface, as in the built-in renderer. Each of its points
receives the distant light, and a direction drawn from the reflectance leads to the next. The random numbers depend on
the seed and the sub-point, not on the pair, so the noise is fixed for each texel and a codec can store it.

The reflectance has the equations of `bench.data.materials.brdf`, for unit vectors in the tangent frame (t, b, n). Its
two lobes are drawn by one-sample multiple importance sampling: cosines for the base, visible normals (Heitz 2018,
"Sampling the GGX Distribution of Visible Normals") for the highlight.
"""

import logging
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from bench.btf import Array
from bench.data.materials.brdf import DIELECTRIC_F0, MIN_ALPHA, fresnel
from bench.data.materials.maps import Maps
from bench.data.materials.renderer import Renderer
from bench.inputs.errors import InputError
from bench.program.llvm import unusable

Values = Any  # Dr.Jit arrays over paths, colours mi.Color3f in linear Rec. 709, or numbers in a scalar variant
PATH_VERSION = 1  # increment when a value changes
MAX_DEPTH = 16  # edges of a path, including the light's, as Mitsuba counts: 2 is direct light only
WAVEFRONT = 1 << 21  # paths in one launch
REACH = 20.0  # depths of relief that a path may go beyond the shadows: (1 / REACH)² of its light is lost
MAX_CELLS = 30_000_000  # cells of the mesh; 3 GB with its search tree
LIFT = 1e-5  # offset of rays that leave the surface, in widths of the picture
NUDGE = (0.0017, 0.0031)  # shift of a sub-point, in sub-points: rays exactly on edges of triangles miss the mesh
STEPS = (0.8191725134, 0.6710436067, 0.5497004779)  # Roberts' additive recurrence in three dimensions
log = logging.getLogger(__name__)


def fastest_variant() -> str:
    """The fastest of Mitsuba's variants that works here: `llvm_ad_rgb`, else `scalar_rgb`."""
    reason = unusable() if "llvm_ad_rgb" in mi.variants() else "this Mitsuba is built without llvm_ad_rgb"
    if not reason:
        return "llvm_ad_rgb"
    log.warning("tracing with Mitsuba's scalar_rgb, which is about a thousand times slower: %s", reason)
    return "scalar_rgb"


def provenance() -> dict[str, Any]:
    """The description of this renderer in a BTF's provenance."""
    return {
        "renderer": f"Mitsuba {mi.__version__}, {fastest_variant()}",
        "path_version": PATH_VERSION,
        "transport": f"path-traced with inter-reflections, up to {MAX_DEPTH} edges; one path a sub-point",
        "values": "linear Rec. 709, f_r * cos(theta_i) and what the surface reflects onto itself, no clamp",
    }


@contextmanager
def using(variant: str) -> Iterator[None]:
    """Set a variant of Mitsuba, and restore the previous one at the end."""
    before = mi.variant()
    mi.set_variant(variant)
    try:
        yield
    finally:
        if before:
            mi.set_variant(before)


def launches(
    maps: Maps,
    wo: Array,
    wi: Array,
    size: tuple[int, int],
    sub_points: int = 2,
    seed: int = 0,
    depth: int = MAX_DEPTH,
) -> Iterator[Array]:
    """Slices (n, H, W, 3) float32 of a surface at N pairs, one launch at a time.

    They are linear Rec. 709 f_r · cos θ_i with inter-reflections. `wo` and `wi` are (N, 3) unit vectors with z > 0;
    `size` is (H, W), rows at the top first; each texel is the mean of `sub_points`² paths of at most `depth` edges (2:
    direct light alone). The same seed gives the same values, however pairs are grouped into launches. Raises
    `InputError` for directions below the horizon and reliefs too deep to surround.
    """
    if wo.shape != wi.shape or not (np.minimum(wo[:, 2], wi[:, 2]) > 0).all():
        raise InputError("wo and wi must have the same number of directions, all above the horizon (z > 0)")
    with using(fastest_variant()):
        tracer = PathTracer(maps, size, sub_points, float(wo[:, 2].min()), float(wi[:, 2].min()), seed)
        for first in range(0, len(wo), tracer.pairs_a_launch):
            chosen = slice(first, first + tracer.pairs_a_launch)
            yield tracer.slices(wo[chosen], wi[chosen], depth)


@dataclass(frozen=True)
class Shading:
    """Points seen from `o`, whose normal component is at least 1e-3, as the built-in renderer has it."""

    o: Values
    seen: Values  # the direction itself
    alpha_t: Values
    alpha_b: Values
    diffuse: Values  # (1 − metalness) · base / π · (1 − F_d(o_n))
    f0: Values
    f90: Values
    dielectric_f90: Values  # of the dielectric's own reflection
    glossy: Values  # the share of directions drawn from the highlight


def shading(o: Values, base: Values, roughness: Values, metal: Values, specular: Values, anisotropy: Values) -> Shading:
    """Points prepared for one direction each, `o`, toward which they reflect.

    The other arguments are the maps of `bench.data.materials.maps.Maps` at the points.
    """
    seen = o
    o = mi.Vector3f(o.x, o.y, at_least(1e-3, o.z))  # never quite grazing
    alpha = at_least(MIN_ALPHA, roughness * roughness)
    stretch = dr.sqrt(1 - 0.9 * anisotropy)
    dielectric = (1 - metal) * specular  # the weight of the dielectric's reflection
    reflected = fresnel(DIELECTRIC_F0 * specular, specular, o.z)
    diffuse = base * ((1 - metal) * (1 - reflected) / dr.pi)
    f0, f90 = DIELECTRIC_F0 * dielectric + metal * base, dielectric + metal
    shine = mi.luminance(fresnel(f0, mi.Color3f(f90), o.z))
    matt = mi.luminance(diffuse) * dr.pi
    # Lobes are drawn in proportion to the light that they reflect, by luminance.
    glossy = shine / at_least(1e-6, shine + matt)
    return Shading(
        o=o,
        seen=seen,
        alpha_t=alpha / stretch,
        alpha_b=at_least(MIN_ALPHA, alpha * stretch),
        diffuse=diffuse,
        f0=f0,
        f90=f90,
        dielectric_f90=specular,
        glossy=glossy,
    )


def reflect(here: Shading, i: Values) -> Values:
    """f_r · cos θ_i (mi.Color3f) of the points, toward their `o` for light from `i`; 0 from below the tangent plane."""
    o = here.o
    i_n = at_least(0, i.z)
    between = at_least(1e-6, 0.5 + 0.5 * dr.dot(here.seen, i))  # (o·h)²
    h = (o + mi.Vector3f(i.x, i.y, i_n)) * (0.5 * dr.rsqrt(between))
    masking = i_n * _smith(here, o) + o.z * _smith(here, mi.Vector3f(i.x, i.y, i_n))
    highlight = i_n * 0.5 * _density(here, h) / at_least(1e-12, masking)
    through = i_n * (1 - fresnel(DIELECTRIC_F0 * here.dielectric_f90, here.dielectric_f90, i_n))
    return here.diffuse * through + fresnel(here.f0, mi.Color3f(here.f90), dr.sqrt(between)) * highlight


def sample(here: Shading, choice: Values, place: Values) -> tuple[Values, Values]:
    """Directions drawn by numbers in [0, 1): `choice` picks the lobe, `place` (mi.Point2f) the direction in it. Also
    f_r · cos θ_i over their density (mi.Color3f), 0 where a direction fell below the tangent plane."""
    matt = _cosine(place)
    seen = dr.normalize(here.o)
    h = _visible_normal(here, seen, place)
    i = dr.select(choice < here.glossy, 2 * dr.dot(seen, h) * h - seen, matt)
    density = here.glossy * _glossy_density(here, seen, i) + (1 - here.glossy) * at_least(0, i.z) / dr.pi
    usable = (i.z > 0) & (density > 0)
    return i, dr.select(usable, reflect(here, i) / dr.select(usable, density, 1), 0)


def at_least(low: float, x: Values) -> Values:
    """max(low, x), without Dr.Jit's maximum: LLVM 16 and older cannot compile it and end the process."""
    return dr.select(x > low, x, low)


def _cosine(place: Values) -> Values:
    """A direction drawn in proportion to its cosine, by two numbers in [0, 1) (Malley)."""
    x, y = _disc(place)
    return mi.Vector3f(x, y, dr.sqrt(at_least(0, 1 - x * x - y * y)))


def _disc(place: Values) -> tuple[Values, Values]:
    """x and y drawn uniformly in the unit disc, from two numbers in [0, 1)."""
    radius = dr.sqrt(place.x)
    phi = 2 * dr.pi * place.y
    return radius * dr.cos(phi), radius * dr.sin(phi)


def _smith(here: Shading, x: Values) -> Values:
    """The length √(α_t² x_t² + α_b² x_b² + x_n²) of Smith's terms, as in `bench.data.materials.brdf`."""
    t, b = here.alpha_t * x.x, here.alpha_b * x.y
    return dr.sqrt(t * t + b * b + x.z * x.z)


def _density(here: Shading, h: Values) -> Values:
    """The GGX distribution D at half vectors."""
    t, b = h.x / here.alpha_t, h.y / here.alpha_b
    stretched = t * t + b * b + h.z * h.z
    return 1 / (dr.pi * here.alpha_t * here.alpha_b * stretched * stretched)


def _visible_normal(here: Shading, o: Values, place: Values) -> Values:
    """A half vector drawn in proportion to D(h) · (o·h)⁺ (Heitz 2018, appendix A).

    The view is stretched to a hemisphere of roughness 1, whose projection along the view is half a disc and half an
    ellipse. A point drawn there, by the two numbers in [0, 1) of `place`, gives a normal, which is stretched back.
    """
    v = dr.normalize(mi.Vector3f(here.alpha_t * o.x, here.alpha_b * o.y, o.z))
    side = v.x * v.x + v.y * v.y
    scale = dr.rsqrt(at_least(1e-12, side))
    across = dr.select(side > 1e-12, mi.Vector3f(-v.y * scale, v.x * scale, 0), mi.Vector3f(1, 0, 0))
    x, y = _disc(place)
    blend = 0.5 * (1 + v.z)
    y = (1 - blend) * dr.sqrt(at_least(0, 1 - x * x)) + blend * y
    up = dr.sqrt(at_least(0, 1 - x * x - y * y))
    h = x * across + y * dr.cross(v, across) + up * v
    return dr.normalize(mi.Vector3f(here.alpha_t * h.x, here.alpha_b * h.y, at_least(1e-6, h.z)))


def _glossy_density(here: Shading, o: Values, i: Values) -> Values:
    """Density of the directions that reflect `o` at a visible normal: D · G₁ / (4 o_n), per solid angle."""
    h = dr.normalize(o + i)
    return dr.select(dr.dot(o, h) > 0, _density(here, h) / (2 * (o.z + _smith(here, o))), 0)


class PathTracer:
    """A surface prepared in the current variant, for views and lights with at least the two given z."""

    def __init__(
        self, maps: Maps, size: tuple[int, int], sub_points: int, view_z: float, light_z: float, seed: int = 0
    ):
        """Make the mesh and the lookup table. `size` is (H, W) of the slices, `view_z` and `light_z` are the least
        z."""
        self.size = size
        self.sub_points = sub_points  # along each side of a texel
        self.seed = seed & 0xFFFFFFFF  # Mitsuba takes 32 bits
        built_in = Renderer(maps, size, sub_points)
        self.field, self.aspect = built_in.field, built_in.aspect
        # The lookup table of the built-in renderer, so that both render the same surface.
        table = built_in.table.reshape(*self.field.shape, -1)
        self.table = mi.Texture2f(mi.TensorXf(table), wrap_mode=dr.WrapMode.Repeat)
        self.scene = mi.load_dict({"type": "scene", "surface": self._mesh(view_z, light_z)})

    @property
    def pairs_a_launch(self) -> int:
        """The number of pairs whose paths fill a launch, at least one; one of a scalar variant."""
        if mi.variant() == "scalar_rgb":
            return 1
        return max(1, WAVEFRONT // self._paths)

    @property
    def _paths(self) -> int:
        """The paths of one pair: one for each sub-point."""
        return self.size[0] * self.size[1] * self.sub_points**2

    def _mesh(self, view_z: float, light_z: float) -> Any:
        """Two triangles a cell, with vertices at the centres of grid cells, around the tile as far as rays reach."""
        relief = self.field.top - self.field.bottom
        # How far the lowest view and light go sideways for each unit of height: the tangents of their angles.
        slopes = sum(math.sqrt(max(1 / z**2 - 1, 0)) for z in (view_z, light_z))
        reach = relief * slopes + min(REACH * relief, 1)
        (H, W), cell = self.field.shape, self.field.cell
        border = [math.ceil(reach / side) + 1 for side in cell]  # in cells, down and across
        if (H + 2 * border[0]) * (W + 2 * border[1]) > MAX_CELLS:
            relief_reach = f"a relief of {relief:.2g} widths reaches {reach:.2g} widths: the mesh would be too large"
            raise InputError(f"at these grazing directions {relief_reach}: take a smaller --depth or --size")
        rows = np.arange(-border[0], H + border[0])
        cols = np.arange(-border[1], W + border[1])
        y, x = np.meshgrid((H - rows - 0.5) * cell[0], (cols + 0.5) * cell[1], indexing="ij")
        vertices = np.stack([x, y, self.field.height[np.ix_(rows % H, cols % W)]], -1)
        return _triangles(vertices.astype(np.float32))

    def slices(self, wo: Array, wi: Array, depth: int) -> Array:
        """Pictures (N, H, W, 3) float32 of the pairs `wo`, `wi` (N, 3), traced in one launch."""
        if mi.variant() == "scalar_rgb":
            radiance = []
            for o, i in zip(wo.tolist(), wi.tolist(), strict=True):
                view, light = mi.Vector3f(o), mi.Vector3f(i)
                radiance += [self._radiance(point, view, light, depth) for point in range(self._paths)]
            values = np.array(radiance)
        else:
            path = dr.arange(mi.UInt32, len(wo) * self._paths)
            pair = path // self._paths
            view = dr.gather(mi.Vector3f, mi.Float(np.ravel(wo).astype(np.float32)), pair)
            light = dr.gather(mi.Vector3f, mi.Float(np.ravel(wi).astype(np.float32)), pair)
            values = np.array(self._radiance(path - pair * self._paths, view, light, depth)).T
        points = values.reshape(len(wo), *self.size, -1, 3)  # (N, H, W, sub-points, 3)
        return points.mean(-2, dtype=np.float32).astype(np.float32)

    def _radiance(self, point: Values, wo: Values, wi: Values, depth: int) -> Values:
        """Radiance (mi.Color3f) toward `wo` of numbered sub-points, those of a texel side by side, lit from `wi`."""
        (H, W), s = self.size, self.sub_points
        texel = point // (s * s)
        number = point - texel * (s * s)  # of the sub-point in its texel, row by row
        row = texel // W * s + number // s
        col = texel % W * s + number % s
        y = self.aspect * (1 - (mi.Float(row) + (0.5 + NUDGE[0])) / (H * s))
        x = (mi.Float(col) + (0.5 + NUDGE[1])) / (W * s)
        # From just above the highest point, along the view through the sub-point of the reference plane z = 0.
        ray = mi.Ray3f(mi.Point3f(x, y, 0) + (self.field.top + 1e-3) / wo.z * wo, -wo)
        # Three random numbers for each bounce; for the first they spread evenly over a texel's sub-points.
        start = _three(_generator(self.seed ^ 0x9E3779B9, texel)) + mi.Vector3f(*STEPS) * mi.Float(number)
        first = start - dr.floor(start)
        return _follow(self, ray, wi, _generator(self.seed, point), first, mi.UInt32(depth))

    def surface(self, p: Values, o: Values) -> tuple[Values, Shading]:
        """Tangent frame (mi.Frame3f) and reflectance of the points `p` seen from `o`, both in space."""
        # Normal, base colour, roughness, metalness, specular, anisotropy, cos and sin of twice the angle.
        t = self.table.eval(mi.Point2f(p.x, 1 - p.y / self.aspect))
        n = dr.normalize(mi.Vector3f(t[0], t[1], t[2]))
        # Half of the angle whose cosine and sin lie in the table.
        cos = t[10] * dr.rsqrt(t[10] * t[10] + t[11] * t[11] + 1e-12)
        side = dr.sqrt(at_least(0, 0.5 - 0.5 * cos))
        stretch = mi.Vector3f(dr.sqrt(at_least(0, 0.5 + 0.5 * cos)), dr.select(t[11] < 0, -side, side), 0)
        tangent = dr.normalize(stretch - n * dr.dot(stretch, n))
        frame = mi.Frame3f(tangent, dr.cross(n, tangent), n)
        return frame, shading(frame.to_local(o), mi.Color3f(t[3], t[4], t[5]), t[6], t[7], t[8], t[9])

    def leave(self, p: Values, wi: Values) -> Values:
        """The start of a ray to the light: one cell further, as in the built-in renderer. The map has no relief inside
        a cell, and its flat triangles would shade each other although their normals say that they are lit."""
        rows, cols = dr.abs(wi.y) / self.field.cell[0], dr.abs(wi.x) / self.field.cell[1]
        return p + wi / at_least(1e-3, dr.select(rows > cols, rows, cols))


def _generator(seed: int, stream: Values) -> Values:
    """A generator of random numbers for each stream; the same seed and stream give the same numbers."""
    return mi.PCG32(1, *mi.sample_tea_32(stream, mi.UInt32(seed)))


def _three(generator: Values) -> Values:
    """Its next three numbers in [0, 1), as a mi.Vector3f."""
    return mi.Vector3f(generator.next_float32(), generator.next_float32(), generator.next_float32())


def _triangles(vertices: Array) -> Any:
    """A mesh of a grid of vertices (rows, columns, 3), seen from above counter-clockwise."""
    rows, cols = vertices.shape[:2]
    # Vertices are numbered row by row; each that has one to the right and one below is the corner of two triangles.
    corner = (np.arange(rows - 1)[:, None] * cols + np.arange(cols - 1)).reshape(-1)
    right, below = corner + 1, corner + cols
    faces = np.stack([corner, below, right, right, below, below + 1], -1).astype(np.uint32)
    mesh = mi.Mesh("surface", rows * cols, 2 * len(corner))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = vertices.reshape(-1)
    parameters["faces"] = faces.reshape(-1)
    parameters.update()
    return mesh


@dr.syntax
def _follow(tracer: PathTracer, ray: Values, wi: Values, generator: Values, first: Values, depth: Values) -> Values:
    """The radiance (mi.Color3f) of paths of up to `depth` edges that start with `ray`, under unit light from `wi`.

    Directions are drawn by `first`, three numbers in [0, 1), at the first point of a path, then by the `generator`.
    """
    value, weight = mi.Color3f(0), mi.Color3f(1)  # the radiance so far, and what arrives of a point's light
    edges, active = mi.UInt32(1), mi.Bool(True)
    # Each turn goes to the next point of a path, adds the light that it receives directly, and draws a new direction.
    while active:
        hit = tracer.scene.ray_intersect(ray, mi.RayFlags.Minimal, edges == 1, active=active)
        active &= hit.is_valid() & (dr.dot(hit.n, ray.d) < 0)
        frame, here = tracer.surface(hit.p, -ray.d)
        blocked = tracer.scene.ray_test(mi.Ray3f(tracer.leave(hit.p, wi), wi), edges == 1, active=active)
        value += dr.select(active & (active ^ blocked), weight * reflect(here, frame.to_local(wi)), 0)
        edges += 1
        random = dr.select(edges == 2, first, _three(generator))  # `first` at the first point of a path
        inward, factor = sample(here, random.x, mi.Point2f(random.y, random.z))
        onward = frame.to_world(inward)
        weight *= factor
        active &= (edges < depth) & (dr.dot(hit.n, onward) > 0) & (mi.luminance(weight) > 0)
        ray = mi.Ray3f(hit.p + LIFT * hit.n, onward)
    return value
