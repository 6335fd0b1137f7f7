"""The base class of slice metrics (a reference side, computed once, and a map of the difference), and what they see.

Several slices may be scored in a stack.
"""

from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from bench.btf import Array
from bench.inputs.errors import InputError
from bench.metrics.display import LUMA, encode_srgb, to_log1p


class Picture:
    """Linear radiance (..., H, W, 3) of any float type, seen at an exposure; each space is computed once and shared.

    Every space is planar, (3, ..., H, W) float64, so that each channel is contiguous. Leading axes stack slices: a
    small slice in a stack of 16 takes half the time. In single precision FLIP's powers of .5 and .7 would lift rounding
    errors beyond 2e-5. Negative radiance counts as 0. `name` names the argument in errors.

    Raises `InputError` if the values are not floats, not finite, or have another shape, or if the exposure is not
    positive.
    """

    def __init__(self, radiance: Array, exposure: float, name: str):
        """Check the radiance and the exposure; spaces are computed when they are asked for."""
        radiance = check_radiance(radiance, name)
        if not (np.isfinite(exposure) and exposure > 0):
            raise InputError(f"exposure must be a positive number, not {exposure}")
        self.shape = radiance.shape[:-1]  # (..., H, W)
        self.exposure = float(exposure)
        # Channels first, negative values 0, contiguous.
        self.linear = np.maximum(np.moveaxis(radiance, -1, 0), 0, order="C", dtype=np.float64)

    @cached_property
    def exposed(self) -> Array:
        """exposure × radiance clipped to [0, 1]: the light that the display emits."""
        return np.minimum(self.linear * self.exposure, 1)

    @cached_property
    def display(self) -> Array:
        """The display signal: sRGB of `exposed`."""
        return encode_srgb(self.exposed)

    @cached_property
    def luma(self) -> Array:
        """Rec. 709 luma of `display`, (..., H, W)."""
        red, green, blue = self.display
        return LUMA[0] * red + LUMA[1] * green + LUMA[2] * blue

    @cached_property
    def log1p(self) -> Array:
        """log1p(8 · exposure · radiance)."""
        return to_log1p(self.linear, self.exposure)


def check_radiance(values: Array, name: str) -> Array:
    """Return finite floats of shape (..., H, W, 3); otherwise raise an `InputError` that names the argument."""
    values = np.asarray(values)
    if not np.issubdtype(values.dtype, np.floating):
        raise InputError(f"{name} must hold floating-point radiance, not {values.dtype}")
    if values.ndim < 3 or values.shape[-1] != 3 or 0 in values.shape:
        raise InputError(f"{name} must be (H, W, 3), H and W at least 1, not {values.shape}")
    if not np.isfinite(values).all():
        raise InputError(f"{name} must be finite, but {int((~np.isfinite(values)).sum())} of its values are not")
    return values


class Prepared(NamedTuple):
    """A reference prepared for one metric: `SliceMetric.prepare` returns it, `score` takes it."""

    shape: tuple[int, ...]  # (..., H, W)
    exposure: float
    side: Any  # what `reference_side` gave


class SliceMetric:
    """A number for each slice. A metric implements `reference_side` and `compare`, and, if pooling is not a mean,
    `values` and `pool`.

    The *raw* number of a slice is the mean of its map; it is stored unchanged, so later pooling is exact.
    """

    perfect = 0.0  # the raw number of two equal slices
    smallest = 1  # texels a side that a picture must have
    per_material = False  # whether `for_material` has anything to fix

    def for_material(self, sample: Array) -> "SliceMetric":
        """The metric with its per-material constants fixed, from a sample (n, 3) of the material's linear radiance."""
        del sample
        return self

    def fixed(self) -> dict[str, float]:
        """The constants fixed for the material, by name, for the record."""
        return {}

    def reference_side(self, reference: Picture) -> Any:
        """Everything that depends only on the reference: an array, or a tuple of arrays."""
        raise NotImplementedError

    def compare(self, side: Any, test: Picture) -> Array:
        """The map (..., H, W) whose mean is the raw number of a slice; `test` has the reference's shape."""
        raise NotImplementedError

    def values(self, raw: Array) -> Array:
        """Raw numbers (n,), or one number such as their mean → the same shape in the metric's unit."""
        return raw

    def pool(self, raw: Array) -> float:
        """Raw numbers (n,) of several slices → one number in the metric's unit."""
        return float(self.values(np.mean(raw)))

    def prepare(self, reference: Array, exposure: float) -> Prepared:
        """Compute the reference's part once. `reference` is linear radiance (H, W, 3), or a stack (..., H, W, 3).

        Raises `InputError` if the reference is not a finite float picture, or is smaller than the metric's window, or
        if the exposure is not positive.
        """
        picture = Picture(reference, exposure, "reference")
        height, width = picture.shape[-2:]
        least = self.smallest
        if min(height, width) < least:
            called = type(self).__name__
            raise InputError(f"reference is {height} × {width}, but {called} needs at least {least} × {least}")
        return Prepared(picture.shape, picture.exposure, self.reference_side(picture))

    def error_map(self, reference: Prepared, test: Array) -> Array:
        """The map (..., H, W) of the difference; `test` is linear radiance of the reference's shape.
        Raises `InputError` as `prepare` does, and if the sizes differ."""
        picture = Picture(test, reference.exposure, "test")
        if picture.shape != reference.shape:
            raise InputError(f"test is {picture.shape}, but reference is {reference.shape}")
        return self.compare(reference.side, picture)

    def score(self, reference: Prepared, test: Array) -> Any:
        """The raw number, the mean of `error_map`: a float for one slice, an array for a stack."""
        raw = self.error_map(reference, test).mean((-2, -1))
        return float(raw) if np.ndim(raw) == 0 else raw


def as_metric(made: object) -> SliceMetric:
    """Return what a package made if it is a metric; otherwise raise a `TypeError`."""
    if not isinstance(made, SliceMetric):
        raise TypeError(f"it gave a {type(made).__name__}, which is not derived from bench.metrics.base.SliceMetric")
    return made
