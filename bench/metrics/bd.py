"""Bjøntegaard deltas between two rate–distortion curves: Bjøntegaard, VCEG-M33, 2001, with the piecewise cubic
(PCHIP) interpolation of later common test conditions.

    BD-rate = 10^(mean over the shared qualities of log10 rate_test − log10 rate_anchor) − 1   in %, lower is better
    BD-PSNR = mean over the shared log rates of quality_test − quality_anchor                  in dB, higher is better
"""

from typing import NamedTuple

import numpy as np

from bench.errors import InputError

Array = np.ndarray

FEWEST = 3  # a cubic through all points needs four; a piecewise one needs three


class Delta(NamedTuple):
    """A Bjøntegaard delta and the stretch on which it is computed.

    `value` is in % for a rate and in the quality's unit for a quality. The curves share the stretch from `low` to
    `high`, of quality for BD-rate and of rate for BD-PSNR; `overlap` is its part of all that the two cover, on the
    axis of integration.
    """

    value: float
    low: float
    high: float
    overlap: float


def bd_rate(anchor: Array, test: Array) -> Delta:
    """How many percent more bytes the test needs for equal quality.

    Each curve is (n, 2): rate (positive, any unit, the same in both) and quality (PSNR in dB, or any other number
    that is better when higher), n ≥ 3, in any order. Raises `InputError` for fewer points, values that are not
    finite, two points of equal quality, or curves that share no quality.
    """
    (rate, quality), (test_rate, test_quality) = _curve(anchor, "anchor"), _curve(test, "test")
    mean, low, high, overlap = _mean_difference(
        (quality, np.log10(rate)), (test_quality, np.log10(test_rate)), "quality"
    )
    return Delta((10**mean - 1) * 100, low, high, overlap)


def bd_psnr(anchor: Array, test: Array) -> Delta:
    """How much better the test is at equal rate, in the quality's unit. Arguments and errors as for `bd_rate`."""
    (rate, quality), (test_rate, test_quality) = _curve(anchor, "anchor"), _curve(test, "test")
    mean, low, high, overlap = _mean_difference((np.log10(rate), quality), (np.log10(test_rate), test_quality), "rate")
    return Delta(mean, 10**low, 10**high, overlap)


def _curve(points: Array, name: str) -> tuple[Array, Array]:
    points = np.asarray(points, np.float64)
    if points.ndim != 2 or points.shape[1] != 2:
        raise InputError(f"{name} must be (n, 2), rate and quality, not {points.shape}")
    if len(points) < FEWEST:
        raise InputError(f"{name} has {len(points)} points, and a Bjøntegaard delta needs at least {FEWEST}")
    if not np.isfinite(points).all() or (points[:, 0] <= 0).any():
        raise InputError(f"{name} must hold positive rates and finite qualities")
    return points[:, 0], points[:, 1]


def _mean_difference(
    anchor: tuple[Array, Array], test: tuple[Array, Array], axis: str
) -> tuple[float, float, float, float]:
    """Mean of test − anchor over the shared stretch of x, and that stretch; each curve is (x, y)."""
    from scipy.interpolate import PchipInterpolator  # slow to import, and needed only here

    curves = []
    for name, (x, y) in (("anchor", anchor), ("test", test)):
        order = np.argsort(x)
        if (np.diff(x[order]) <= 0).any():
            raise InputError(f"{name} has two points of equal {axis}")
        curves.append(PchipInterpolator(x[order], y[order]))
    low, high = max(anchor[0].min(), test[0].min()), min(anchor[0].max(), test[0].max())
    if not high > low:
        raise InputError(f"the curves of anchor and test share no {axis}, so there is no delta")
    whole = max(anchor[0].max(), test[0].max()) - min(anchor[0].min(), test[0].min())
    area = curves[1].integrate(low, high) - curves[0].integrate(low, high)
    return float(area / (high - low)), float(low), float(high), float((high - low) / whole)
