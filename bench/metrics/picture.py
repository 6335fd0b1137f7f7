"""A slice, or a stack of slices, for the metrics: checked once; each space is computed once and shared."""

from functools import cached_property

import numpy as np

from bench.btf import Array
from bench.inputs.errors import InputError
from bench.metrics.display import LUMA, encode_srgb, to_log1p


class Picture:
    """Linear radiance (..., H, W, 3) of any float type, seen at an exposure.

    Every space is planar, (3, ..., H, W) float64, so that each channel is contiguous. Leading axes stack slices: a
    small slice in a stack of 16 takes half the time. In single precision FLIP's powers of .5 and .7 would lift
    rounding errors beyond 2e-5.
    Negative radiance counts as 0. `name` names the argument in errors.

    Raises `InputError` if the values are not floats, not finite, or have another shape.
    """

    def __init__(self, radiance: Array, exposure: float, name: str):
        radiance = check_radiance(radiance, name)
        if not (np.isfinite(exposure) and exposure > 0):
            raise InputError(f"exposure must be a positive number, not {exposure}")
        self.shape, self.exposure = radiance.shape[:-1], float(exposure)
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
        raise InputError(f"{name} must be (H, W, 3), not {values.shape}")
    if not np.isfinite(values).all():
        raise InputError(f"{name} must be finite, but {int((~np.isfinite(values)).sum())} of its values are not")
    return values
