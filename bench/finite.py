"""Radiance is finite: what reads it says how many values are not, and where the first of them is."""

import numpy as np

from bench.errors import InputError

Array = np.ndarray


class NotFiniteError(InputError):
    """Radiance that is NaN or infinite; `values` are what was read, which `bench.data.repair` can mend."""

    def __init__(self, message: str, values: Array):
        super().__init__(message)
        self.values = values


def finite(values: Array, label: str) -> Array:
    """The values (..., 3), or a `NotFiniteError` that says how many are not finite and where the first of them is."""
    good = np.isfinite(values)
    if good.all():
        return values
    place = ", ".join(str(int(i)) for i in np.argwhere(~good)[0])
    count = int(good.size - np.count_nonzero(good))
    raise NotFiniteError(
        f"{label}: {count} of {good.size} values are not finite (NaN or infinite), the first at index ({place}): "
        "mend the values, leave the pair out, or mask them with --repair",
        values,
    )
