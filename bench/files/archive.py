"""Reads zip archives, and the arrays of an `.npz`, within bounds; nothing is extracted or unpickled.

An archive may be damaged or hostile, so the sizes that it claims are checked before memory is taken. An *entry* is a
file in an archive. In an `.npz`, itself a zip archive, each entry is an array: `NAME.npy`, a short header (shape, type,
order in memory) and then the values.
"""

import hashlib
import io
import itertools
import math
import zipfile
import zlib
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from bench.inputs.errors import InputError, readable, refuse_pipe

Array = np.ndarray
MAX_FILE = 1 << 29  # the most bytes of an inflated (decompressed) entry: 512 MiB
# Below that, an inflated entry may have `LEAST` bytes, or `RATIO` times its compressed bytes if that is more.
LEAST = 1 << 26  # 64 MiB
RATIO = 64
STEP = 1 << 16  # compressed bytes inflated at once
MOST_AT_ONCE = 16 * STEP  # bytes that are inflated at once
_HEAD = 16384  # bytes at the start of an array's entry: its header is shorter
_LOCAL_HEADER = 30  # bytes of the header that stands in the archive before each entry's name


def inside(name: str, label: str) -> str:
    """The name of a file in an archive or list, with forward slashes; `InputError` if it leads out of its folder.

    `label` is what the error calls the archive or list.
    """
    tidy = name.replace("\\", "/")
    # A colon in the second place follows the letter of a drive.
    if not tidy or "\0" in tidy or tidy.startswith("/") or ".." in tidy.split("/") or tidy[1:2] == ":":
        raise InputError(f"{label}: the name {name!r} leads out of the folder: use a plain name inside it")
    return tidy


class ZipFiles:
    """The entries of a zip archive. Nothing is extracted, and no entry is inflated beyond its declared size."""

    def __init__(self, path: Path):
        """Read the archive's directory. `InputError` if it is damaged, or if its names or places cannot be right."""
        self.path = path
        refuse_pipe(path)
        with readable(str(path), "the archive is damaged or incomplete; get it again"), zipfile.ZipFile(path) as zipped:
            listed = zipped.infolist()  # files and folders
        self.entries = {entry.filename: entry for entry in listed if not entry.is_dir()}
        self.length = path.stat().st_size
        for name in self.entries:
            inside(name, str(path))  # raises for a name that leads out of the archive
        # Entries that share bytes would expand them again and again.
        listed.sort(key=lambda entry: entry.header_offset)
        for entry, after in itertools.pairwise(listed):
            # An entry takes at least this header and its bytes; a name and an extra field only add to them.
            if entry.header_offset + _LOCAL_HEADER + entry.compress_size > after.header_offset:
                raise InputError(f"{self.label(after.filename)}: it overlaps {entry.filename}: zip the files again")

    def label(self, name: str) -> str:
        """The name of the entry in messages."""
        return f"{self.path}: {name}"

    def has(self, name: str) -> bool:
        """Whether the archive has this entry."""
        return name in self.entries

    def beside(self, name: str) -> list[str]:
        """The names of all entries, whatever `name`: those beside it, as `FolderFiles` lists them, are among them."""
        return list(self.entries)

    def size(self, name: str) -> int:
        """Bytes of the entry once inflated, as declared."""
        return self.entries[name].file_size

    def _located(self, name: str) -> tuple[zipfile.ZipInfo, int]:
        """The entry and the offset of its bytes in the archive.

        `InputError` if it is damaged, or if `_require_readable` refuses it.
        """
        entry = self.entries[name]
        label = self.label(name)
        _require_readable(entry, label)
        with readable(label), open(self.path, "rb") as stream:
            stream.seek(entry.header_offset)
            local = stream.read(_LOCAL_HEADER)
            if len(local) < _LOCAL_HEADER or local[:4] != b"PK\x03\x04":  # with which every such header begins
                fault = f"there is no entry at offset {entry.header_offset}"
                raise InputError(f"{label}: {fault}: the archive is damaged; get it again")
            # The name and the extra field stand between this header and the bytes; the header ends with their lengths.
            name_length = int.from_bytes(local[26:28], "little")
            extra_length = int.from_bytes(local[28:30], "little")
        start = entry.header_offset + _LOCAL_HEADER + name_length + extra_length
        if start + entry.compress_size > self.length:
            raise InputError(f"{label}: it ends beyond the archive, which is truncated: get it again")
        return entry, start

    def offset(self, name: str) -> int | None:
        """The offset of an uncompressed entry's bytes in the archive; None if it is compressed."""
        entry, start = self._located(name)
        return start if entry.compress_type == zipfile.ZIP_STORED else None

    def _inflate(self, name: str, count: int, packed_count: int) -> bytes:
        """The first `count` bytes of the entry, inflated from the first `packed_count` of its bytes in the archive;
        fewer if there are no more."""
        entry, start = self._located(name)
        with open(self.path, "rb") as stream:
            stream.seek(start)
            packed = stream.read(min(entry.compress_size, packed_count))
        if entry.compress_type == zipfile.ZIP_STORED:
            return packed[:count]
        with readable(self.label(name)):
            return _expanded(packed, count)

    def head(self, name: str, count: int) -> bytes:
        """The first `count` bytes of the entry, or all if there are fewer; no checksum is checked."""
        return self._inflate(name, count, count + 1024)  # deflate makes what it cannot compress a little longer

    def read(self, name: str) -> bytes:
        """All bytes of the entry; `InputError` if size or checksum is not as declared, or above `MAX_FILE` bytes."""
        entry = self.entries[name]
        if entry.file_size > MAX_FILE:
            raise InputError(f"{self.label(name)}: {entry.file_size} bytes are too many to be read at once")
        # One byte more than declared, to notice an entry that is longer.
        data = self._inflate(name, entry.file_size + 1, entry.compress_size)
        if len(data) != entry.file_size or zlib.crc32(data) != entry.CRC:
            raise InputError(f"{self.label(name)}: size or checksum is wrong: the archive is damaged; get it again")
        return data

    def digest(self, names: Iterable[str]) -> str:
        """Hex digest of entries: their names, sizes and checksums, which the archive's directory holds."""
        directory = [(name, self.entries[name].file_size, self.entries[name].CRC) for name in names]
        return hashlib.sha256(repr(directory).encode("utf-8", "surrogateescape")).hexdigest()


def _require_readable(entry: zipfile.ZipInfo, label: str) -> None:
    """Raise an `InputError` if an entry is encrypted, of another compression than deflate, or claims too many bytes."""
    if entry.flag_bits & 1:  # the lowest bit says so
        raise InputError(f"{label}: it is encrypted: extract it with its password first")
    if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise InputError(f"{label}: compression method {entry.compress_type} is not read: zip it with deflate")
    if entry.compress_type == zipfile.ZIP_STORED:  # it cannot be a bomb, and is memory-mapped
        if entry.file_size > entry.compress_size:
            claim = f"it claims {entry.file_size} bytes, but {entry.compress_size} are stored"
            raise InputError(f"{label}: {claim}: the archive is damaged; get it again")
        return
    # Deflate cannot exceed 1032 : 1, so a larger claim is false, and a large entry near it is a bomb.
    plausible = max(LEAST, RATIO * entry.compress_size)
    possible = 1032 * entry.compress_size + 64
    if entry.file_size > min(MAX_FILE, plausible, possible):
        claim = f"it claims {entry.file_size} bytes from {entry.compress_size}, far too many"
        raise InputError(f"{label}: {claim}: zip it again without compression")


def _expanded(packed: bytes, count: int) -> bytes:
    """The first `count` bytes that a deflated stream inflates to, or all if there are fewer.

    It is inflated in pieces, which needs memory only for the result, not twice as much. A piece may inflate to a
    thousand times its size, so at most `MOST_AT_ONCE` bytes are asked for at a time.
    """
    inflated = io.BytesIO()
    inflater = zlib.decompressobj(-15)  # negative: a bare stream, as in a zip
    for start in range(0, len(packed), STEP):
        unread = packed[start : start + STEP]
        while inflated.tell() < count:
            asked = min(MOST_AT_ONCE, count - inflated.tell())
            part = inflater.decompress(unread, asked)
            inflated.write(part)
            unread = inflater.unconsumed_tail
            # The inflater may have read all of the piece and still hold some of its bytes: only fewer than were asked
            # for say that it holds no more.
            if not unread and len(part) < asked:
                break
    return inflated.getvalue()


@dataclass(frozen=True)
class Stored:
    """An array of an `.npz`; only its header was read."""

    files: ZipFiles
    name: str  # of its entry, `KEY.npy`
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    begin: int  # offset of its values in the entry, in bytes
    order: Literal["C", "F"]  # of its values: row by row or, as in Fortran, column by column

    def values(self) -> Array:
        """The array, read-only: memory-mapped if it is stored uncompressed, which checks no checksum, else inflated."""
        offset = self.files.offset(self.name)
        with readable(self.files.label(self.name), "save it with numpy.savez, uncompressed"):
            if offset is not None and all(self.shape):  # an empty array cannot be mapped
                return np.memmap(self.files.path, self.dtype, "r", offset + self.begin, self.shape, self.order)
            return self.held_by(self.files.read(self.name))

    def held_by(self, entry: bytes) -> Array:
        """The array, read-only, of all bytes of its entry."""
        flat = np.frombuffer(entry, self.dtype, math.prod(self.shape), self.begin)
        return flat.reshape(self.shape, order=self.order)


def stored(files: ZipFiles, key: str) -> Stored:
    """The array `key` of an `.npz`, whose header agrees with the number of its bytes.

    `InputError` if there is none, and for all types but plain numbers and text.
    """
    name = f"{key}.npy"
    if not files.has(name):
        raise InputError(f"{files.path}: it has no array {key!r}: add it")
    return _array_of(files, name, files.head(name, _HEAD))


def _array_of(files: ZipFiles, name: str, head: bytes) -> Stored:
    """The array of an entry whose first bytes, at least all of the header, are `head`.

    `InputError` if the header cannot be read, or does not agree with the entry's size.
    """
    label = files.label(name)
    length = len(head)
    if head[6:7] == b"\1":  # version 1: six bytes of magic, two of the version, two with the length of the rest
        length = 10 + int.from_bytes(head[8:10], "little")  # so that equal headers are found in the cache
    with readable(label, "save it with numpy.savez"):
        header = _npy_header(head[:length])
    version, shape, dtype = header.version, header.shape, header.dtype
    if version not in ((1, 0), (2, 0)):
        raise InputError(f"{label}: .npy version {version} is not read: save it with numpy.savez")
    # Floats, integers, unsigned ones, booleans and text; Python's objects would have to be unpickled.
    if dtype.hasobject or dtype.kind not in "fiubU" or not dtype.itemsize or dtype.subdtype:
        raise InputError(f"{label}: type {dtype} is not read: save plain numbers")
    # A shape with negative or absurd sides is wrong, even if its product is a possible size.
    if not all(0 <= side < 1 << 48 for side in shape):
        raise InputError(f"{label}: its shape {shape} is impossible: save it again")
    if header.begin + math.prod(shape) * dtype.itemsize != files.size(name):
        raise InputError(f"{label}: its {files.size(name)} bytes do not hold {shape} of {dtype}: save it again")
    return Stored(files, name, shape, dtype, header.begin, "F" if header.fortran else "C")


class _NpyHeader(NamedTuple):
    """What the header of a `.npy` says; of a version that is not read, only the version counts."""

    version: tuple[int, int]
    shape: tuple[int, ...]
    fortran: bool
    dtype: np.dtype[Any]
    begin: int  # offset of the values


@lru_cache(maxsize=256)
def _npy_header(head: bytes) -> _NpyHeader:
    """The header at the start of some bytes. It is cached, because the arrays of a run share a few headers.

    Raises what NumPy raises for bytes that are no header.
    """
    text = io.BytesIO(head)
    version = np.lib.format.read_magic(text)
    if version == (1, 0):
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(text)
    elif version == (2, 0):
        shape, fortran, dtype = np.lib.format.read_array_header_2_0(text)
    else:  # nothing is read: the caller refuses it
        shape, fortran, dtype = (), False, np.dtype("O")
    return _NpyHeader(version, shape, fortran, dtype, text.tell())


def read_arrays(path: Path, most: int, names: Collection[str] | None = None) -> dict[str, Array]:
    """Every array of an `.npz` by name, in memory and writable; with `names` only those of them that there are.

    `InputError` says what is wrong, also if all entries together claim more than `most` bytes.
    """
    files = ZipFiles(path)
    total = sum(map(files.size, files.entries))
    if total > most:
        raise InputError(f"{path}: it claims {total:,} bytes, but the limit is {most:,}: make it again")
    keys = [name.removesuffix(".npy") for name in files.entries if name.endswith(".npy")]
    return {key: _read_array(files, f"{key}.npy") for key in keys if names is None or key in names}


def _read_array(files: ZipFiles, name: str) -> Array:
    """The array of an entry, checked against its checksum, in memory, and writable."""
    entry = files.read(name)
    array = _array_of(files, name, entry[:_HEAD]).held_by(entry)
    return array.copy(order="K")  # writable, in its own order in memory
