"""A single `.npz`: `radiance` (N, H, W, 3), `wo` and `wi` (N, 3), and optionally `heldout` (N,) and `periodic`."""

import io
import json
import math
import zipfile
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from bench.btf import BTF, ArraySource, finite
from bench.data.readers.checks import no_duplicates, readable, unit_directions
from bench.data.readers.files import ZipFiles, file_digest
from bench.data.readers.seen import Seen
from bench.errors import InputError

Array = np.ndarray


class NpzSource(ArraySource):
    """An array (N, H, W, 3) of a file, whose values are checked as they are read."""

    def __init__(self, values: Array, path: Path):
        super().__init__(values)
        self.path = path

    def slice(self, pair: int) -> Array:
        with np.errstate(over="ignore", invalid="ignore"):
            values = super().slice(pair)
        return finite(values, f"{self.path}: radiance[{pair}]")

    def texels(self, rows: Array, cols: Array, pairs: Array) -> Array:
        with np.errstate(over="ignore", invalid="ignore"):
            values = super().texels(rows, cols, pairs)
        return finite(values, f"{self.path}: radiance at texels")

    def gather(self, pair: Array, row: Array, col: Array) -> Array:
        with np.errstate(over="ignore", invalid="ignore"):
            values = super().gather(pair, row, col)
        return finite(values, f"{self.path}: radiance at samples")

    @cached_property
    def _digest(self) -> str:
        return file_digest(self.path)

    def fingerprint(self) -> str:
        return self._digest


def read_array(files: ZipFiles, key: str) -> Array:
    """One array of an `.npz`: memory-mapped where it is stored uncompressed, else inflated; never unpickled."""
    name = f"{key}.npy"
    label = files.label(name)
    if not files.has(name):
        raise InputError(f"{files.path}: no array {key!r}: add it")
    with readable(label, "save it with numpy.savez"):
        head = io.BytesIO(files.head(name, 16384))
        version = np.lib.format.read_magic(head)
        if version not in ((1, 0), (2, 0)):
            raise InputError(f"{label}: .npy version {version} is not read: save it with numpy.savez")
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, fortran, dtype = read(head)
    begin, count = head.tell(), math.prod(shape)
    if dtype.hasobject or dtype.kind not in "fiubU":
        raise InputError(f"{label}: type {dtype} is not read: save plain numbers")
    if begin + count * dtype.itemsize != files.size(name):
        raise InputError(f"{label}: {shape} of {dtype} is not what its {files.size(name)} bytes hold: save it anew")
    order: Any = "F" if fortran else "C"
    offset = files.offset(name)
    if offset is not None and count:
        return np.memmap(files.path, dtype, "r", offset + begin, shape, order)
    with readable(label, "save it with numpy.savez, uncompressed"):
        return np.frombuffer(files.read(name), dtype, count, begin).reshape(shape, order=order)


def opened(seen: Seen) -> BTF | None:
    """The BTF of an archive with `radiance.npy`, or None."""
    return open_npz(seen.path) if seen.is_zip and "radiance.npy" in seen.names else None


def open_npz(path: Path) -> BTF:
    """The BTF of an `.npz`, its radiance memory-mapped where `numpy.savez` (uncompressed) wrote it.

    Radiance is linear Rec. 709 f_r · cos θ_i, taken as stored, in the order stored. Raises `InputError` naming the
    file, the array and the row.
    """
    files = ZipFiles(path)
    radiance = read_array(files, "radiance")
    if radiance.ndim != 4 or radiance.shape[-1] != 3 or 0 in radiance.shape or radiance.dtype.kind != "f":
        raise InputError(f"{path}: radiance is {radiance.shape} {radiance.dtype}: it must be (N, H, W, 3) floats")
    count = len(radiance)
    wo, wi = (_directions(files, key, count) for key in ("wo", "wi"))
    no_duplicates(wo, wi, lambda row: f"{path}: pair {row}")
    return BTF(
        path.stem,
        wo,
        wi,
        NpzSource(radiance, path),
        heldout=_heldout(files, count),
        periodic=files.has("periodic.npy") and bool(np.all(read_array(files, "periodic"))),
        provenance={
            "format": "npz",
            "colour": "taken as linear Rec. 709",
            "cosine": "as stored: values are taken as f_r cos(theta_i)",
            "clamp": "none",
            **_provenance(files),
        },
    )


def _directions(files: ZipFiles, key: str, count: int) -> Array:
    vectors = read_array(files, key)
    if vectors.shape != (count, 3) or vectors.dtype.kind not in "fiu":
        raise InputError(f"{files.path}: {key} is {vectors.shape}: it must be ({count}, 3), a direction a pair")
    return unit_directions(vectors, lambda row: f"{files.path}: {key}[{row}]")


def _heldout(files: ZipFiles, count: int) -> Array | None:
    if not files.has("heldout.npy"):
        return None
    mask = read_array(files, "heldout")
    if mask.shape != (count,) or mask.dtype.kind != "b" or mask.all():
        raise InputError(f"{files.path}: heldout must be a mask ({count},) of booleans that leaves pairs to train on")
    return np.array(mask) if mask.any() else None


def _provenance(files: ZipFiles) -> dict[str, Any]:
    if not files.has("provenance.npy"):
        return {}
    with readable(files.label("provenance.npy"), "leave the array out"):
        notes = json.loads(str(read_array(files, "provenance")))
        return dict(notes)


def write_npz(btf: BTF, path: str | Path) -> None:
    """Write a BTF as an uncompressed `.npz` with `radiance` in float32, slice by slice, so that memory stays small."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        with archive.open("radiance.npy", "w", force_zip64=True) as stream:
            header = {"descr": "<f4", "fortran_order": False, "shape": (len(btf), *btf.shape, 3)}
            np.lib.format.write_array_header_1_0(stream, header)
            for picture in btf:
                stream.write(np.ascontiguousarray(picture, "<f4").tobytes())
        small = {
            "wo": btf.wo,
            "wi": btf.wi,
            "periodic": np.array(btf.periodic),
            "provenance": np.array(json.dumps(btf.provenance, default=str)),
        }
        for key, value in small.items() if btf.heldout is None else [*small.items(), ("heldout", btf.heldout)]:
            with archive.open(f"{key}.npy", "w") as stream:
                np.lib.format.write_array(stream, value, allow_pickle=False)
