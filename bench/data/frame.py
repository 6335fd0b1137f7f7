"""Checks the frame of a BTF by its mean lobe: do the azimuths of views and lights turn the same way?

The answers of an isotropic surface depend on the azimuth between view and light, φ_i − φ_o. If one of them was measured
clockwise and the other counter-clockwise, the lobe depends on φ_i + φ_o instead.
"""

from dataclasses import dataclass

import numpy as np

from bench.btf import BTF, Array, Layout
from bench.directions.hemisphere import to_degrees

AZIMUTHS = 6  # azimuths of views, and of lights: 36 slices are read
LEAST = 5  # azimuths of views, and of lights; with fewer the two cannot be told apart
HARMONICS = 2
STEEP = 50.0  # degrees; nearer the normal, the lobe of a weave along one axis can follow the sum
CLEAR = (0.5, 2.0)  # a mirrored side explains at least this share, and this many times the share of the given frame


@dataclass(frozen=True)
class MeanLobe:
    """The shares of the mean lobe at θ_o = θ_i that φ_i − φ_o and φ_i + φ_o explain, and the former's peak."""

    theta_deg: float
    given: float
    mirrored: float
    peak_deg: float

    @property
    def looks_mirrored(self) -> bool:
        share, times = CLEAR
        return self.theta_deg >= STEEP and self.mirrored >= max(share, times * self.given)


def mean_lobe(btf: BTF) -> MeanLobe | None:
    """The lobe of slices' means at the outermost ring of directions that views and lights share; None without one.

    Each mean is divided by cos θ_i, and by the mean of its view and of its light; two harmonics of each azimuth are
    fitted to the rest. The training pairs must be a product of views and lights.
    """
    pairs = np.arange(len(btf)) if btf.heldout is None else np.flatnonzero(~btf.heldout)
    layout = Layout.of(btf.wo[pairs], btf.wi[pairs])
    if layout.grid is None or not (ring := _ring(layout)):
        return None
    theta, views, lights = ring
    chosen = pairs[layout.grid[np.ix_(views, lights)]]
    means = np.array([[btf[pair].mean(dtype=np.float64) for pair in row] for row in chosen.tolist()])
    if means.min() <= 0:
        return None
    means /= layout.lights[lights, 2]
    rest = means / means.mean(1, keepdims=True)
    rest = rest / rest.mean(0) - 1
    if not (total := float((rest**2).sum())) > 1e-9 * rest.size:
        return None
    phi_o, phi_i = (np.radians(to_degrees(side)[1]) for side in (layout.views[views], layout.lights[lights]))
    share, coefficients = _explained(rest, phi_i - phi_o[:, None])
    mirrored_share, _ = _explained(rest, phi_i + phi_o[:, None])
    around = np.arange(360.0)
    peak = around[np.argmax(_waves(np.radians(around)) @ coefficients)]
    return MeanLobe(theta, share / total, mirrored_share / total, float(peak))


def _ring(layout: Layout) -> tuple[float, Array, Array] | None:
    """θ of the outermost ring of both sides in degrees, and the indices of views and lights spread around it."""
    sides = [to_degrees(side) for side in (layout.views, layout.lights)]
    for degrees in range(85, 4, -1):
        rings = [np.flatnonzero(np.abs(theta - degrees) <= 0.5) for theta, _ in sides]
        chosen = [ring[_spread(phi[ring])] for ring, (_, phi) in zip(rings, sides, strict=True)]
        if min(map(len, chosen)) >= LEAST:
            return float(sides[0][0][chosen[0]].mean()), *chosen
    return None


def _spread(phi: Array) -> Array:
    """Indices of at most `AZIMUTHS` azimuths (degrees), each the nearest to one of as many evenly spaced ones."""
    if not len(phi):
        return np.zeros(0, int)
    wanted = phi.min() + np.arange(AZIMUTHS) * 360.0 / AZIMUTHS
    apart = np.abs((phi[:, None] - wanted + 180) % 360 - 180)
    return np.unique(apart.argmin(0))


def _waves(angle: Array) -> Array:
    """The harmonics (..., 2 · HARMONICS) of angles (...)."""
    return np.stack([wave(k * angle) for k in range(1, HARMONICS + 1) for wave in (np.cos, np.sin)], -1)


def _explained(rest: Array, angle: Array) -> tuple[float, Array]:
    """The part of the squares of `rest` (views, lights) that harmonics of the angles explain, and their amplitudes."""
    waves = _waves(angle)
    waves = waves - waves.mean(0) - waves.mean(1, keepdims=True) + waves.mean((0, 1))
    flat = waves.reshape(rest.size, -1)
    coefficients = np.linalg.lstsq(flat, rest.reshape(-1), rcond=None)[0]
    left = rest.reshape(-1) - flat @ coefficients
    return float((rest**2).sum() - (left**2).sum()), coefficients
