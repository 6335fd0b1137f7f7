"""Tells from scattered pairs whether the light's frame is that of the view, by the half vectors of pairs.

Of most surfaces brightness depends on the half vector between view and light: it is highest where that is the normal.
So the half vectors as given should explain more of it than those with one axis of the light mirrored, or with its axes
exchanged. What depends on θ_o or θ_i alone tells nothing, and is fitted first.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bench.btf import Array

LEAST_PAIRS = 40  # pairs; of fewer, the curves that are fitted would follow noise
CLEAR = (0.5, 2.0)  # another frame explains at least this share, and this many times that of the one given
# Name → the light's direction in another frame, of (N, 3).
FRAMES: dict[str, Callable[[Array], Array]] = {
    "as given": lambda wi: wi,
    "the light's y mirrored": lambda wi: wi * [1, -1, 1],
    "the light's x mirrored": lambda wi: wi * [-1, 1, 1],
    "the light's x and y exchanged": lambda wi: wi[:, [1, 0, 2]],
}


@dataclass(frozen=True)
class HalfVectors:
    """The share of the variation of brightness that half vectors explain, frame by frame."""

    count: int  # pairs
    shares: dict[str, float]  # name of a frame → share

    @property
    def likely(self) -> str:
        """The frame that the data seem to have: as given, if no other one explains clearly more."""
        least_share, times_better = CLEAR
        best = max(self.shares, key=lambda frame: self.shares[frame])
        is_clear = self.shares[best] >= max(least_share, times_better * self.shares["as given"])
        return best if is_clear else "as given"


def half_vectors(wo: Array, wi: Array, means: Array) -> HalfVectors | None:
    """How much of the means (N,) of slices half vectors of the pairs explain; wo and wi are (N, 3), with z > 0.

    None for too few lit pairs, and where angles from the normal explain all.
    """
    lit = means > 0
    wo, wi = np.asarray(wo, np.float64)[lit], np.asarray(wi, np.float64)[lit]
    if lit.sum() < LEAST_PAIRS:
        return None
    values = np.log(means[lit])
    cos_o, cos_i = wo[:, 2], wi[:, 2]
    of_angles = [np.ones(len(values)), np.log(cos_o), np.log(cos_i), cos_o, cos_i, cos_o * cos_i]
    rest = _unexplained(of_angles, values)
    total = float((rest**2).sum())
    if not total > 1e-9 * len(values):
        return None
    shares = {}
    for frame, light_in_frame in FRAMES.items():
        half = wo + light_in_frame(wi)
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        cos_h, cos_d = half[:, 2], (half * wo).sum(1)
        curves = [cos_h, cos_h**2, cos_h**4, cos_h**8, cos_d, cos_d**2]
        rest_of_frame = _unexplained([*of_angles, *curves], values)
        shares[frame] = 1 - float((rest_of_frame**2).sum()) / total
    return HalfVectors(int(lit.sum()), shares)


def _unexplained(curves: list[Array], values: Array) -> Array:
    """What a least-squares fit of curves (N,) leaves of values (N,)."""
    matrix = np.stack(curves, -1)
    amplitudes = np.linalg.lstsq(matrix, values, rcond=None)[0]
    return values - matrix @ amplitudes
