"""The reflectance of a point: GGX specular and a Lambert base coupled by Fresnel, in its own tangent frame.

With t, b, n the components along tangent, bitangent and normal, h the unit half vector and α_t, α_b the widths:

- D = 1 / (π α_t α_b ((h_t/α_t)² + (h_b/α_b)² + h_n²)²): anisotropic GGX (Walter et al. 2007,
  eq. 33; Burley 2012, eq. 13).
- V = G₂ / (4 o_n i_n) = 0.5 / (i_n Λ(o) + o_n Λ(i)), Λ(x) = √(α_t² x_t² + α_b² x_b² + x_n²): Smith's height-correlated
  masking and shadowing (Heitz 2014, eq. 99, with the anisotropic projected roughness of section 5.3).
- F = F0 + (F90 − F0)(1 − o·h)⁵ (Schlick 1994).
- f = F D V + (1 − F_d(o_n)) (1 − F_d(i_n)) (1 − metalness) · base / π, with F_d the dielectric's Fresnel term: light
  that is reflected on the way in or out is not scattered below. This is reciprocal and keeps the albedo below one
  (Shirley et al. 1997; Ashikhmin and Shirley 2000).

Arrays are NumPy's or PyTorch's, so a codec can fit exactly the reflectance that the renderer uses.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

Array = Any  # over points: NumPy's, or a tensor
Values = Any  # an array, or one number for all points
DIELECTRIC_F0 = 0.04
MIN_ALPHA = 1e-3  # keeps the peak 1 / (π α²) below 3.2e5


@dataclass(frozen=True)
class Points:
    """Shading points seen from one direction.

    Each field is an array over the points, (...); colours are linear Rec. 709, (3, ...).
    """

    o: tuple[Array, Array, Array]  # the view direction along t, b and n
    alpha: tuple[Array, Array]  # the GGX widths along t and b
    diffuse: Array  # a colour: (1 − metalness) · base / π · (1 − F_d(o_n))
    f0: Array  # a colour: the specular reflectance along the normal
    f90: Array  # that at a grazing angle, the same for all colours
    dielectric_f90: Array  # that of the dielectric part alone
    smith_o: Array  # Λ(o)


def points(o: tuple[Array, Array, Array], maps: dict[str, Array]) -> Points:
    """Prepare points for one view: everything about them that no light changes.

    The view direction `o` has components along t, b and n, each (...). `maps` holds `base` (3, ...), and `roughness`,
    `metalness`, `specular` and `anisotropy`, each (...), as in `Maps`.
    """
    alpha = _at_least(MIN_ALPHA, maps["roughness"] ** 2)
    stretch = _root(1 - 0.9 * maps["anisotropy"])  # s of `Maps`: α / s along t and α · s along b
    alpha_t, alpha_b = alpha / stretch, _at_least(MIN_ALPHA, alpha * stretch)
    metal = maps["metalness"]
    specular = maps["specular"]
    dielectric = (1 - metal) * specular  # the weight of the dielectric's reflection
    o_n = _at_least(1e-3, o[2])  # a normal may lean away from the view; it then counts as seen at a grazing angle
    reflected = fresnel(DIELECTRIC_F0 * specular, specular, o_n)  # F_d(o_n)
    diffuse = maps["base"] * ((1 - metal) * (1 - reflected) / np.pi)
    f0 = DIELECTRIC_F0 * dielectric + metal * maps["base"]
    f90 = dielectric + metal
    view = (o[0], o[1], o_n)
    alphas = (alpha_t, alpha_b)
    return Points(view, alphas, diffuse, f0, f90, dielectric_f90=specular, smith_o=_smith(alphas, view))


def reflect(here: Points, i: tuple[Array, Array, Array], cos_between: Values) -> tuple[Array, Array]:
    """The diffuse and the specular part of f · cos θ_i for one light, each over the points (...) and without its
    colour.

    The first is to be multiplied by `diffuse`, the second by F (see `specular_colour`). `i` is the light's direction
    along t, b and n, each (...); `cos_between` is ω_o · ω_i. Both are 0 for a light below the tangent plane.
    """
    i_n = _at_least(0, i[2])
    # The half vector is (o + i) / |o + i|, with |o + i|² = 2 + 2 ω_o · ω_i, which is 0 for opposite directions.
    inverse_length = 1 / _root(_at_least(1e-12, 2 + 2 * cos_between))
    (o_t, o_b, o_n), (alpha_t, alpha_b) = here.o, here.alpha
    h_t, h_b, h_n = o_t + i[0], o_b + i[1], o_n + i_n
    h_t /= alpha_t
    h_b /= alpha_b
    # (h_t/α_t)² + (h_b/α_b)² + h_n² of the unit half vector; D divides by its square.
    stretched = h_t * h_t + h_b * h_b + h_n * h_n
    stretched *= inverse_length * inverse_length
    # The specular part is D V i_n, with D = 1 / (π α_t α_b stretched²) and V = 0.5 / masking.
    masking = i_n * here.smith_o + o_n * _smith(here.alpha, (i[0], i[1], i_n))
    denominator = stretched * stretched * masking * (alpha_t * alpha_b)
    specular = i_n * (0.5 / np.pi) / denominator
    # The diffuse part lacks only what the dielectric reflects on the way in; `Points.diffuse` has the other factors.
    transmitted = i_n * (1 - fresnel(DIELECTRIC_F0 * here.dielectric_f90, here.dielectric_f90, i_n))
    return transmitted, specular


def specular_colour(here: Points, cos_between: Values) -> Values:
    """Fresnel's colour F (3, ...) of each point for one pair, by the cosine of the angle between its view and light.

    F goes by the angle between view and half vector, which all points share.
    """
    # The half vector halves the angle between view and light: cos(x / 2) = √((1 + cos x) / 2).
    cos_half = _root(_at_least(0, (1 + cos_between) / 2))
    return fresnel(here.f0, here.f90, cos_half)


def fresnel(f0: Values, f90: Values, cos: Values) -> Values:
    """Schlick's Fresnel term at the cosine of the angle to the normal or half vector; colours (3, ...) or numbers."""
    grazing = 1 - cos
    squared = grazing * grazing
    return f0 + (f90 - f0) * (squared * squared * grazing)


def _smith(alpha: tuple[Array, Array], x: tuple[Array, Array, Array]) -> Array:
    """Λ(x) of the module's docstring, over points: √(α_t² x_t² + α_b² x_b² + x_n²)."""
    t, b = alpha[0] * x[0], alpha[1] * x[1]
    return _root(t * t + b * b + x[2] * x[2])


def _at_least(least: float, values: Values) -> Values:
    """The larger of each value and `least`, of NumPy or PyTorch."""
    return values.clamp_min(least) if hasattr(values, "clamp_min") else np.maximum(values, least)


def _root(values: Values) -> Values:
    """Square roots, of NumPy or PyTorch."""
    return values.sqrt() if hasattr(values, "sqrt") else np.sqrt(values)
