"""Files that are there whole or not at all, written under a temporary name, then renamed; and the cache folder."""

import fcntl
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

SUFFIX = ".partial"


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary name beside `path` to write to; it takes the place of `path` when the block ends without an error.

    The name is random, so that processes of several machines can write the same file, each whole. An `OSError` of the
    temporary name, or of no name, as that of a full disk, tells `path`.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(secrets.token_hex(8) + SUFFIX)
    try:
        yield partial
        os.replace(partial, path)
    except OSError as error:
        if error.errno is not None and error.filename in (None, str(partial)):
            error.filename, error.filename2 = str(path), None
        raise
    finally:
        partial.unlink(missing_ok=True)


def write(path: Path, data: bytes) -> None:
    """Write a file in one move; its bytes are on the disk before its name is."""
    with replacing(path) as partial, open(partial, "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def mapped(path: Path, dtype: Any, shape: tuple[int, ...]) -> "np.ndarray":
    """A new .npy file, memory-mapped, to be filled. Its place on the disk is taken now.

    On a full disk this is an `OSError`, where a write to the mapping would kill the process.
    """
    import numpy as np

    values: np.ndarray = np.lib.format.open_memmap(path, "w+", dtype=dtype, shape=shape)
    with open(path, "r+b") as file:
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(file.fileno(), 0, os.fstat(file.fileno()).st_size)
    return values


@contextmanager
def alone(path: Path) -> Iterator[None]:
    """Hold off other processes that would make `path`: they wait here, and should look again whether it is made.

    Where the file system cannot lock, several make it, each whole.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    lock = path.with_name(path.name + ".lock")
    file = _locked(lock)
    try:
        yield
    finally:
        lock.unlink(missing_ok=True)
        os.close(file)


def _locked(path: Path) -> int:
    """A file of that name, open and locked; who waited for one that its holder removed opens the next."""
    while True:
        file = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            with suppress(OSError):
                fcntl.flock(file, fcntl.LOCK_EX)
            if is_still(file, path):
                return file
        except BaseException:
            os.close(file)
            raise
        os.close(file)


def is_still(file: int, path: Path) -> bool:
    """Whether an open file is the one that stands under a name."""
    try:
        return os.path.samestat(os.fstat(file), os.stat(path))
    except FileNotFoundError:
        return False


def cache_dir() -> Path:
    """The folder of what can be made again, renderings and scratch files; it is made when missing.

    `$NEUBTF_CACHE`, else `$XDG_CACHE_HOME/neubtf-bench`, else `~/.cache/neubtf-bench`.
    """
    if chosen := os.environ.get("NEUBTF_CACHE"):
        folder = Path(chosen)
    else:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "neubtf-bench"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def clear_cache() -> tuple[int, int]:
    """Remove every cached file; return their number and their bytes."""
    count = total = 0
    for path in sorted(cache_dir().rglob("*"), reverse=True):
        if path.is_dir():
            path.rmdir()
        else:
            count, total = count + 1, total + path.stat().st_size
            path.unlink()
    return count, total
