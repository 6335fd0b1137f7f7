"""Writes UBO2014 `.btf` files: from given factors of any size, or by factorising a BTF (the native codec itself)."""

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bench.btf import BTF
from bench.data.readers.ubo2014 import DFMF, EPSILON, FMF, SCALARS, YUV_TO_RGB

Array = np.ndarray


def write_ubo2014(
    path: str | Path,
    views: Array,
    lights: Array,
    shape: tuple[int, int],
    factors: Sequence[tuple[Array, Array]],
    *,
    colour_model: int = 11,
    scalar: int = 2,
    version: int = 4,
    rotations: int = 0,
    xml: str = "",
) -> None:
    """Write factors as a `.btf` file.

    `views` (V, 2) and `lights` (L, 2) are θ, φ in radians and `shape` is (H, W). Three `factors` (U (V · L, K),
    SV (H · W, K)) make a DFMF of `colour_model`, one (U (3 · V · L, K), SV), whose rows go channel fastest, an FMF,
    in log where `colour_model` is 12. Rows of SV go from the bottom row of the picture up. `scalar` is bytes a number.
    """
    signature = DFMF if len(factors) == 3 else FMF
    header = b"".join(text.ljust(80, b"\0") for text in (b"synthetic", b"none", b"none"))
    header += struct.pack("<4f", 10.0, 1.0, 1.0, 1.0)
    header += struct.pack("<I", 1) if version > 1 else b""
    header += struct.pack("<I", len(xml.encode())) + xml.encode() if version > 2 else b""
    names = b"".join(struct.pack("<I", 1) + name for name in (b"R", b"G", b"B"))
    header += struct.pack("<I", 3) + names if version > 3 else b""
    rank = max(u.shape[1] for u, _ in factors)
    with open(path, "wb") as out:
        out.write(signature + struct.pack("<2I", len(header) + 8, version) + header)
        out.write(struct.pack("<I", len(views)))
        for view in np.asarray(views, "<f4"):
            out.write(view.tobytes() + struct.pack("<I", len(lights)) + np.asarray(lights, "<f4").tobytes())
        out.write(struct.pack("<3I", shape[1], shape[0], rotations))
        out.write(np.tile(np.eye(3, dtype="<f4"), (rotations, 1, 1)).tobytes())
        if signature == DFMF:
            out.write(struct.pack("<Ii12f", rank, colour_model, *[0.0] * 3, *np.eye(3).reshape(-1)))
        else:
            out.write(struct.pack("<B4I", 2, int(colour_model == 12), 0, 0, rank))
        for u, sv in factors:
            out.write(struct.pack("<B3I", scalar, u.shape[1], len(u), len(sv)))
            out.write(np.ones(u.shape[1], SCALARS[scalar]).tobytes())
            for matrix in (u, sv):
                out.write(np.ascontiguousarray(matrix, SCALARS[scalar]).tobytes())


def factorise(btf: BTF, path: str | Path, rank: int = 100) -> None:
    """Write a BTF whose pairs are a product as a DFMF of colour model 11 in half floats: what the native codec does.

    The decorrelated channels are held in memory (12 bytes a texel and pair) and factorised by SVD.
    """
    grid = btf.layout.grid
    assert grid is not None
    table = np.stack([btf[int(i)][::-1].reshape(-1, 3) for i in grid.reshape(-1)])
    y, u, v = np.moveaxis(np.maximum(table, 0) @ np.linalg.inv(YUV_TO_RGB).T, -1, 0)
    y = np.maximum(y, 0) + EPSILON
    channels = (np.log(y), (u - EPSILON) / y, (v - EPSILON) / y)
    factors = [_svd(channel.astype(np.float32), rank) for channel in channels]
    write_ubo2014(path, radians(btf.layout.views), radians(btf.layout.lights), btf.shape, factors)


def _svd(matrix: Array, rank: int) -> tuple[Array, Array]:
    """U (pairs, K) and SV (texels, K) of a matrix (pairs, texels)."""
    left, values, right = np.linalg.svd(matrix, full_matrices=False)
    return left[:, :rank], (values[:rank, None] * right[:rank]).T


def radians(directions: Array) -> Array:
    """θ, φ (n, 2) in radians of unit vectors (n, 3)."""
    x, y, z = directions.astype(np.float64).T
    return np.stack([np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)], -1)
