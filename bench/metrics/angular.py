"""Errors by direction: grazing bands and polar maps. Numbers only, no drawing.

To *pool* raw numbers of pairs is to make one of several, in the metric's unit: for PSNR the decibels of their mean.
Angles are of the local frame of `bench.btf`; degrees, because these are tables.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from bench.btf import Array
from bench.directions.hemisphere import to_degrees

Pool = Callable[[Array], float]

GRAZING_DEG = 60.0
THETA_EDGES_DEG = (0.0, 15.0, 30.0, 45.0, 60.0, 75.0, 90.0)
RINGS = len(THETA_EDGES_DEG) - 1
SECTORS = 12


def grazing(directions: Array) -> Array:
    """Mask (N,) of the directions more than 60° from the normal."""
    theta, _ = to_degrees(directions)
    return theta > GRAZING_DEG + 1e-4  # up to the rounding of float32: a direction at 60° is not grazing


def polar_map(directions: Array, raw: Array, pool: Pool) -> dict[str, Any]:
    """One number for each cell of a hemisphere, pooled over all pairs whose direction falls there.

    `directions` are (N, 3), `raw` (N,), the numbers of the pairs; `pool` combines those of a cell.

    Cells are rings of 15° in θ by sectors of 30° in φ, the first sector centred on +x; the innermost ring is one
    cell, the same number in each sector. Gives `theta_edges_deg`, `phi_centres_deg` and `value` (rings × sectors, None
    where empty).
    """
    sector_deg = 360 / SECTORS
    _, phi = to_degrees(directions)
    ring_of = _ring(directions)
    # Shifted by half a sector, because the first is centred on φ = 0, and counted around the circle.
    sector_of = np.floor((phi + sector_deg / 2) / sector_deg).astype(int) % SECTORS
    values: list[list[float | None]] = []
    for ring in range(RINGS):
        in_ring = ring_of == ring
        if ring == 0:  # one cell
            cells = [in_ring] * SECTORS
        else:
            cells = [in_ring & (sector_of == sector) for sector in range(SECTORS)]
        values.append([_pooled(raw[cell], pool) for cell in cells])
    centres = [sector_deg * sector for sector in range(SECTORS)]
    return {"theta_edges_deg": list(THETA_EDGES_DEG), "phi_centres_deg": centres, "value": values}


def _ring(directions: Array) -> Array:
    """The ring (N,), from 0, of 15° in θ into which each direction (N, 3) falls; below the horizon the last one."""
    theta, _ = to_degrees(directions)
    # Float32 directions of a grid at 15°, 30°, … may fall a hair below their edge.
    edges_reached = np.searchsorted(THETA_EDGES_DEG, theta + 1e-4, side="right")
    return np.clip(edges_reached - 1, 0, RINGS - 1)


def _pooled(raw: Array, pool: Pool) -> float | None:
    """Some raw numbers (n,) pooled, without NaN; None if no number is left, or if they give no finite one."""
    raw = raw[~np.isnan(raw)]
    return as_number(pool(raw)) if len(raw) else None


def as_number(value: float) -> float | None:
    """A finite float, else None: JSON has no infinity, and an exact slice is counted beside it."""
    return float(value) if np.isfinite(value) else None
