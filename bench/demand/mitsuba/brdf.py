"""The built-in reflectance in Dr.Jit, with directions drawn from it. `bench.data.materials.brdf` has the equations.

Directions are unit vectors in the tangent frame (t, b, n). The two lobes are drawn by one-sample multiple importance
sampling: cosines for the base, visible normals (Heitz 2018, "Sampling the GGX Distribution of Visible Normals") for the
highlight. Needs a Mitsuba variant to be set.
"""

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from bench.data.materials.brdf import DIELECTRIC_F0, MIN_ALPHA, fresnel

Values = Any  # Dr.Jit arrays over points, colours mi.Color3f in linear Rec. 709


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
    dielectric: Values  # the F90 of the dielectric's own reflection
    glossy: Values  # the share of directions drawn from the highlight


def shading(o: Values, base: Values, roughness: Values, metal: Values, specular: Values, anisotropy: Values) -> Shading:
    """Points prepared for one direction each; the maps are those of `bench.data.materials.maps.Maps`."""
    seen, o = o, mi.Vector3f(o.x, o.y, at_least(1e-3, o.z))
    alpha = at_least(MIN_ALPHA, roughness * roughness)
    stretch = dr.sqrt(1 - 0.9 * anisotropy)
    dielectric = (1 - metal) * specular
    diffuse = base * ((1 - metal) * (1 - fresnel(DIELECTRIC_F0 * specular, specular, o.z)) / dr.pi)
    f0, f90 = DIELECTRIC_F0 * dielectric + metal * base, dielectric + metal
    shine = mi.luminance(fresnel(f0, mi.Color3f(f90), o.z))
    matt = mi.luminance(diffuse) * dr.pi
    glossy = shine / at_least(1e-6, shine + matt)
    return Shading(o, seen, alpha / stretch, at_least(MIN_ALPHA, alpha * stretch), diffuse, f0, f90, specular, glossy)


def reflect(at: Shading, i: Values) -> Values:
    """f_r · cos θ_i (mi.Color3f) toward the points' `o`; 0 from below the tangent plane."""
    o, i_n = at.o, at_least(0, i.z)
    between = at_least(1e-6, 0.5 + 0.5 * dr.dot(at.seen, i))  # (o·h)²
    h = (o + mi.Vector3f(i.x, i.y, i_n)) * (0.5 * dr.rsqrt(between))
    masking = i_n * _smith(at, o) + o.z * _smith(at, mi.Vector3f(i.x, i.y, i_n))
    highlight = i_n * 0.5 * _density(at, h) / at_least(1e-12, masking)
    through = i_n * (1 - fresnel(DIELECTRIC_F0 * at.dielectric, at.dielectric, i_n))
    return at.diffuse * through + fresnel(at.f0, mi.Color3f(at.f90), dr.sqrt(between)) * highlight


def sample(at: Shading, choice: Values, place: Values) -> tuple[Values, Values]:
    """Directions drawn by numbers in [0, 1): `choice` picks the lobe, `place` (mi.Point2f) the direction in it. Also
    f_r · cos θ_i over their density (mi.Color3f), 0 where a direction fell below the tangent plane."""
    matt = _cosine(place)
    seen = dr.normalize(at.o)
    h = _visible_normal(at, seen, place)
    i = dr.select(choice < at.glossy, 2 * dr.dot(seen, h) * h - seen, matt)
    density = at.glossy * _glossy_density(at, seen, i) + (1 - at.glossy) * at_least(0, i.z) / dr.pi
    usable = (i.z > 0) & (density > 0)
    return i, dr.select(usable, reflect(at, i) / dr.select(usable, density, 1), 0)


def at_least(low: float, x: Values) -> Values:
    """max(low, x), without Dr.Jit's maximum: LLVM 16 and older cannot compile it and end the process."""
    return dr.select(x > low, x, low)


def _cosine(place: Values) -> Values:
    """A direction drawn in proportion to its cosine (Malley)."""
    x, y = _disc(place)
    return mi.Vector3f(x, y, dr.sqrt(at_least(0, 1 - x * x - y * y)))


def _disc(place: Values) -> tuple[Values, Values]:
    radius, phi = dr.sqrt(place.x), 2 * dr.pi * place.y
    return radius * dr.cos(phi), radius * dr.sin(phi)


def _smith(at: Shading, x: Values) -> Values:
    t, b = at.alpha_t * x.x, at.alpha_b * x.y
    return dr.sqrt(t * t + b * b + x.z * x.z)


def _density(at: Shading, h: Values) -> Values:
    """The GGX distribution D at half vectors."""
    t, b = h.x / at.alpha_t, h.y / at.alpha_b
    stretched = t * t + b * b + h.z * h.z
    return 1 / (dr.pi * at.alpha_t * at.alpha_b * stretched * stretched)


def _visible_normal(at: Shading, o: Values, place: Values) -> Values:
    """A half vector drawn in proportion to D(h) · (o·h)⁺ (Heitz 2018, appendix A)."""
    v = dr.normalize(mi.Vector3f(at.alpha_t * o.x, at.alpha_b * o.y, o.z))
    side = v.x * v.x + v.y * v.y
    scale = dr.rsqrt(at_least(1e-12, side))
    across = dr.select(side > 1e-12, mi.Vector3f(-v.y * scale, v.x * scale, 0), mi.Vector3f(1, 0, 0))
    x, y = _disc(place)
    blend = 0.5 * (1 + v.z)
    y = (1 - blend) * dr.sqrt(at_least(0, 1 - x * x)) + blend * y
    up = dr.sqrt(at_least(0, 1 - x * x - y * y))
    h = x * across + y * dr.cross(v, across) + up * v
    return dr.normalize(mi.Vector3f(at.alpha_t * h.x, at.alpha_b * h.y, at_least(1e-6, h.z)))


def _glossy_density(at: Shading, o: Values, i: Values) -> Values:
    """Density of the directions that reflect `o` at a visible normal: D · G₁ / (4 o_n), per solid angle."""
    h = dr.normalize(o + i)
    return dr.select(dr.dot(o, h) > 0, _density(at, h) / (2 * (o.z + _smith(at, o))), 0)
