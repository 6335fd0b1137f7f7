"""Writes a BTF as an `.npz`, which `bench.data.readers.npz` reads."""

import json
import zipfile
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from bench.btf import BTF, Array


def write_npz(btf: BTF, path: str | Path, slices: Iterable[Array] | None = None) -> None:
    """Write a BTF as an uncompressed `.npz` with `radiance` in float32, slice by slice, so memory stays small.

    `heldout` is the only mask in it: a reader takes validation pairs and those of low light for training pairs.
    `slices` are those of the BTF; a caller that counts how many are written passes an iterator of its own over them.
    """
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        with archive.open("radiance.npy", "w", force_zip64=True) as stream:
            # "<f4" is little-endian float32.
            header = {"descr": "<f4", "fortran_order": False, "shape": (len(btf), *btf.shape, 3)}
            np.lib.format.write_array_header_1_0(stream, header)
            for picture in btf if slices is None else slices:
                stream.write(np.ascontiguousarray(picture, "<f4").tobytes())
        provenance = np.array(json.dumps(btf.provenance, default=str))
        small = {"wo": btf.wo, "wi": btf.wi, "periodic": np.array(btf.periodic), "provenance": provenance}
        if btf.heldout is not None:
            small["heldout"] = btf.heldout
        for key, value in small.items():
            with archive.open(f"{key}.npy", "w") as stream:
                np.lib.format.write_array(stream, value, allow_pickle=False)
