"""The colouring in which FLIP maps are published: magma (van der Walt and Smith, 2015), black for no difference."""

from functools import lru_cache

import numpy as np

from bench.btf import Array
from bench.inputs.errors import InputError


def magma(error_map: Array) -> Array:
    """A map (..., H, W) in [0, 1] → sRGB in [0, 1], (..., H, W, 3) float32, each value rounded to one of 256 colours.
    Raises `InputError` for values outside [0, 1]."""
    error_map = np.asarray(error_map)
    if not (np.issubdtype(error_map.dtype, np.floating) and ((error_map >= 0) & (error_map <= 1)).all()):
        raise InputError("error_map must hold floating-point values in [0, 1]")
    return _colours()[np.floor(error_map * 255 + 0.5).astype(np.intp)]


@lru_cache(maxsize=1)
def _colours() -> Array:
    import matplotlib  # its table is the published one; imported late because that is slow

    return np.array(matplotlib.colormaps["magma"](np.arange(256))[:, :3], np.float32)
