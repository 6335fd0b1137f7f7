"""ꟻLIP of high-dynamic-range pictures: Andersson, Nilsson, Shirley, Akenine-Möller, "Visualizing Errors in Rendered
High Dynamic Range Images", Eurographics 2021 (short papers).

Both pictures are multiplied by 2^e, tone-mapped and clipped for N exposures e from `start` to `stop`, and compared as
LDR pictures each time; the map is the greatest difference of each texel, the number its mean: in [0, 1], lower is
better. The range follows from the reference's luminance Y: with x the radiance that the tone mapper sends to 0.85,

    start = log2(x / max Y),   stop = log2(x / median Y),   N = max(2, ⌈stop − start⌉), equally spaced
"""

import math
from typing import NamedTuple

import numpy as np

from bench.btf import Array
from bench.inputs.errors import InputError
from bench.metrics.base import SliceMetric
from bench.metrics.display import LUMA
from bench.metrics.flip import PPD, Perceived, check_ppd, difference, perceive
from bench.metrics.picture import Picture

_BRIGHT = 0.85


class Range(NamedTuple):
    """Exposures in stops, from the darkest picture to the brightest."""

    start: float
    stop: float

    def steps(self) -> Array:
        return np.linspace(self.start, self.stop, max(2, math.ceil(self.stop - self.start)))


class HDR(SliceMetric):
    """FLIP over a range of exposures, tone-mapped by ACES as fitted by Narkowicz (2015).

    Without `start` and `stop` the range is that of each reference, as published; a reference that is black over half of
    it or more has none and raises `InputError`. Within a material every slice has the range of the whole material,
    which `for_material` finds from the luminances above 0 in its sample. The exposure of the display is not used.
    """

    per_material = True
    # (k0 x² + k1 x + k2) / (k3 x² + k4 x + k5)
    curve: tuple[float, float, float, float, float, float] = (0.36 * 2.51, 0.6 * 0.03, 0, 0.36 * 2.43, 0.6 * 0.59, 0.14)

    def __init__(self, ppd: float = PPD, periodic: bool = False, start: float | None = None, stop: float | None = None):
        self.ppd, self.periodic = check_ppd(ppd), periodic
        if (start is None) != (stop is None):
            raise InputError("start and stop belong together: give both, or neither")
        self.range: Range | None = None
        if start is not None and stop is not None:
            if not (math.isfinite(start) and math.isfinite(stop) and start <= stop):
                raise InputError(f"start must not exceed stop, both finite: {start}, {stop}")
            self.range = Range(float(start), float(stop))

    def for_material(self, sample: Array) -> "HDR":
        luminance = np.maximum(sample, 0) @ LUMA
        lit = luminance[luminance > 0]
        start, stop = self.range_of(lit) if len(lit) else (0.0, 0.0)
        return type(self)(self.ppd, self.periodic, start, stop)

    def fixed(self) -> dict[str, float]:
        return self.range._asdict() if self.range else {}

    def range_of(self, luminance: Array) -> Range:
        """The published range for luminances of any shape; raises `InputError` if their median is 0."""
        middle = np.sort(luminance, axis=None)[luminance.size // 2]
        if not middle > 0:
            fault = "reference is black over half of it or more, so FLIP has no exposures"
            raise InputError(f"{fault}: give start and stop")
        k = self.curve
        roots = np.roots([k[i] - _BRIGHT * k[i + 3] for i in range(3)])
        white = float(roots.real.max())  # the larger root of a quadratic, or the root of a line
        return Range(math.log2(white / luminance.max()), math.log2(white / middle))

    def reference_side(self, reference: Picture) -> tuple[Array, tuple[Perceived, ...]]:
        if not self.range and len(reference.shape) > 2:
            raise InputError("reference is a stack, each with exposures of its own: give start and stop")
        steps = (self.range or self.range_of(np.tensordot(LUMA, reference.linear, 1))).steps()
        return steps, tuple(self._perceive(reference, step) for step in steps)

    def compare(self, side: tuple[Array, tuple[Perceived, ...]], test: Picture) -> Array:
        steps, seen = side
        worst = difference(seen[0], self._perceive(test, steps[0]))
        for step, one in zip(steps[1:], seen[1:], strict=True):
            np.maximum(worst, difference(one, self._perceive(test, step)), out=worst)
        return worst

    def tone_map(self, planes: Array) -> Array:
        """Planar linear RGB (3, ..., H, W), at least 0 → tone-mapped, not yet clipped."""
        k0, k1, k2, k3, k4, k5 = self.curve
        # Divided by x²: a radiance whose square overflows still maps to k0 / k3.
        inverse = 1 / np.maximum(planes, 1e-150)
        mapped = (k0 + (k1 + k2 * inverse) * inverse) / (k3 + (k4 + k5 * inverse) * inverse)
        return np.where(planes > 1e-150, mapped, 0)

    def _perceive(self, picture: Picture, step: float) -> Perceived:
        mapped = self.tone_map(picture.linear * 2.0**step)
        return perceive(np.clip(mapped, 0, 1), self.ppd, self.periodic)


class Hable(HDR):
    """Hable's filmic curve (2010), white at 11.2, as FLIP publishes its coefficients."""

    curve = (0.231683, 0.013791, 0, 0.18, 0.3, 0.018)


class Reinhard(HDR):
    """Reinhard's Y / (1 + Y) of luminance (2002), colours scaled with it."""

    curve = (0, 1, 0, 0, 1, 1)

    def tone_map(self, planes: Array) -> Array:
        luminance = LUMA[0] * planes[0] + LUMA[1] * planes[1] + LUMA[2] * planes[2]
        return planes / (1 + luminance)
