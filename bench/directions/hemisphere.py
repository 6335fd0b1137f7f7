"""Directions of the hemisphere in NumPy: angles, the published measurement sets, thinning, random draws.

Frame (see `bench.btf`): x right, y up in the picture, z toward the eye; θ from z, φ from +x counter-clockwise;
radians, unless a name ends in `_deg`.
"""

import numpy as np
from numpy.typing import ArrayLike

from bench.btf import Array


def from_angles(theta: ArrayLike, phi: ArrayLike) -> Array:
    """Unit vectors (..., 3) float32 of polar angle θ and azimuth φ, in radians."""
    polar, azimuth = np.asarray(theta, np.float64), np.asarray(phi, np.float64)
    sin = np.sin(polar)
    return np.stack([sin * np.cos(azimuth), sin * np.sin(azimuth), np.cos(polar)], -1).astype(np.float32)


def from_degrees(theta_deg: ArrayLike, phi_deg: ArrayLike) -> Array:
    """Unit vectors (..., 3) float32 of θ and φ in degrees."""
    return from_angles(np.radians(theta_deg), np.radians(phi_deg))


def to_degrees(directions: ArrayLike) -> tuple[Array, Array]:
    """θ from 0 to 180 and φ from 0 to 360 in degrees, float64 (...), of unit vectors (..., 3).

    φ is 360 only where it is less than a rounding error below 0.
    """
    x, y, z = np.moveaxis(np.asarray(directions, np.float64), -1, 0)
    return np.degrees(np.arctan2(np.hypot(x, y), z)), np.degrees(np.arctan2(y, x)) % 360.0


def _rings(rings: list[tuple[float, int, float]]) -> Array:
    """Directions ring by ring from (θ, count, first φ) in degrees, evenly spaced in azimuth."""
    theta = np.concatenate([np.full(count, t) for t, count, _ in rings])
    phi = np.concatenate([first + np.arange(count) * 360.0 / count for _, count, first in rings])
    return from_degrees(theta, phi)


def ubo2003() -> Array:
    """The 81 directions of the UBO2003 and UTIA measurements, (81, 3) float32, up to θ = 75°."""
    return _rings([(0, 1, 0), (15, 6, 0), (30, 12, 0), (45, 18, 0), (60, 20, 0), (75, 24, 0)])


def ubo2014() -> Array:
    """The 151 directions of the UBO2014 measurement, (151, 3) float32, up to θ = 75°."""
    theta = [0, 11, 23.5, 30, 37.5, 45, 52.5, 60, 67.5, 75]
    count = [1, 6, 12, 12, 12, 18, 18, 24, 24, 24]
    first = [0, 15, 0, 15, 0, 0, 7.5, 0, 7.5, 0]
    return _rings(list(zip(theta, count, first, strict=True)))


DIRECTION_SETS = {"ubo2003": ubo2003, "ubo2014": ubo2014}


def thin(directions: Array, count: int) -> Array:
    """Indices (count,), sorted, of an evenly spread subset of directions (n, 3): farthest-point selection from the one
    nearest the zenith, of equal distances the lower index. `ValueError` unless `count` is from 1 to n."""
    if not 1 <= count <= len(directions):
        raise ValueError(f"count must be between 1 and {len(directions)}, not {count}")
    chosen = [int(np.argmax(directions[:, 2]))]
    distance = np.linalg.norm(directions - directions[chosen[0]], axis=1)
    while len(chosen) < count:
        # Rounded, because rounding errors of the machine would decide ties of a symmetric set; 1e-4 is below any
        # spacing.
        chosen.append(int(np.argmax(np.round(distance, 4))))
        distance = np.minimum(distance, np.linalg.norm(directions - directions[chosen[-1]], axis=1))
    return np.sort(chosen)


def product(views: Array, lights: Array) -> tuple[Array, Array]:
    """`wo` and `wi` (V · L, 3) of every view with every light, view-major."""
    return np.repeat(views, len(lights), 0), np.tile(lights, (len(views), 1))


def thinned_product(directions: Array, views: int, lights: int) -> tuple[Array, Array]:
    """The `product` of a set of directions, thinned to the given numbers of views and lights."""
    return product(directions[thin(directions, views)], directions[thin(directions, lights)])


def uniform(rng: np.random.Generator, count: int, theta_max_deg: float = 75.0, theta_min_deg: float = 0.0) -> Array:
    """Directions (count, 3) float32 drawn uniformly in solid angle from θ_min up to θ_max."""
    # On a sphere, zones of equal height have equal areas, so the height is drawn uniformly.
    highest, lowest = np.cos(np.radians([theta_min_deg, theta_max_deg]))
    z = highest - rng.random(count) * (highest - lowest)
    return from_angles(np.arccos(z), rng.random(count) * 2 * np.pi)
