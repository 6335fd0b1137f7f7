"""Checks that every reader makes before it returns a BTF: directions and duplicates."""

from collections.abc import Callable

import numpy as np

from bench.errors import InputError

Array = np.ndarray
HORIZON = 1e-6


def unit_directions(vectors: Array, label: Callable[[int], str], tolerance: float = 1e-3) -> Array:
    """Unit vectors (N, 3) float32 from finite vectors above the horizon, whose length is 1 within `tolerance`."""
    with np.errstate(over="ignore", invalid="ignore"):
        vectors = np.asarray(vectors, np.float64)
        length = np.linalg.norm(vectors, axis=1)
    good = np.isfinite(length) & (np.abs(length - 1) <= tolerance)
    if not good.all():
        row = int(np.argmin(good))
        raise InputError(f"{label(row)}: {_listed(vectors[row])} is not a unit vector: give x y z of length 1")
    above = vectors[:, 2] > HORIZON
    if not above.all():
        row = int(np.argmin(above))
        raise InputError(
            f"{label(row)}: {_listed(vectors[row])} is not above the surface (z > 0): leave this entry out"
        )
    return (vectors / length[:, None]).astype(np.float32)


def angles_in_range(theta: Array, phi: Array, label: Callable[[int], str], what: str = "") -> None:
    """Raise `InputError` unless every θ (radians) lies in [0°, 90°) and every φ in [−360°, 360°]."""
    with np.errstate(over="ignore", invalid="ignore"):
        theta_deg, phi_deg = np.degrees(np.asarray(theta, np.float64)), np.degrees(np.asarray(phi, np.float64))
        steep = ~((theta_deg >= -1e-4) & (np.cos(np.radians(theta_deg)) > HORIZON) & (theta_deg < 90.0))
        wound = ~(np.abs(phi_deg) <= 360.001)
    for bad, symbol, value, bounds in ((steep, "theta", theta_deg, "[0, 90)"), (wound, "phi", phi_deg, "[-360, 360]")):
        if bad.any():
            row = int(np.argmax(bad))
            raise InputError(
                f"{label(row)}: {symbol}{what} = {value[row]:g} degrees is outside {bounds}: "
                "correct the angle or leave the entry out"
            )


def no_duplicates(wo: Array, wi: Array, label: Callable[[int], str]) -> None:
    """Raise `InputError` if two of the pairs (wo[i], wi[i]), each (N, 3), are equal; it names both."""
    key = np.round(np.concatenate([wo, wi], 1).astype(np.float64), 6) + 0.0
    order = np.lexsort(key.T[::-1])
    same = np.flatnonzero((key[order[1:]] == key[order[:-1]]).all(1))
    if len(same):
        first, second = sorted((int(order[same[0]]), int(order[same[0] + 1])))
        raise InputError(f"{label(second)}: it has the same view and light as {label(first)}: leave one of the two out")


def view_major(wo: Array, wi: Array) -> Array:
    """The order (N,) that sorts pairs by view, then by light, each by θ and then φ."""
    angles = [angle for side in (wi, wo) for angle in _sort_angles(side)]
    return np.lexsort(angles)


def _sort_angles(directions: Array) -> tuple[Array, Array]:
    """φ and θ of directions (N, 3), rounded so that the last bit does not decide the order."""
    x, y, z = np.asarray(directions, np.float64).T
    phi = np.round(np.degrees(np.arctan2(y, x)) % 360.0, 3) % 360.0
    theta = np.round(np.degrees(np.arctan2(np.hypot(x, y), z)), 3)
    return np.where(theta == 0, 0.0, phi), theta


def _listed(vector: Array) -> str:
    return "(" + ", ".join(f"{value:g}" for value in vector) + ")"
