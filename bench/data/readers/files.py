"""Named files in a folder or a zip archive, read without state, so that threads and forks can share them."""

import hashlib
import zipfile
import zlib
from collections.abc import Iterable
from pathlib import Path, PurePosixPath

from bench.data.readers.checks import readable
from bench.errors import InputError

MAX_FILE = 1 << 29
WHOLE = 64 << 20
BLOCK = 64 << 10


def inside(name: str, label: str) -> str:
    """The name with forward slashes, or an `InputError` where it leaves its folder."""
    tidy = name.replace("\\", "/")
    if not tidy or "\0" in tidy or PurePosixPath(tidy).is_absolute() or ".." in tidy.split("/") or tidy[1:2] == ":":
        raise InputError(f"{label}: the name {name!r} leads out of the folder: use a plain name inside it")
    return tidy


class FolderFiles:
    """The files below a folder."""

    def __init__(self, root: Path):
        self.root = root

    def label(self, name: str) -> str:
        """The name that messages give the file."""
        return str(self.root / name)

    def has(self, name: str) -> bool:
        """True where the name is a regular file (a pipe would make a reader wait)."""
        return (self.root / name).is_file()

    def size(self, name: str) -> int:
        """Bytes of the file."""
        with readable(self.label(name)):
            return (self.root / name).stat().st_size

    def head(self, name: str, count: int) -> bytes:
        """The first `count` bytes, fewer where the file ends."""
        with readable(self.label(name)), open(self.root / name, "rb") as stream:
            return stream.read(count)

    def read(self, name: str) -> bytes:
        """All bytes; a file above `MAX_FILE` is refused."""
        if self.size(name) > MAX_FILE:
            raise InputError(f"{self.label(name)}: larger than {MAX_FILE >> 20} MiB: split it")
        return self.head(name, MAX_FILE)

    def digest(self, names: Iterable[str]) -> str:
        """Hex digest of the files; of large sets, of sizes and spread blocks of each file."""
        names = list(names)
        sizes = [self.size(name) for name in names]
        digest = hashlib.sha256()
        budget = None if sum(sizes) <= WHOLE else max(4096, WHOLE // len(names))
        for name, size in zip(names, sizes, strict=True):
            digest.update(f"{name}\0{size}\0".encode("utf-8", "surrogateescape"))
            _update(digest, self.root / name, size, budget)
        return digest.hexdigest()


def file_digest(path: Path) -> str:
    """Hex digest of a file: all of it up to 64 MiB, else its size and 256 blocks of 64 KiB spread over it."""
    size = path.stat().st_size
    digest = hashlib.sha256(str(size).encode())
    _update(digest, path, size, None if size <= WHOLE else 256 * BLOCK)
    return digest.hexdigest()


def _update(digest: "hashlib._Hash", path: Path, size: int, budget: int | None) -> None:
    """Feed a file into a digest: whole, or `budget` bytes of it in evenly spread blocks with both ends."""
    with open(path, "rb") as stream:
        if budget is None or size <= budget:
            while block := stream.read(1 << 20):
                digest.update(block)
            return
        length = min(BLOCK, budget // 4)
        count = budget // length
        for index in range(count):
            stream.seek((size - length) * index // (count - 1))
            digest.update(stream.read(length))


class ZipFiles:
    """The entries of a zip archive. Nothing is extracted, and an entry is inflated no further than it declares."""

    def __init__(self, path: Path):
        self.path = path
        with (
            readable(str(path), "the archive is damaged or incomplete; get it again"),
            zipfile.ZipFile(path) as archive,
        ):
            self.entries = {e.filename: e for e in archive.infolist() if not e.is_dir()}
        self.length = path.stat().st_size
        for name in self.entries:
            inside(name, str(path))

    def label(self, name: str) -> str:
        """The name that messages give the entry."""
        return f"{self.path}: {name}"

    def has(self, name: str) -> bool:
        """True where the archive has this entry."""
        return name in self.entries

    def size(self, name: str) -> int:
        """Bytes of the entry once inflated, as declared."""
        return self.entries[name].file_size

    def _stored(self, name: str) -> tuple[zipfile.ZipInfo, int]:
        """The entry and the offset of its bytes in the archive, checked against the archive's length."""
        entry, label = self.entries[name], self.label(name)
        if entry.flag_bits & 1:
            raise InputError(f"{label}: encrypted: extract it with its password first")
        if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise InputError(f"{label}: compression method {entry.compress_type} is not read: zip it anew with deflate")
        # Deflate cannot exceed 1032 : 1, so a larger claim is false, and one near it a bomb. What is stored as it is
        # can be no bomb, and is mapped, not read.
        packed = entry.compress_type != zipfile.ZIP_STORED
        limit = min(MAX_FILE, 1032 * entry.compress_size + 64) if packed else entry.compress_size
        if entry.file_size > limit:
            raise InputError(f"{label}: claims {entry.file_size} bytes from {entry.compress_size}: not a picture set")
        with readable(label), open(self.path, "rb") as stream:
            stream.seek(entry.header_offset)
            local = stream.read(30)
            if len(local) < 30 or local[:4] != b"PK\x03\x04":
                raise InputError(f"{label}: no entry at offset {entry.header_offset}: the archive is damaged")
            extra = int.from_bytes(local[26:28], "little") + int.from_bytes(local[28:30], "little")
        start = entry.header_offset + 30 + extra
        if start + entry.compress_size > self.length:
            raise InputError(f"{label}: ends behind the archive: it is truncated; get it again")
        return entry, start

    def offset(self, name: str) -> int | None:
        """Where the bytes of an uncompressed entry begin in the archive, None where it is compressed."""
        entry, start = self._stored(name)
        return start if entry.compress_type == zipfile.ZIP_STORED else None

    def _inflate(self, name: str, count: int, packed_count: int) -> bytes:
        entry, start = self._stored(name)
        packed = _pread(self.path, start, min(entry.compress_size, packed_count))
        if entry.compress_type == zipfile.ZIP_STORED:
            return packed[:count]
        with readable(self.label(name)):
            return zlib.decompressobj(-15).decompress(packed, count)

    def head(self, name: str, count: int) -> bytes:
        """The first `count` bytes of the entry."""
        return self._inflate(name, count, count + 1024)

    def read(self, name: str) -> bytes:
        """All bytes of the entry, checked against its declared size and checksum."""
        entry = self.entries[name]
        if entry.file_size > MAX_FILE:
            raise InputError(f"{self.label(name)}: {entry.file_size} bytes: too large to be read whole")
        data = self._inflate(name, entry.file_size + 1, entry.compress_size)
        if len(data) != entry.file_size or zlib.crc32(data) != entry.CRC:
            raise InputError(f"{self.label(name)}: size or checksum is wrong: the archive is damaged; get it again")
        return data

    def digest(self, names: Iterable[str]) -> str:
        """Hex digest of entries: their names, sizes and checksums, which the archive's directory holds."""
        known = [(name, self.entries[name].file_size, self.entries[name].CRC) for name in names]
        return hashlib.sha256(repr(known).encode("utf-8", "surrogateescape")).hexdigest()


Files = FolderFiles | ZipFiles


def _pread(path: Path, start: int, count: int) -> bytes:
    with open(path, "rb") as stream:
        stream.seek(start)
        return stream.read(count)
