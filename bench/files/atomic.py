"""Writes files completely or not at all (a temporary name, then a rename), and locates the cache folder."""

import fcntl
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.inputs.errors import InputError

if TYPE_CHECKING:
    import numpy as np

SUFFIX = ".partial"


def refuse_device(path: Path) -> None:
    """Raise an `InputError` for a device, a pipe or a socket: a file would take its place, even that of /dev/null."""
    if path.exists() and not path.is_file() and not path.is_dir():
        raise InputError(f"{path}: it is neither a file nor a folder, so it cannot be written: give another name")


@contextmanager
def temporary(path: Path) -> Iterator[Path]:
    """Yield a temporary name beside `path`; a file or folder under that name is removed when the block ends.

    The name is random, so processes on several machines can write the same file without mixing their bytes. An
    `OSError` that names the temporary file or no file (a full disk) is changed to name `path`.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(secrets.token_hex(8) + SUFFIX)
    try:
        yield partial
    except OSError as error:
        if error.errno is not None and error.filename in (None, str(partial)):
            error.filename = str(path)
            error.filename2 = None
        raise
    finally:
        if partial.is_dir():
            shutil.rmtree(partial)
        # Asked first: on a read-only file system, removing what does not exist would be an error of its own.
        if os.path.lexists(partial):
            partial.unlink(missing_ok=True)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a name as `temporary` does; it is renamed to `path` when the block ends without an error.

    `InputError` if `path` is a device or a pipe.
    """
    refuse_device(path)
    with temporary(path) as partial:
        yield partial
        os.replace(partial, path)


def write(path: Path, data: bytes) -> None:
    """Write a file atomically: its bytes are synced to disk before it is renamed."""
    with replacing(path) as partial, open(partial, "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def mapped(path: Path, dtype: Any, shape: tuple[int, ...]) -> "np.ndarray":
    """Create a memory-mapped .npy file to be filled, and reserve its disk space. A full disk raises an `OSError` here;
    a later write to the mapping would kill the process instead."""
    import numpy as np

    values: np.ndarray = np.lib.format.open_memmap(path, "w+", dtype=dtype, shape=shape)
    with open(path, "r+b") as file:
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(file.fileno(), 0, os.fstat(file.fileno()).st_size)
    return values


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold a lock while making `path`; other processes wait here, and should then check again whether it exists. On a
    file system without locks several processes may make the file at once; each writes it completely."""
    path.parent.mkdir(parents=True, exist_ok=True)
    lock = path.with_name(path.name + ".lock")
    file = _open_locked(lock)
    try:
        yield
    finally:
        lock.unlink(missing_ok=True)
        os.close(file)


def _open_locked(path: Path) -> int:
    """Open and lock the file of that name; if its holder removed it meanwhile, open it again."""
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
    """Whether an open file is still the file at `path`."""
    try:
        return os.path.samestat(os.fstat(file), os.stat(path))
    except FileNotFoundError:
        return False


def cache_dir() -> Path:
    """The cache folder, for renderings and scratch files, which can all be made again; created if missing.
    `$NEUBTF_CACHE`, else `$XDG_CACHE_HOME/neubtf-bench`, else `~/.cache/neubtf-bench`."""
    if chosen := os.environ.get("NEUBTF_CACHE"):
        folder = Path(chosen)
    else:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "neubtf-bench"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def clear_cache() -> tuple[int, int]:
    """Remove every cached file; return their number and their bytes."""
    count = 0
    total = 0
    # In reverse order what is in a folder comes before the folder, which is then empty.
    for path in sorted(cache_dir().rglob("*"), reverse=True):
        if path.is_dir():
            path.rmdir()
        else:
            count += 1
            total += path.stat().st_size
            path.unlink()
    return count, total
