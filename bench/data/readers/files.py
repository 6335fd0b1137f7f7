"""Files in a folder, read by name, and what shows the format of a file or a folder (`Candidate`).

Each read opens and closes its file, so threads and forked processes can share these objects.
"""

import hashlib
import os
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from bench.files.archive import MAX_FILE, ZipFiles
from bench.inputs.errors import InputError, readable, refuse_pipe

WHOLE = 64 << 20  # bytes that a digest reads completely; of more it reads blocks
BLOCK = 64 << 10  # bytes of such a block at most
HEAD = 4096  # bytes at the start of a file that show its format
# Levels of files that are listed: those in the folder, in its folders, and in theirs. Databases have a folder a view,
# which is two; the third is for an archive that was unpacked into a folder of its name. A home folder, given by
# mistake, is not walked whole.
MAX_DEPTH = 3
UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")  # byte order marks, little-endian and big-endian


class FolderFiles:
    """The files below a folder, by name: their paths from it, with forward slashes.

    `bench.files.archive.ZipFiles` has the same methods for the entries of a zip, so readers take either (`Files`).
    """

    def __init__(self, root: Path):
        self.root = root

    def label(self, name: str) -> str:
        """The name of the file in messages."""
        return str(self.root / name)

    def has(self, name: str) -> bool:
        """Whether the name is a regular file (a pipe would make a reader wait)."""
        return (self.root / name).is_file()

    def beside(self, name: str) -> list[str]:
        """The names of everything in the folder of a file, folders too; the file need not be there; [] if that cannot
        be listed."""
        folder = (self.root / name).parent
        try:
            return [(Path(name).parent / found).as_posix() for found in os.listdir(folder)]
        except OSError:
            return []

    def size(self, name: str) -> int:
        """Bytes of the file. `InputError` for a pipe, which would make a reader wait."""
        refuse_pipe(self.root / name)
        with readable(self.label(name)):
            return (self.root / name).stat().st_size

    def head(self, name: str, count: int) -> bytes:
        """The first `count` bytes, or fewer if the file ends. `InputError` for a pipe."""
        refuse_pipe(self.root / name)
        with readable(self.label(name)), open(self.root / name, "rb") as stream:
            return stream.read(count)

    def read(self, name: str) -> bytes:
        """All bytes; `InputError` for a file above `MAX_FILE` bytes."""
        if self.size(name) > MAX_FILE:
            raise InputError(f"{self.label(name)}: it is larger than {MAX_FILE >> 20} MiB: split it")
        return self.head(name, MAX_FILE)

    def digest(self, names: Iterable[str]) -> str:
        """Hex SHA-256 of files: of their names and sizes, and of their bytes.

        Of files with more than `WHOLE` bytes together, the small ones are read whole, and of each other one blocks that
        are spread over it.
        """
        names = list(names)
        sizes = [self.size(name) for name in names]
        digest = hashlib.sha256()
        budget = None  # bytes to read of each file; None reads all
        if sum(sizes) > WHOLE:
            # Together about `WHOLE`; of very many files more, so that some of each is read.
            budget = max(4096, WHOLE // len(names))
        for name, size in zip(names, sizes, strict=True):
            # Names may hold bytes that are not UTF-8; `surrogateescape` gives these bytes back.
            digest.update(f"{name}\0{size}\0".encode("utf-8", "surrogateescape"))
            _update(digest, self.root / name, size, budget)
        return digest.hexdigest()


def file_digest(path: Path) -> str:
    """Hex SHA-256 of a file: of its size, and of all its bytes, or above 64 MiB of 256 spread blocks of 64 KiB."""
    size = path.stat().st_size
    digest = hashlib.sha256(str(size).encode())
    budget = None if size <= WHOLE else 256 * BLOCK
    _update(digest, path, size, budget)
    return digest.hexdigest()


def _update(digest: "hashlib._Hash", path: Path, size: int, budget: int | None) -> None:
    """Feed a file of `size` bytes into a digest: whole, or about `budget` bytes of it in evenly spread blocks that
    include both ends.

    A `budget` of None reads the whole file.
    """
    with open(path, "rb") as stream:
        if budget is None or size <= budget:
            while block := stream.read(1 << 20):
                digest.update(block)
            return
        length = min(BLOCK, budget // 4)  # at least four blocks
        count = budget // length
        for index in range(count):
            # The first block begins at 0, and the last one ends with the file.
            stream.seek((size - length) * index // (count - 1))
            digest.update(stream.read(length))


Files = FolderFiles | ZipFiles


@dataclass(frozen=True)
class Candidate:
    """A file or a folder whose format is sought, with what shows the format; each reader is asked if it knows it.

    The first use of a property reads the disk; it raises `OSError` if that fails.
    """

    path: Path
    # The unit that the user names for angles that a file states as degrees: "degrees", "radians", or "" for none.
    angles: str = ""

    @cached_property
    def head(self) -> bytes:
        """The first `HEAD` bytes of a file; of a folder none. `InputError` for a pipe, where a read would wait."""
        if self.is_folder:
            return b""
        refuse_pipe(self.path)
        with open(self.path, "rb") as stream:
            return stream.read(HEAD)

    @cached_property
    def is_folder(self) -> bool:
        return self.path.is_dir()

    @property
    def is_zip(self) -> bool:
        return self.head[:4] == b"PK\x03\x04"  # how the first entry of an archive begins

    @cached_property
    def names(self) -> list[str]:
        """The files in a folder, three levels deep, or in a zip archive, with forward slashes; else empty. Raises
        `InputError` for a damaged archive."""
        if self.is_folder:
            return list_folder(self.path)
        if self.is_zip:
            return list(ZipFiles(self.path).entries)
        return []

    @property
    def first_line(self) -> str:
        """The first line of a text file that is not blank, stripped, as far as `head` has it; "" for an archive.

        Another binary file gives some text that no reader looks for.
        """
        if self.is_zip:
            return ""  # it begins with the names and bytes of its entries, which are no line
        encoding = "utf-16" if self.head.startswith(UTF16_MARKS) else "utf-8-sig"
        text = self.head.decode(encoding, "replace").lstrip()  # lines that are empty or blank go, too
        line, _, _ = text.partition("\n")
        return line.strip()


def text_of(data: bytes) -> str:
    """The text of the bytes of a file: in UTF-16 if its mark comes first, else in UTF-8, or in Latin-1 if that fails.

    `ValueError` for binary data. Latin-1 gives text for any bytes, so it comes last.
    """
    if data.startswith(UTF16_MARKS):
        return data.decode("utf-16")
    if b"\0" in data:
        raise ValueError("it holds zero bytes: binary data, or UTF-16 without its mark")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def list_folder(path: Path) -> list[str]:
    """Names of the files up to three levels below a folder, with forward slashes, sorted."""
    names = []
    for place, folders, files in os.walk(path):
        inner = Path(place).relative_to(path)
        if len(inner.parts) + 1 >= MAX_DEPTH:  # the files of this folder are of the last level
            folders.clear()  # `os.walk` then goes no deeper
        names += [(inner / name).as_posix() for name in files]
    return sorted(names)
