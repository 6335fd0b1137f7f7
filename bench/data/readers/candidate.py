"""The first bytes and names of a file or folder, by which readers recognise their format."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from bench.inputs.errors import refuse_pipe

HEAD = 4096


@dataclass(frozen=True)
class Candidate:
    """A file with its first bytes, or a folder, for which `head` is empty."""

    path: Path
    head: bytes

    @classmethod
    def read(cls, path: Path) -> "Candidate":
        """Look at a path; `OSError` if it cannot be read."""
        if path.is_dir():
            return cls(path, b"")
        refuse_pipe(path)
        with open(path, "rb") as stream:
            return cls(path, stream.read(HEAD))

    @cached_property
    def is_folder(self) -> bool:
        return self.path.is_dir()

    @property
    def is_zip(self) -> bool:
        return self.head[:4] == b"PK\x03\x04"

    @cached_property
    def names(self) -> list[str]:
        """The files in a folder, three levels deep, or in a zip archive, with forward slashes; else empty. Raises
        `InputError` for a damaged archive."""
        from bench.data.readers.named import list_folder
        from bench.files.archive import ZipFiles

        if self.is_folder:
            return list_folder(self.path)
        return list(ZipFiles(self.path).entries) if self.is_zip else []

    @property
    def first_line(self) -> str:
        """The first line of a text file; "" for an archive."""
        if self.is_zip:
            return ""
        return self.head.decode("utf-8-sig", "replace").lstrip().split("\n", 1)[0].strip()

    @property
    def described(self) -> str:
        """The reason why it is not a known BTF, and the start of a remedy."""
        if self.is_folder:
            held = ", ".join(sorted(p.name for p in self.path.iterdir())[:3]) or "nothing"
            return f"it is not a BTF folder (it holds {held}): add pairs.csv, or"
        if self.is_zip:
            return f"it is not an archive of a known BTF (it holds {', '.join(self.names[:3]) or 'nothing'}):"
        return f"it begins with {self.head[:10]!r}, like no known BTF:"
