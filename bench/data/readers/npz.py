"""A single `.npz`: `radiance` (N, H, W, 3), `wo` and `wi` (N, 3), and optionally `heldout` (N,), `periodic` and
`provenance`.

Or a mean ABRDF, the geometric mean over all texels. `rgb_geomean` (V, V, 3) holds it by view and light; views and
lights are the same V directions, of angles `theta_deg` and `phi_deg` (V,).

An `.npz` is a zip with an entry `NAME.npy` for each array.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

from bench.btf import BTF, Array, ArraySource, finite
from bench.data.readers.checks import (
    AS_STORED,
    IN_THE_DATA,
    different_directions,
    in_degrees,
    no_duplicates,
    provenance_of,
    radiance_fault,
    unit_directions,
    unit_note,
    warn_of_radians,
)
from bench.data.readers.files import Candidate, file_digest
from bench.directions.hemisphere import product
from bench.files.archive import ZipFiles, stored
from bench.inputs.errors import InputError, readable

NOTES = 16 << 20  # the most bytes of a provenance, four to a character
MEAN = "rgb_geomean"  # the array that only a mean ABRDF has


class NpzSource(ArraySource):
    """An array (N, H, W, 3) of a file, often memory-mapped; values that are not finite are a `NotFiniteError`."""

    def __init__(self, values: Array, path: Path):
        super().__init__(values, f"{path}: radiance")
        self.path = path

    def slice(self, pair: int) -> Array:
        return finite(super().slice(pair), f"{self.label}[{pair}]")

    def texels(self, rows: Array, cols: Array, pairs: Array) -> Array:
        return finite(super().texels(rows, cols, pairs), f"{self.label} at texels")

    def gather(self, pair: Array, row: Array, col: Array) -> Array:
        return finite(super().gather(pair, row, col), f"{self.label} at samples")

    def fingerprint(self) -> str:
        return file_digest(self.path)


def opened(seen: Candidate) -> BTF | None:
    """The BTF of an `.npz` with the arrays of either form, or None.

    Radiance is memory-mapped if `numpy.savez` (uncompressed) wrote it, else read into memory. It is linear Rec. 709
    f_r · cos θ_i, taken as stored, in the order stored. Raises `InputError` that names the file, the array and the row.
    """
    if not seen.is_zip or not {"radiance.npy", f"{MEAN}.npy"} & set(seen.names):
        return None
    if "radiance.npy" not in seen.names:
        return _mean_abrdf(seen.path, seen.angles)
    path = seen.path
    files = ZipFiles(path)
    radiance = stored(files, "radiance")
    fault = radiance_fault(radiance.shape, radiance.dtype)
    if fault:
        raise InputError(f"{path}: {fault}")
    count = radiance.shape[0]
    wo, wi = _directions(files, "wo", count), _directions(files, "wi", count)
    no_duplicates(wo, wi, lambda row: f"{path}: pair {row}")
    warn_of_radians(wo, wi, f"{path}: wo and wi")
    source = NpzSource(radiance.values(), path)
    heldout = _heldout(files, count)
    periodic = _periodic(files)
    provenance = provenance_of("npz", "taken as linear Rec. 709", AS_STORED) | _provenance(files)
    return BTF(path.stem, wo, wi, source, heldout=heldout, periodic=periodic, provenance=provenance)


def _mean_abrdf(path: Path, unit: str) -> BTF:
    """The BTF (1 × 1 texel) of a mean ABRDF: view-major, linear Rec. 709, including the cosine of the light.

    `unit` is what the user says of the angles: "degrees", "radians", or "" for nothing.
    """
    files = ZipFiles(path)
    table = stored(files, MEAN)
    stored_theta, stored_phi = stored(files, "theta_deg"), stored(files, "phi_deg")
    count = table.shape[0] if table.shape else 0
    if table.shape != (count, count, 3) or count == 0 or table.dtype.kind != "f":
        raise InputError(f"{path}: {MEAN} is {table.shape} {table.dtype}: it must be (V, V, 3) floats")
    for angles in (stored_theta, stored_phi):
        if angles.shape != (count,) or angles.dtype.kind not in "fiu":
            raise InputError(f"{path}: theta_deg and phi_deg must be ({count},) numbers")
    stated_theta = np.asarray(stored_theta.values(), np.float64)
    stated_phi = np.asarray(stored_phi.values(), np.float64)
    theta, phi = in_degrees(stated_theta, stated_phi, f"{path}: theta_deg and phi_deg", unit)
    # Errors speak of `theta_deg` and `phi_deg`.
    directions = different_directions(
        np.radians(theta), np.radians(phi), lambda row: f"{path}: direction {row}", "_deg"
    )
    # (V, V, 3) becomes V² pictures of one texel; the light changes fastest.
    pictures = finite(table.values(), f"{path}: {MEAN}").reshape(-1, 1, 1, 3)
    source = NpzSource(pictures, path)
    texels = "one: the geometric mean over the measured texels"
    provenance = provenance_of("mean ABRDF", "linear Rec. 709 as stored", IN_THE_DATA, texels=texels)
    provenance |= unit_note(unit)
    wo, wi = product(directions, directions)
    return BTF(path.stem, wo, wi, source, provenance=provenance)


def _directions(files: ZipFiles, key: str, count: int) -> Array:
    """Unit vectors (count, 3) float32 of the array `wo` or `wi`; `InputError` names the first row that is none."""
    vectors = stored(files, key)
    if vectors.shape != (count, 3) or vectors.dtype.kind not in "fiu":
        raise InputError(f"{files.path}: {key} is {vectors.shape} {vectors.dtype}: it must be ({count}, 3) numbers")
    return unit_directions(vectors.values(), lambda row: f"{files.path}: {key}[{row}]")


def _heldout(files: ZipFiles, count: int) -> Array | None:
    """The mask (count,) of the held-out pairs, on which no codec may train; None without the array, or if it is all
    False. `InputError` if it is no such mask, or leaves nothing to train on."""
    if not files.has("heldout.npy"):
        return None
    array = stored(files, "heldout")
    is_mask = array.shape == (count,) and array.dtype.kind == "b"
    mask = array.values() if is_mask else None  # an array of another form may be too large to read
    if mask is None or mask.all():
        raise InputError(f"{files.path}: heldout must be a mask ({count},) of booleans that leaves pairs to train on")
    if not mask.any():
        return None
    return np.array(mask)  # a copy in memory, because the values may be a view of the file


def _periodic(files: ZipFiles) -> bool:
    """Whether the file says that the picture repeats without a seam; False if it says nothing.

    `InputError` if the array `periodic` is not one boolean.
    """
    if not files.has("periodic.npy"):
        return False
    array = stored(files, "periodic")
    if array.shape != () or array.dtype.kind != "b":
        raise InputError(f"{files.path}: periodic is {array.shape} {array.dtype}: it must be one boolean")
    return bool(array.values())


def _provenance(files: ZipFiles) -> dict[str, Any]:
    """What the file says of its origin: an object of JSON in the array `provenance`, one text; {} without that array.

    `InputError` for anything else there.
    """
    if not files.has("provenance.npy"):
        return {}
    label = files.label("provenance.npy")
    array = stored(files, "provenance")
    if array.shape != () or array.dtype.kind != "U" or array.dtype.itemsize > NOTES:
        raise InputError(f"{label}: {array.shape} {array.dtype} is not a short text: leave the array out")
    with readable(label, "leave the array out"):
        notes = json.loads(str(array.values()))
        if not isinstance(notes, dict):
            raise InputError(f"{label}: it must hold an object: leave the array out")
        return notes
