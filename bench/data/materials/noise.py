"""Periodic building blocks of procedural materials, all (size, size) float64 with row 0 at the top."""

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from bench.btf import Array
from bench.metrics.display import decode_srgb


def grid(size: int) -> tuple[Array, Array]:
    """u and v of every texel centre, v upwards."""
    centre = (np.arange(size) + 0.5) / size
    u, v = np.meshgrid(centre, 1 - centre)
    return u, v


def smooth(rng: np.random.Generator, size: int, sigma_v: float, sigma_u: float) -> Array:
    """Gaussian-filtered white noise, zero mean and unit deviation; sigmas in texture units, periodic."""
    field = gaussian_filter(rng.normal(size=(size, size)), (sigma_v * size, sigma_u * size), mode="wrap")
    return (field - field.mean()) / field.std()


def to_scattered(rng: np.random.Generator, size: int, cells: int, jitter: float) -> tuple[Array, Array]:
    """Distances to the nearest and the second nearest of cells² points, one scattered in each cell."""
    corner = np.stack(np.meshgrid(np.arange(cells), np.arange(cells)), -1).reshape(-1, 2)
    points = (corner + 0.5 + rng.uniform(-jitter, jitter, corner.shape)) / cells % 1.0
    nearest, _ = cKDTree(points, boxsize=1.0).query(np.stack(grid(size), -1), k=2)
    return nearest[..., 0], nearest[..., 1]


def normalised(picture: Array) -> Array:
    """The picture stretched to [0, 1]."""
    return (picture - picture.min()) / np.ptp(picture)


def mix(a: Array, b: Array, weight: Array) -> Array:
    """Blend two colours (3,) by a weight (H, W): (H, W, 3)."""
    return np.asarray(a) + (np.asarray(b) - np.asarray(a)) * weight[..., None]


def srgb(*codes: float) -> Array:
    """A colour of sRGB codes in [0, 255] as linear Rec. 709 (IEC 61966-2-1)."""
    return decode_srgb(np.array(codes) / 255)
