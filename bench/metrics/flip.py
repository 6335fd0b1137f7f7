"""ꟻLIP of pictures of low and of high dynamic range, and the colouring in which its maps are published.

Andersson et al., "FLIP: A Difference Evaluator for Alternating Images", Proc. ACM Comput. Graph. Interact. Tech. 3(2),
2020. Pictures are linear Rec. 709 RGB in [0, 1], planar. A colour difference, after the eye's contrast sensitivity at a
number of pixels per degree, is raised to a power that falls where edges or points differ:

    ΔE = ΔE_c ^ (1 − ΔE_f)   in [0, 1] a texel; lower is better; the number of a picture is the mean

Filters act on luminance and the opponents X − Y, Y − Z (each over the white point). The paper scales and shifts
these to YCxCz, but that commutes with a filter that sums to 1 and is left out.

Andersson, Nilsson, Shirley, Akenine-Möller, "Visualizing Errors in Rendered High Dynamic Range Images", Eurographics
2021 (short papers): both pictures are multiplied by 2^e, tone-mapped and clipped for N exposures e from `start` to
`stop`, and compared as LDR pictures each time; the map is the greatest difference of each texel, the number its mean:
in [0, 1], lower is better. The range follows from the reference's luminance Y: with x the radiance that the tone mapper
sends to 0.85,

    start = log2(x / max Y),   stop = log2(x / median Y),   N = max(2, ⌈stop − start⌉), equally spaced
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.ndimage import correlate1d

from bench.btf import Array
from bench.inputs.errors import InputError
from bench.metrics.base import Picture, SliceMetric
from bench.metrics.display import LUMA

PPD = 0.7 * (3840 / 0.7) * math.pi / 180  # a 0.7 m wide 4K display at 0.7 m: 67.0206

_XYZ = np.array(
    [
        [10135552 / 24577794, 8788810 / 24577794, 4435075 / 24577794],
        [2613072 / 12288897, 8788810 / 12288897, 887015 / 12288897],
        [1425312 / 73733382, 8788810 / 73733382, 70074185 / 73733382],
    ]
)
_XYZ_OVER_WHITE = _XYZ / np.array([[0.950428545], [1.0], [1.088900371]])
_OPPONENT = np.array([[0.0, 1, 0], [1, -1, 0], [0, 1, -1]]) @ _XYZ_OVER_WHITE
_RGB_OF_OPPONENT = np.linalg.inv(_OPPONENT)

# Contrast sensitivity of each opponent: sums of Gaussians a √(π/b) exp(−π² d² / b), d in degrees (section 4.1).
_SENSITIVITY = (((1.0, 0.0047),), ((1.0, 0.0053),), ((34.1, 0.04), (13.5, 0.025)))
_WIDEST = 0.04
_FEATURE_WIDTH = 0.082  # degrees (section 4.2)
_COLOUR_POWER = 0.7  # q_c
_KNEE = 0.4  # p_c
_KNEE_VALUE = 0.95  # p_t
_FEATURE_POWER = 0.5  # q_f
_BRIGHT = 0.85  # tone-mapped luminance to which `start` brings the brightest texel, and `stop` the median


class Perceived(NamedTuple):
    """The perceived features of one picture: CIELab after contrast sensitivity and the Hunt effect; edges; points."""

    lab: Array  # (3, ..., H, W)
    edge: Array  # (..., H, W)
    point: Array  # (..., H, W)


class LDR(SliceMetric):
    """FLIP of exposure × radiance clipped to [0, 1], at `ppd` pixels per degree (`InputError` if not above 0). At
    borders filters wrap around, if periodic; otherwise the border is repeated, as published."""

    def __init__(self, ppd: float = PPD, periodic: bool = False):
        self.ppd = check_ppd(ppd)
        self.periodic = periodic

    def reference_side(self, reference: Picture) -> Perceived:
        """What is perceived of the reference."""
        return perceive(reference.exposed, self.ppd, self.periodic)

    def compare(self, side: Perceived, test: Picture) -> Array:
        """The FLIP map (..., H, W) of the reference and a test."""
        return difference(side, perceive(test.exposed, self.ppd, self.periodic))


def check_ppd(ppd: float) -> float:
    """Return the pixels per degree, or raise an `InputError` if they are not a positive number."""
    if not (math.isfinite(ppd) and ppd > 0):
        raise InputError(f"ppd must be a positive number, not {ppd}")
    return float(ppd)


def perceive(planes: Array, ppd: float, periodic: bool) -> Perceived:
    """One picture's part of FLIP. `planes` is linear RGB in [0, 1], (3, ..., H, W) float64."""
    mode = "wrap" if periodic else "nearest"
    opponents = _mix(_OPPONENT, planes)
    gaussian, first, second = _feature_filters(ppd)
    luminance = opponents[0]
    # Edges and points are the lengths of the first and of the second derivatives along rows and along columns, each
    # smoothed by the Gaussian along the other axis.
    smooth = correlate1d(luminance, gaussian, -2, mode=mode)
    edge_across = correlate1d(smooth, first, -1, mode=mode)
    edge_down = _separable(luminance, first, gaussian, mode)
    edge = np.hypot(edge_across, edge_down)
    point_across = correlate1d(smooth, second, -1, mode=mode)
    point_down = _separable(luminance, second, gaussian, mode)
    point = np.hypot(point_across, point_down)
    filters = _sensitivity_filters(ppd)
    filtered = [_weighted_sum(plane, terms, mode) for plane, terms in zip(opponents, filters, strict=True)]
    colours = np.clip(_mix(_RGB_OF_OPPONENT, filtered), 0, 1)  # what of the colours the eye can tell apart
    return Perceived(_hunt_lab(colours), edge, point)


def difference(one: Perceived, other: Perceived) -> Array:
    """The FLIP map (..., H, W) in [0, 1] of two pictures; symmetric."""
    colour = _redistribute(_hyab(one.lab, other.lab))
    edge = np.abs(one.edge - other.edge)
    point = np.abs(one.point - other.point)
    feature = (np.maximum(edge, point) / math.sqrt(2)) ** _FEATURE_POWER
    return colour ** (1 - feature)


def _mix(matrix: Array, planes: Array | list[Array]) -> Array:
    """A 3 × 3 matrix applied to the three channels of planar pictures (3, ..., H, W); the same shape, float64."""
    out = np.empty((3, *planes[0].shape))
    term = np.empty(planes[0].shape)  # memory for one product, used again
    for row, weights in zip(out, matrix, strict=True):
        np.multiply(planes[0], weights[0], out=row)
        for plane, weight in zip(planes[1:], weights[1:], strict=True):
            row += np.multiply(plane, weight, out=term)
    return out


def _separable(plane: Array, down: Array, across: Array, mode: str) -> Array:
    """A plane (..., H, W) filtered by one kernel along columns (down), then by another along rows (across)."""
    return correlate1d(correlate1d(plane, down, -2, mode=mode), across, -1, mode=mode)


def _weighted_sum(plane: Array, terms: tuple[tuple[float, Array], ...], mode: str) -> Array:
    """A plane (..., H, W) under a sum of separable filters, each a weight and the kernel of both axes."""
    (first_weight, first_kernel), *others = terms
    total = first_weight * _separable(plane, first_kernel, first_kernel, mode)
    for weight, kernel in others:
        total += weight * _separable(plane, kernel, kernel, mode)
    return total


@lru_cache(maxsize=16)
def _sensitivity_filters(ppd: float) -> tuple[tuple[tuple[float, Array], ...], ...]:
    """For each opponent, (weight, 1-D kernel) whose weighted outer squares make its filter; weights sum to 1."""
    # Three standard deviations of the widest Gaussian: exp(−π² d² / b) has σ² = b / (2 π²).
    radius = math.ceil(3 * math.sqrt(_WIDEST / (2 * math.pi**2)) * ppd)
    degrees = np.arange(-radius, radius + 1) / ppd
    filters = []
    for gaussians in _SENSITIVITY:
        kernels = [np.exp(-(math.pi**2) * degrees**2 / b) for _, b in gaussians]
        # What each Gaussian adds to the sum of the whole 2-D filter, before that sum is made 1.
        masses = []
        for (a, b), kernel in zip(gaussians, kernels, strict=True):
            masses.append(a * math.sqrt(math.pi / b) * kernel.sum() ** 2)
        terms = []
        for mass, kernel in zip(masses, kernels, strict=True):
            terms.append((mass / sum(masses), kernel / kernel.sum()))
        filters.append(tuple(terms))
    return tuple(filters)


@lru_cache(maxsize=16)
def _feature_filters(ppd: float) -> tuple[Array, Array, Array]:
    """1-D kernels: a Gaussian that sums to 1, its first and its second derivative, balanced as by `_balance`."""
    sigma = 0.5 * _FEATURE_WIDTH * ppd
    radius = math.ceil(3 * sigma)
    x = np.arange(-radius, radius + 1)
    gaussian = np.exp(-(x**2) / (2 * sigma**2))
    # The derivatives but for factors, which `_balance` replaces.
    first = -x * gaussian
    second = (x**2 / sigma**2 - 1) * gaussian
    return gaussian / gaussian.sum(), _balance(first), _balance(second)


def _balance(kernel: Array) -> Array:
    """A kernel whose positive numbers are scaled to the sum 1, and its negative ones to the sum −1."""
    positive = np.maximum(kernel, 0)
    negative = np.minimum(kernel, 0)
    return positive / positive.sum() - negative / negative.sum()


def _hunt_lab(planes: Array) -> Array:
    """Linear RGB (3, ..., H, W) → CIELab of the same shape, with a and b scaled by 0.01 · L (the Hunt effect)."""
    delta = 6 / 29
    linear = _mix(_XYZ_OVER_WHITE, planes)
    root = np.cbrt(linear)
    # CIELab replaces the cube root by a line near 0.
    low = linear <= delta**3
    root[low] = linear[low] / (3 * delta**2) + 4 / 29
    x, y, z = root
    lightness = 116 * y - 16
    strength = 0.01 * lightness
    return np.stack([lightness, 500 * (x - y) * strength, 200 * (y - z) * strength])


def _hyab(one: Array, other: Array) -> Array:
    """HyAB distance (..., H, W) of planar CIELab pictures: |difference of L| plus the Euclidean distance of a and b."""
    return np.abs(one[0] - other[0]) + np.hypot(one[1] - other[1], one[2] - other[2])


def _redistribute(distance: Array) -> Array:
    """HyAB → [0, 1]: a power, then linear to 0.95 below 0.4 of the greatest distance and linear to 1 above."""
    powered = distance**_COLOUR_POWER
    knee = _KNEE * _greatest()
    low = powered * (_KNEE_VALUE / knee)
    high = _KNEE_VALUE + (powered - knee) * ((1 - _KNEE_VALUE) / (_greatest() - knee))
    return np.where(powered < knee, low, high)


@lru_cache(maxsize=1)
def _greatest() -> float:
    """The distance from green to blue, the greatest in the gamut, to the power of `_COLOUR_POWER`: 41.27610."""
    green = np.array([0.0, 1, 0]).reshape(3, 1)
    blue = np.array([0.0, 0, 1]).reshape(3, 1)
    return float(_hyab(_hunt_lab(green), _hunt_lab(blue))[0] ** _COLOUR_POWER)


class Range(NamedTuple):
    """Exposures in stops, from the darkest picture to the brightest."""

    start: float
    stop: float

    def steps(self) -> Array:
        """The exposures (N,) in stops at which pictures are compared, equally spaced; at least two."""
        return np.linspace(self.start, self.stop, max(2, math.ceil(self.stop - self.start)))


class HDR(SliceMetric):
    """FLIP over a range of exposures, tone-mapped by ACES as fitted by Narkowicz (2015).

    Without `start` and `stop` the range is that of each reference, as published; a reference that is black over more
    than half of it has none and raises `InputError`. Within a material every slice has the range of the whole material,
    which `for_material` finds from the luminances above 0 in its sample. The exposure of the display is not used.
    """

    per_material = True
    # (k0 x² + k1 x + k2) / (k3 x² + k4 x + k5)
    curve: tuple[float, float, float, float, float, float] = (0.36 * 2.51, 0.6 * 0.03, 0, 0.36 * 2.43, 0.6 * 0.59, 0.14)

    def __init__(self, ppd: float = PPD, periodic: bool = False, start: float | None = None, stop: float | None = None):
        """`ppd`: pixels per degree. `start` and `stop`: the exposures in stops; None: chosen by the reference, as
        published. `InputError` if `ppd` is not above 0, or if only one of both is given or they are no range."""
        self.ppd = check_ppd(ppd)
        self.periodic = periodic
        if (start is None) != (stop is None):
            raise InputError("start and stop belong together: give both, or neither")
        self.range: Range | None = None
        if start is not None and stop is not None:
            if not (math.isfinite(start) and math.isfinite(stop) and start <= stop):
                raise InputError(f"start must not exceed stop, both finite: {start}, {stop}")
            self.range = Range(float(start), float(stop))

    def for_material(self, sample: Array) -> "HDR":
        """The same with the range of exposures for a sample (n, 3) of a material's radiance, in place of any other.

        It is that of the luminances above 0; of a black sample the one exposure 0.
        """
        luminance = np.maximum(sample, 0) @ LUMA
        lit = luminance[luminance > 0]
        start, stop = self.range_of(lit) if len(lit) else (0.0, 0.0)
        return type(self)(self.ppd, self.periodic, start, stop)

    def fixed(self) -> dict[str, float]:
        return self.range._asdict() if self.range else {}

    def range_of(self, luminance: Array) -> Range:
        """The published range for luminances of any shape; raises `InputError` if over half of them are 0."""
        # Of an even count the upper of both in the middle, not their mean.
        middle = np.sort(luminance, axis=None)[luminance.size // 2]
        if not middle > 0:
            fault = "reference is black over more than half of it, so FLIP has no exposures"
            raise InputError(f"{fault}: give start and stop")
        # The curve is `_BRIGHT` where its numerator − `_BRIGHT` · its denominator, a polynomial of x, is 0.
        numerator, denominator = np.reshape(self.curve, (2, 3))
        roots = np.roots(numerator - _BRIGHT * denominator)
        bright = float(roots.real.max())  # the larger root of a quadratic, or the root of a line
        return Range(math.log2(bright / luminance.max()), math.log2(bright / middle))

    def reference_side(self, reference: Picture) -> tuple[Array, tuple[Perceived, ...]]:
        """The exposures in stops, and what is perceived of the reference at each.

        `InputError` if there is no range yet, and the reference is a stack or too black for one.
        """
        is_stack = len(reference.shape) > 2  # (..., H, W), without the channels
        if not self.range and is_stack:
            raise InputError("reference is a stack, each with exposures of its own: give start and stop")
        exposures = self.range or self.range_of(np.tensordot(LUMA, reference.linear, 1))
        steps = exposures.steps()
        return steps, tuple(self._perceive(reference, step) for step in steps)

    def compare(self, side: tuple[Array, tuple[Perceived, ...]], test: Picture) -> Array:
        """The greatest FLIP (..., H, W) of each texel over the exposures."""
        steps, references = side
        worst = difference(references[0], self._perceive(test, steps[0]))
        for step, reference in zip(steps[1:], references[1:], strict=True):
            np.maximum(worst, difference(reference, self._perceive(test, step)), out=worst)
        return worst

    def tone_map(self, planes: Array) -> Array:
        """Planar linear RGB (3, ..., H, W), at least 0 → tone-mapped, not yet clipped."""
        k0, k1, k2, k3, k4, k5 = self.curve
        # Divided by x²: a radiance whose square overflows still maps to k0 / k3.
        inverse = 1 / np.maximum(planes, 1e-150)
        mapped = (k0 + (k1 + k2 * inverse) * inverse) / (k3 + (k4 + k5 * inverse) * inverse)
        return np.where(planes > 1e-150, mapped, 0)

    def _perceive(self, picture: Picture, step: float) -> Perceived:
        """What is perceived of a picture at an exposure in stops, tone-mapped and clipped."""
        mapped = self.tone_map(picture.linear * 2.0**step)
        return perceive(np.clip(mapped, 0, 1), self.ppd, self.periodic)


class Hable(HDR):
    """Hable's filmic curve (2010), white at 11.2, as FLIP publishes its coefficients."""

    curve = (0.231683, 0.013791, 0, 0.18, 0.3, 0.018)


class Reinhard(HDR):
    """Reinhard's Y / (1 + Y) of luminance (2002), colours scaled with it."""

    curve = (0, 1, 0, 0, 1, 1)  # of luminance; here only `range_of` uses it

    def tone_map(self, planes: Array) -> Array:
        luminance = LUMA[0] * planes[0] + LUMA[1] * planes[1] + LUMA[2] * planes[2]
        return planes / (1 + luminance)


def magma(error_map: Array) -> Array:
    """A map (..., H, W) in [0, 1] → sRGB in [0, 1], (..., H, W, 3) float32, each value rounded to one of 256 colours
    of magma (van der Walt and Smith, 2015), black for no difference. Raises `InputError` for values outside [0, 1] or
    of another type."""
    error_map = np.asarray(error_map)
    if not (np.issubdtype(error_map.dtype, np.floating) and ((error_map >= 0) & (error_map <= 1)).all()):
        raise InputError("error_map must hold floating-point values in [0, 1]")
    nearest = np.floor(error_map * 255 + 0.5).astype(np.intp)
    return _colours()[nearest]


@lru_cache(maxsize=1)
def _colours() -> Array:
    """The 256 colours of magma, (256, 3) float32 sRGB."""
    import matplotlib  # its table is the published one; imported late because that is slow

    return np.array(matplotlib.colormaps["magma"](np.arange(256))[:, :3], np.float32)
