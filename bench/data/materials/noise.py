"""Periodic building blocks of procedural materials, all (size, size) float64 with row 0 at the top."""

import numpy as np
from scipy.ndimage import gaussian_filter

from bench.metrics.display import decode_srgb

Array = np.ndarray


def grid(size: int) -> tuple[Array, Array]:
    """u and v of every texel centre, v upwards."""
    centre = (np.arange(size) + 0.5) / size
    u, v = np.meshgrid(centre, 1 - centre)
    return u, v


def smooth(rng: np.random.Generator, size: int, sigma_v: float, sigma_u: float) -> Array:
    """Gaussian-filtered white noise, zero mean and unit deviation; sigmas in texture units, periodic."""
    field = gaussian_filter(rng.normal(size=(size, size)), (sigma_v * size, sigma_u * size), mode="wrap")
    return (field - field.mean()) / field.std()


def normalised(picture: Array) -> Array:
    """The picture stretched to [0, 1]."""
    return (picture - picture.min()) / np.ptp(picture)


def mix(a: Array, b: Array, weight: Array) -> Array:
    """Blend two colours (3,) by a weight (H, W): (H, W, 3)."""
    return np.asarray(a) + (np.asarray(b) - np.asarray(a)) * weight[..., None]


def srgb(*codes: float) -> Array:
    """A colour of sRGB codes in [0, 255] as linear Rec. 709 (IEC 61966-2-1)."""
    return decode_srgb(np.array(codes) / 255)
