"""UBO2014 `.btf` files of the Bonn BTF database: factorised matrices (DFMF and FMF), little-endian.

A file holds the signature (which names its form), a header about the measurement, the directions (radians), the size,
and per colour channel the factors U (pairs × K) and S·V (texels × K), where K is the rank. The picture of a pair is
S·V · U[pair], from the bottom row up, so it is flipped. DFMF has a factorisation for each of three channels, FMF one
for all together. The channels are not RGB but what a *colour model* makes of it, such as logarithms. The files are
memory-mapped and multiplied on demand, because a decoded material would take 22 GB.

Format: https://cg.cs.uni-bonn.de/en/projects/btfdbb/download/ubo2014/ (DFMF08 and FMF12).
"""

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from bench.btf import BTF, Array, Source, finite
from bench.data.readers.checks import IN_THE_DATA, different_directions, provenance_of
from bench.data.readers.files import Candidate, file_digest
from bench.directions.hemisphere import product
from bench.inputs.errors import InputError

DFMF, FMF = b"!DFMF08FCR", b"!FMF12FCER"  # the signatures that are read
UNSUPPORTED = (b"!FMF06FC", b"!PVF06FC", b"!BDIF06R2!")  # other signatures of Bonn
# The number of a colour model → what the three channels hold, in words.
COLOUR_MODELS = {
    0: "RGB as stored",
    11: "log luminance and relative chroma (YUV), converted to RGB",
    12: "log RGB, converted to RGB",
}
SCALARS = {2: "<f2", 4: "<f4", 8: "<f8"}  # bytes of a number → its type
EPSILON = np.float32(1e-5)  # the writer added it before it took a logarithm
YUV_TO_RGB = np.array([[1, 0, 1.13983], [1, -0.39465, -0.58060], [1, 2.03211, 0]], np.float32)
DENSE_BYTES = 1 << 30  # of factors that are kept in memory as float32
TEXELS_AT_ONCE = 64  # whose ABRDFs are multiplied at once
VALUES_AT_ONCE = 4096  # scattered values that are computed at once, so that their factors need little memory
MULTIPLIED = 64 << 20  # bytes at once: 17 slices of 400 × 400 texels, in half the time of one by one


class Cursor:
    """Reads a file, memory-mapped, from front to back.

    Every method that reads moves `offset` on. Its `what` says in errors what was read when the file ended.
    """

    def __init__(self, path: Path):
        self.path = path
        self.offset = 0
        self.bytes = np.memmap(path, np.uint8, "r")

    def error(self, fault: str, remedy: str = "the file is damaged; get it again") -> InputError:
        """The error for a fault at this place, which the caller raises; it names the file and the offset."""
        return InputError(f"{self.path}, offset {self.offset}: {fault}: {remedy}")

    def take(self, count: int, what: str) -> Array:
        """The next `count` bytes, as a view of the file."""
        left = len(self.bytes) - self.offset
        if count > left:
            raise self.error(f"{what} needs {count} bytes, but {left} are left", "the file is truncated; get it again")
        self.offset += count
        return self.bytes[self.offset - count : self.offset]

    def numbers(self, layout: str, what: str) -> tuple[Any, ...]:
        """The next numbers, in a `struct` layout without its mark of the byte order: they are little-endian."""
        layout = "<" + layout
        return struct.unpack(layout, self.take(struct.calcsize(layout), what).tobytes())

    def count(self, what: str) -> int:
        """The next number, an unsigned one of 4 bytes."""
        return int(self.numbers("I", what)[0])

    def text(self, length: int, what: str) -> str:
        """The next text, which takes `length` bytes; a zero byte ends it before, and padding follows."""
        text, _, _ = self.take(length, what).tobytes().partition(b"\0")
        return text.decode("utf-8", "replace").strip()

    def floats(self, shape: tuple[int, ...], scalar: int, what: str) -> Array:
        """The next array, of floats of `scalar` bytes each (a key of `SCALARS`), as a view of the file.

        The view need not be aligned.
        """
        byte_count = math.prod(shape) * scalar
        return self.take(byte_count, what).view(SCALARS[scalar]).reshape(shape)


@dataclass
class Matrix:
    """A factor (rows, K) of the file, whose rows are pairs (U) or texels (S·V)."""

    stored: Array  # a view of the file
    is_kept: bool = True  # in memory as float32, once it is used; else rows are converted each time

    @cached_property
    def dense(self) -> Array:
        """The whole factor in float32, converted at the first use."""
        return np.ascontiguousarray(self.stored, np.float32)

    def rows(self, index: Array | slice) -> Array:
        """Some rows (n, K) in float32, by their indices (n,) or a slice."""
        if self.is_kept:
            return self.dense[index]
        return np.asarray(self.stored[index], np.float32)

    def times(self, factors: Array) -> Array:
        """The scalar products (n, rows) of some vectors (n, K) with every row."""
        if self.is_kept:
            return factors @ self.dense.T
        parts = []
        for start in range(0, len(self.stored), 4096):  # few rows at once, so that their float32 copy is small
            rows = self.rows(slice(start, start + 4096))
            parts.append(factors @ rows.T)
        return np.concatenate(parts, 1)


@dataclass(frozen=True)
class Factorisation:
    """The factors of three channels, and the colour model of these channels."""

    pairs: list[Matrix]  # per channel U (V · L, K), the light fastest
    texels: list[Matrix]  # per channel S·V (H · W, K), from the bottom row up
    model: int  # the number of the colour model, a key of `COLOUR_MODELS`


def opened(seen: Candidate) -> BTF | None:
    """The BTF of a file that begins like those of UBO2014, or None; pairs sorted by view, then light, as stored.

    Only headers are read now, and directions, so it takes milliseconds. Values are linear RGB with the cosine of the
    light, decoded from colour model 0, 11 or 12 or from log (FMF) and never clamped. `provenance` keeps what the file
    says about itself; `provenance["native"]` holds the bytes of the file and the ranks of its factors, which a report
    sets beside codecs. Raises `InputError` that names file and offset for a foreign, damaged or unsupported file.
    """
    if seen.head[:1] != b"!":  # all signatures of Bonn begin so; an unknown one is an error that names it
        return None
    path = seen.path
    cursor = Cursor(path)
    signature = cursor.take(min(len(DFMF), len(cursor.bytes)), "the signature").tobytes()
    if signature not in (DFMF, FMF):
        fault = f"unknown signature {signature!r}"
        for unsupported in UNSUPPORTED:
            if signature.startswith(unsupported):
                fault = f"the signature {unsupported.decode()} is known but not read"
        raise InputError(f"{path}: {fault}: only {DFMF.decode()} and {FMF.decode()} are read")

    notes = _read_header(cursor)
    views, lights = _read_directions(cursor)
    width, height, rotations = cursor.numbers("3I", "the size")
    notes["rotations"] = rotations
    if not width or not height:
        raise cursor.error(f"a size of {width} x {height} texels")
    # Passed over: the pictures are read as they are stored.
    cursor.floats((rotations, 3, 3), scalar=4, what=f"{rotations} rotations")
    read_body = _read_dfmf if signature == DFMF else _read_fmf
    factors, body_notes = read_body(cursor, len(views) * len(lights), height * width)
    notes |= body_notes
    _choose_kept(factors)

    ranks = [matrix.stored.shape[1] for matrix in factors.pairs]
    native = {"bytes": path.stat().st_size, "rank": max(ranks), "ranks": ranks}
    provenance = provenance_of("UBO2014", notes.pop("colour"), IN_THE_DATA, signature=signature.decode(), **notes)
    provenance |= {"native": native}
    wo, wi = product(views, lights)
    return BTF(path.stem, wo, wi, FactorSource(path, factors, (height, width)), provenance=provenance)


def _choose_kept(factors: Factorisation) -> None:
    """Set which factors are kept in memory as float32: as many as `DENSE_BYTES` hold; the others are converted by rows
    at each use. The factors of pairs come first, because they are small."""
    bytes_left = DENSE_BYTES
    # By identity, since channels may share a matrix, which is then counted once.
    distinct = {id(matrix): matrix for matrix in [*factors.pairs, *factors.texels]}
    for matrix in distinct.values():
        bytes_needed = 4 * matrix.stored.size  # as float32
        matrix.is_kept = bytes_needed <= bytes_left
        if matrix.is_kept:
            bytes_left -= bytes_needed


def _read_header(cursor: Cursor) -> dict[str, Any]:
    """What the header says about the measurement, by name, for the provenance.

    Later versions hold more. `InputError` if the header has another length than it states.
    """
    start = cursor.offset
    size, version = cursor.numbers("2I", "the header")
    if not 1 <= version <= 4:
        raise cursor.error(f"header version {version}", "versions 1 to 4 are read")
    notes: dict[str, Any] = {"header_version": version}
    for key in ("measurement_setup", "image_sensor", "light_source"):
        notes[key] = cursor.text(length=80, what=key)
    notes["ppmm"], *notes["rgb_scale"] = cursor.numbers("4f", "ppmm and RGB scale")
    if version > 1:
        notes["cosine_flag"] = cursor.count("the cosine flag")
    if version > 2:
        notes["xml"] = cursor.text(cursor.count("the length of the XML"), "the XML")
    if version > 3:  # earlier files have three channels without names
        channels = cursor.count("the number of channels")
        if channels != 3:
            raise cursor.error(f"{channels} channels", "three are read")
        notes["channels"] = []
        for _ in range(channels):
            length = cursor.count("a channel's name")
            notes["channels"].append(cursor.text(length, "a channel's name"))
    if cursor.offset - start != size:
        raise cursor.error(f"the header says it has {size} bytes, but it has {cursor.offset - start}")
    return notes


def _read_directions(cursor: Cursor) -> tuple[Array, Array]:
    """The directions of the views (V, 3) and of the lights (L, 3).

    Every view in the file repeats the list of lights, which must be the same, so that pairs are all views with all
    lights. `InputError` if it is not.
    """
    views = cursor.count("the number of views")
    # A view is its θ and φ, the number of its lights, and θ and φ of each light.
    angles_bytes, count_bytes = 8, 4
    lights_start = angles_bytes + count_bytes
    _, lights = cursor.numbers("8sI", "the first view")
    cursor.offset -= lights_start  # only looked at: the first view is read again with the others
    if not views or not lights:
        raise cursor.error(f"{views} views of {lights} lights")
    view_bytes = lights_start + angles_bytes * lights
    block = cursor.take(views * view_bytes, f"{views} views of {lights} lights").reshape(views, view_bytes)
    differs = (block[:, angles_bytes:] != block[0, angles_bytes:]).any(1)  # the number of lights, or a light
    if differs.any():
        view = int(np.argmax(differs))
        raise cursor.error(f"the lights of view {view} differ from those of view 0", "only a product grid is read")
    view_directions = _directions(cursor.path, "view", block[:, :angles_bytes])
    light_directions = _directions(cursor.path, "light", block[0, lights_start:])
    return view_directions, light_directions


def _directions(path: Path, side: str, stored: Array) -> Array:
    """Unit vectors (n, 3) float32 of n views or lights.

    `stored` are their bytes, of any shape: θ and φ of each, little-endian floats of 4 bytes, in radians. `InputError`
    if one is out of range or stands twice, in which `side` is the word for it: view or light.
    """
    # Contiguous, because only such bytes can be seen as floats.
    angles = np.ascontiguousarray(stored).view("<f4").reshape(-1, 2)
    return different_directions(angles[:, 0], angles[:, 1], lambda index: f"{path}: {side} {index}")


def _read_dfmf(cursor: Cursor, pairs: int, texels: int) -> tuple[Factorisation, dict[str, Any]]:
    """The body of a DFMF of so many pairs and texels, factors for each channel, and notes on it for the provenance.

    The note `colour` is in words. Mean and matrix are noted, but not applied.
    """
    _, model = cursor.numbers("Ii", "the colour model")
    if model not in COLOUR_MODELS:
        raise cursor.error(f"colour model {model}", f"models {', '.join(map(str, COLOUR_MODELS))} are read")
    mean = cursor.numbers("3f", "the colour mean")
    matrix = cursor.numbers("9f", "the colour matrix")
    factors = Factorisation([], [], model)
    for channel in range(3):
        u, sv = _read_factors(cursor, pairs, texels, f"channel {channel}")
        factors.pairs.append(Matrix(u))
        factors.texels.append(Matrix(sv))
    colour = {"colour": f"model {model}: {COLOUR_MODELS[model]}", "colour_model": model}
    return factors, colour | {"colour_mean": list(mean), "colour_matrix": list(matrix)}


def _read_fmf(cursor: Cursor, pairs: int, texels: int) -> tuple[Factorisation, dict[str, Any]]:
    """The body of an FMF of so many pairs and texels, factors of all channels together, and notes for the provenance.

    U has a row for each channel of each pair, the channel fastest; the channels share S·V.
    """
    (version,) = cursor.numbers("B", "the FMF version")
    if version > 2:
        raise cursor.error(f"FMF version {version}", "versions 0 to 2 are read")
    reduction = 0  # not 0: the logarithm of RGB is stored
    if version >= 1:
        reduction = cursor.count("the dynamic range reduction")
    width, height = 0, 0
    if version >= 2:
        width, height = cursor.numbers("2I", "the size of the height map")
    cursor.floats((width, height), scalar=2, what="the height map")  # passed over: a BTF has no heights
    cursor.count("the rank")  # stated again with the factors
    u, sv = _read_factors(cursor, 3 * pairs, texels, "the factors")
    by_channel = u.reshape(-1, 3, u.shape[1]).swapaxes(0, 1)  # (3, V · L, K)
    model = 12 if reduction else 0
    factors = Factorisation([Matrix(channel) for channel in by_channel], [Matrix(sv)] * 3, model)
    colour = COLOUR_MODELS[model]
    notes = {"colour": f"FMF: {colour}", "dynamic_range_reduction": reduction, "height_map": [width, height]}
    return factors, notes


def _read_factors(cursor: Cursor, rows: int, texels: int, what: str) -> tuple[Array, Array]:
    """U (rows, K) and S·V (texels, K) as views of the file; `what` names them in errors.

    The file states its numbers of rows and texels again; `InputError` if they are not those of its directions and size.
    """
    scalar, rank, stated_rows, stated_cols = cursor.numbers("B3I", what)
    if scalar not in SCALARS or not rank:
        raise cursor.error(f"{what}: rank {rank} in scalars of {scalar} bytes")
    if (stated_rows, stated_cols) != (rows, texels):
        raise cursor.error(f"{what}: {stated_rows} x {stated_cols} factors; directions and size need {rows} x {texels}")
    cursor.floats((rank,), scalar, f"{what}: S")  # passed over: S·V has the singular values as factors
    u = cursor.floats((rows, rank), scalar, f"{what}: U")
    sv = cursor.floats((texels, rank), scalar, f"{what}: SV")
    return u, sv


class FactorSource(Source):
    """A memory-mapped factorisation, multiplied on demand: cheap by slice, by ABRDF and scattered.

    Values that overflow in a product or an exponential are a `NotFiniteError`.
    """

    def __init__(self, path: Path, factors: Factorisation, shape: tuple[int, int]):
        self.path = path
        self.factors = factors
        self.shape = shape
        self.count = len(factors.pairs[0].stored)
        bytes_of_a_texel = 12 + 12  # its products in three channels, and its RGB, as float32
        self.at_once = max(1, MULTIPLIED // (bytes_of_a_texel * self.shape[0] * self.shape[1]))

    @np.errstate(over="ignore", invalid="ignore")
    def slices(self, pairs: Array) -> list[Array]:
        """As `Source.slices`, (H, W, 3) float32 each: one matrix product a channel for all of the pairs."""
        channels = []  # three arrays (n, H, W)
        for texels, of_pairs in zip(self.factors.texels, self.factors.pairs, strict=True):
            products = texels.times(of_pairs.rows(pairs))
            channels.append(products.reshape(-1, *self.shape))
        pictures = np.empty((len(pairs), *self.shape, 3), np.float32)
        for i, (pair, picture) in enumerate(zip(pairs, pictures, strict=True)):
            planes = [channel[i] for channel in channels]  # of one picture
            self._decode(planes, out=picture[::-1])  # the file counts from the bottom row
            finite(picture, f"{self.path}: slice of pair {pair}")
        return list(pictures)

    @np.errstate(over="ignore", invalid="ignore")
    def texels(self, rows: Array, cols: Array, pairs: Array) -> Array:
        """As `Source.texels`, (n, pairs, 3) float32: `TEXELS_AT_ONCE` at once, in buffers that are used again."""
        index = self._index(rows, cols)
        out = np.empty((len(index), len(pairs), 3), np.float32)
        # The factors (K, pairs) of each channel.
        pair_factors = [np.ascontiguousarray(matrix.rows(pairs).T) for matrix in self.factors.pairs]
        buffers = np.empty((3, TEXELS_AT_ONCE, len(pairs)), np.float32)  # the products of each channel
        for start in range(0, len(index), TEXELS_AT_ONCE):
            block_index = index[start : start + TEXELS_AT_ONCE]
            count = len(block_index)  # the last block may be shorter
            for texel_matrix, factors, buffer in zip(self.factors.texels, pair_factors, buffers, strict=True):
                np.matmul(texel_matrix.rows(block_index), factors, out=buffer[:count])
            decoded = self._decode(buffers[:, :count], out=out[start : start + TEXELS_AT_ONCE])
            finite(decoded, f"{self.path}: texels from {start}")
        return out

    @np.errstate(over="ignore", invalid="ignore")
    def gather(self, pair: Array, row: Array, col: Array) -> Array:
        """As `Source.gather`, `VALUES_AT_ONCE` values at once."""
        index = self._index(row, col)
        out = np.empty((len(index), 3), np.float32)
        for start in range(0, len(index), VALUES_AT_ONCE):
            part = slice(start, start + VALUES_AT_ONCE)
            channels = []
            for texels, of_pairs in zip(self.factors.texels, self.factors.pairs, strict=True):
                products = np.einsum("nk,nk->n", texels.rows(index[part]), of_pairs.rows(pair[part]))
                channels.append(products)
            out[part] = finite(self._decode(channels), f"{self.path}: samples from {start}")
        return out

    def _index(self, rows: Array, cols: Array) -> Array:
        """The rows (n,) of S·V that hold n texels (rows[i], cols[i]); the file counts from the bottom row."""
        return (self.shape[0] - 1 - rows) * self.shape[1] + cols

    def _decode(self, channels: Sequence[Array] | Array, out: Array | None = None) -> Array:
        """Linear RGB (..., 3) float32 of three channels (...) of the colour model.

        It is written to `out`, which is returned, or to a new array. The channels may be overwritten: model 11 computes
        in them.
        """
        if out is None:
            out = np.empty((*channels[0].shape, 3), np.float32)
        if self.factors.model == 11:  # log luminance and relative chroma
            _yuv_to_rgb(channels, out)
            return out
        for i, channel in enumerate(channels):
            out[..., i] = channel
        if self.factors.model == 12:  # logarithms of RGB
            np.subtract(np.exp(out, out=out), EPSILON, out=out)
        return out

    def fingerprint(self) -> str:
        return file_digest(self.path)


def _yuv_to_rgb(channels: Sequence[Array] | Array, out: Array) -> None:
    """Write the RGB of colour model 11 to `out` (..., 3); the channels, each (...), are overwritten.

    They are log (Y + EPSILON), U / Y and V / Y.
    """
    y, u, v = channels
    np.exp(y, out=y)
    np.subtract(y, EPSILON, out=y)
    # Bonn's btflib (undecorrelate.m) multiplies the ratios by Y + EPSILON instead; the difference is about EPSILON.
    for chroma in (u, v):
        np.multiply(chroma, y, out=chroma)
        np.add(chroma, EPSILON, out=chroma)
    # The rows of the matrix are red, green and blue, its columns Y, U and V. Every colour has Y once; red has no U, and
    # blue no V.
    (_, _, red_v), (_, green_u, green_v), (_, blue_u, _) = YUV_TO_RGB
    out[..., 0] = y + red_v * v
    out[..., 1] = y + green_u * u + green_v * v
    out[..., 2] = y + blue_u * u
