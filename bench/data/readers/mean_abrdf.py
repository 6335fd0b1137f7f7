"""A mean ABRDF: a `.npz` with `rgb_geomean` (V, L, 3) and the angles of its V = L directions; a BTF of one texel."""

import numpy as np

from bench.btf import BTF, finite
from bench.data.readers.candidate import Candidate
from bench.data.readers.checks import IN_THE_DATA, described, different_directions
from bench.data.readers.npz import NpzSource
from bench.directions.hemisphere import product
from bench.files.archive import ZipFiles, stored
from bench.inputs.errors import InputError

KEY = "rgb_geomean"


def opened(seen: Candidate) -> BTF | None:
    """The BTF (1 × 1 texel) of a mean ABRDF, or None: view-major, linear Rec. 709, including the cosine of the light.
    `theta_deg` and `phi_deg` (V,) give the directions of both sides. Raises `InputError` that names file and array."""
    if not seen.is_zip or f"{KEY}.npy" not in seen.names:
        return None
    path, files = seen.path, ZipFiles(seen.path)
    table, *sides = (stored(files, key) for key in (KEY, "theta_deg", "phi_deg"))
    count = table.shape[0] if table.shape else 0
    if table.shape != (count, count, 3) or count == 0 or table.dtype.kind != "f":
        raise InputError(f"{path}: {KEY} is {table.shape} {table.dtype}: it must be (V, V, 3) floats")
    if any(angles.shape != (count,) or angles.dtype.kind not in "fiu" for angles in sides):
        raise InputError(f"{path}: theta_deg and phi_deg must be ({count},) numbers")
    theta, phi = (np.radians(np.asarray(angles.values(), np.float64)) for angles in sides)
    directions = different_directions(theta, phi, lambda row: f"{path}: direction {row}", "_deg")
    source = NpzSource(finite(table.values(), f"{path}: {KEY}").reshape(-1, 1, 1, 3), path)
    texels = "one: the geometric mean over the measured texels"
    provenance = described("mean ABRDF", "linear Rec. 709 as stored", IN_THE_DATA, texels=texels)
    return BTF(path.stem, *product(directions, directions), source, provenance=provenance)
