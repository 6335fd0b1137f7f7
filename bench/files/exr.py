"""Writes pictures as OpenEXR, for readers that know linear floats."""

import errno
import os
from pathlib import Path

import numpy as np

from bench.inputs.errors import NO_PLACE


def write_exr(path: Path, picture: np.ndarray) -> None:
    """Write a picture (H, W, 3 or 4), its channels R, G, B and A, as it is: float16 or float32, without loss.

    `OSError` with the number of the system's error, or `EIO`, if it cannot be written.
    """
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    names = "RGBA"[: picture.shape[2]]
    try:
        with OpenEXR.File(header, {names: np.ascontiguousarray(picture)}) as file:
            file.write(str(path))
    except RuntimeError as error:
        # The library passes on only the text of the system's error, but callers tell a full disk by its number. So the
        # number is found again by the text.
        number = next((each for each in NO_PLACE if os.strerror(each) in str(error)), errno.EIO)
        raise OSError(number, os.strerror(number), str(path)) from error
