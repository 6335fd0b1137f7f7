"""A BTF from arrays in memory."""

import logging

import numpy as np
from numpy.typing import ArrayLike

from bench.btf import BTF, ArraySource
from bench.data.readers.checks import negative, no_duplicates, radiance_fault, unit_directions, warn_of_radians
from bench.directions.hemisphere import to_degrees
from bench.inputs.errors import InputError

log = logging.getLogger(__name__)


def from_arrays(
    radiance: ArrayLike,
    wo: ArrayLike,
    wi: ArrayLike,
    *,
    heldout: ArrayLike | None = None,
    periodic: bool = False,
    name: str = "arrays",
) -> BTF:
    """The BTF of radiance (N, H, W, 3) at N pairs of unit directions: wo (N, 3) to the camera, wi (N, 3) to the light.

    Radiance is linear Rec. 709 f_r · cos θ_i, used unchanged and not copied. `heldout` is a mask (N,) of the pairs that
    no codec may train on; without it, whole views and lights are held out (`BTF.split`). `periodic` says that the
    picture repeats without a seam. `InputError` names the array and the row of a wrong value.
    """
    values = np.asarray(radiance)
    if fault := radiance_fault(values.shape, values.dtype):
        raise InputError(fault)
    count = len(values)
    views, lights = (_directions(np.asarray(side), word, count) for side, word in ((wo, "wo"), (wi, "wi")))
    no_duplicates(views, lights, lambda row: f"pair {row}")
    mask = None if heldout is None else np.asarray(heldout)
    if mask is not None and (mask.shape != (count,) or mask.dtype.kind != "b" or mask.all()):
        raise InputError(f"heldout must be a mask ({count},) of booleans that leaves pairs to train on")
    for row, picture in enumerate(values):  # one at a time, because the array may be a mapped file
        if bad := int((~np.isfinite(picture)).sum()):
            fault = f"{bad:,} of {picture.size:,} values are not finite (NaN or infinite): mend them"
            remedy = "leave the pair out, or save radiance, wo and wi by numpy.savez and bench.open(path, repair=True)"
            raise InputError(f"radiance[{row}]: {fault}, {remedy}")
    if text := negative(values):
        log.warning("%s: %s", name, text)
    warn_of_radians(*to_degrees(np.concatenate([views, lights])), "wo and wi")
    provenance = {"format": "arrays", "colour": "taken as linear Rec. 709", "cosine": "taken as f_r cos(theta_i)"}
    return BTF(name, views, lights, ArraySource(values), heldout=mask, periodic=periodic, provenance=provenance)


def _directions(vectors: np.ndarray, word: str, count: int) -> np.ndarray:
    if vectors.shape != (count, 3) or vectors.dtype.kind not in "fiu":
        raise InputError(f"{word} is {vectors.shape}: it must be ({count}, 3), a direction for each slice of radiance")
    return unit_directions(vectors, lambda row: f"{word}[{row}]")
