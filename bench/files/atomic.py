"""Writes files completely or not at all, and locates the cache folder.

A file is written under a temporary name beside its own, and then renamed, which the system does in one step.
"""

import fcntl
import logging
import os
import secrets
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.inputs.errors import InputError

if TYPE_CHECKING:
    import numpy as np

log = logging.getLogger(__name__)

SUFFIX = ".partial"  # of temporary names
PNG = b"\x89PNG\r\n\x1a\n"  # how such a picture begins
SHARED = "shared"  # the folder of the cache with networks that a user trained: see `bench.codecs.shared`


def refuse_device(path: Path) -> None:
    """Raise an `InputError` for a device, a pipe or a socket, whose place a file would take, even that of /dev/null;
    and for a path without a name, such as `.`."""
    if not path.name:
        raise InputError(f"{path}: it is a folder: give the name of a file")
    if path.exists() and not path.is_file() and not path.is_dir():
        raise InputError(f"{path}: it is neither a file nor a folder, so it cannot be written: give another name")


def refuse_other_kind(path: Path, ending: str, is_of_kind: Callable[[Path], bool]) -> None:
    """Raise an `InputError` if a file of another kind has this name, such as a measurement, or a folder or a device.

    A file is of the kind if its name has that ending, even a damaged one, or by its content; an empty one is of any.
    """
    if path.is_dir():
        raise InputError(f"{path}: it is a folder: give the name of a file")
    refuse_device(path)
    if not path.is_file() or path.suffix.lower() == ending or not path.stat().st_size:
        return
    if not is_of_kind(path):
        raise InputError(f"{path}: a file of another kind has this name: choose another, or remove it")


def begins(start: bytes) -> Callable[[Path], bool]:
    """A test for `refuse_other_kind`: whether a file begins with these bytes."""

    def begins_so(path: Path) -> bool:
        with open(path, "rb") as file:
            return file.read(len(start)) == start

    return begins_so


def make_folder(path: Path, remedy: str = "choose another place") -> None:
    """Make a folder, and those above it, unless it is there. `InputError`, with the remedy, if a file is in its way."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        in_the_way = next(place for place in (path, *path.parents) if os.path.lexists(place))
        raise InputError(f"{in_the_way}: it is a file, where a folder is to be made: {remedy}") from error


@contextmanager
def temporary(path: Path) -> Iterator[Path]:
    """Yield a temporary name beside `path`; a file or folder under that name is removed when the block ends.

    The name is random, so processes on several machines can write the same file without mixing their bytes. An
    `OSError` that names the temporary file or no file (a full disk) is changed to name `path`.
    """
    make_folder(path.parent)
    partial = path.with_name(secrets.token_hex(8) + SUFFIX)
    try:
        yield partial
    except OSError as error:
        # The user knows `path`, not the temporary name. An error that names another file keeps its name.
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
    """Yield a temporary name beside `path`; what is written there is renamed to `path` when the block ends.

    After an error it is removed, and `path` stays as it was. A link stays a link, to the new file, and a file keeps its
    permissions. `InputError` if `path` is a device or a pipe.
    """
    refuse_device(path)
    target = path.resolve() if path.is_symlink() else path
    with temporary(target) as partial:
        yield partial
        if target.is_file():
            shutil.copymode(target, partial)
        os.replace(partial, target)


def write(path: Path, data: bytes) -> None:
    """Write a file atomically: its bytes are synced to disk before it is renamed."""
    with replacing(path) as partial, open(partial, "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def mapped(path: Path, dtype: Any, shape: tuple[int, ...]) -> "np.memmap":
    """Create a memory-mapped .npy file of zeros to be filled, and reserve its disk space.

    A full disk raises an `OSError` here; a later write to the mapping would kill the process instead.
    """
    import numpy as np

    values: np.memmap = np.lib.format.open_memmap(path, "w+", dtype=dtype, shape=shape)
    if hasattr(os, "posix_fallocate"):  # not on every system
        with open(path, "r+b") as file:
            os.posix_fallocate(file.fileno(), 0, os.fstat(file.fileno()).st_size)
    return values


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold a lock while making or changing `path`; other processes wait here, and should then look at it anew.

    On a file system without locks several processes may write the file at once: each does so completely, and the last
    one's stays.
    """
    with holding(path.with_name(path.name + ".lock")):
        yield


@contextmanager
def holding(lock: Path, wait: bool = True) -> Iterator[int]:
    """Lock a file, which is made if missing, with its folder, and removed at the end; yields its descriptor.

    The system frees the lock when the process ends, for whatever reason. If another process holds it, this one waits;
    without `wait` it raises `BlockingIOError`. On a file system without locks nothing is locked.
    """
    make_folder(lock.parent)
    file = _open_locked(lock, wait)
    try:
        yield file
    finally:
        # Removed while it is still held: once it is closed, the file may be another process's lock.
        lock.unlink(missing_ok=True)
        os.close(file)


def make_once(path: Path, make: Callable[[], None]) -> None:
    """Call `make`, which makes the file `path`, unless it is there. Other processes that want it wait meanwhile."""
    if path.exists():
        return
    with locked(path):
        if not path.exists():  # no other process has made it while this one waited
            make()


def _open_locked(path: Path, wait: bool) -> int:
    """The descriptor of the file of that name, opened and locked as `holding` says.

    If another process removed the file meanwhile, the lock is that of a file without a name: a new one is opened.
    """
    while True:
        file = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            try:
                fcntl.flock(file, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise
            except OSError:
                _warn_without_locks(path.parent)
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(file), os.stat(path)):
                    return file
        except BaseException:  # also when the user interrupts the wait
            os.close(file)
            raise
        os.close(file)


@cache
def _warn_without_locks(folder: Path) -> None:
    """Warn, once for each folder, that its file system has no locks."""
    log.warning("%s: its file system has no locks: let only one process at a time work there", folder)


def cache_dir() -> Path:
    """The cache folder, for renderings and scratch files, which can all be made again; created if missing.

    It is `$NEUBTF_CACHE`, else `$XDG_CACHE_HOME/neubtf-bench`, else `~/.cache/neubtf-bench`.
    """
    if chosen := os.environ.get("NEUBTF_CACHE"):
        folder = Path(chosen)
    else:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "neubtf-bench"
    make_folder(folder, "choose another $NEUBTF_CACHE")
    return folder


def cached_files() -> list[Path]:
    """The files of the cache that can all be made again: not the networks under `SHARED`, which a user trained."""
    folder = cache_dir()
    shared = folder / SHARED
    # A link counts as a file, whatever it leads to.
    files = [path for path in folder.rglob("*") if path.is_symlink() or path.is_file()]
    return [path for path in files if shared not in (path, *path.parents)]  # it may be a link itself


def clear_cache() -> tuple[int, int]:
    """Remove `cached_files`, and the folders that are empty then; return the number of files and their bytes."""
    count = 0
    total = 0
    for path in cached_files():
        with suppress(FileNotFoundError):  # another process removed it meanwhile
            total += path.lstat().st_size
            path.unlink()
            count += 1
    # In reverse order what is in a folder comes before the folder.
    for path in sorted(cache_dir().rglob("*"), reverse=True):
        if path.is_dir() and not path.is_symlink():
            with suppress(OSError):  # it holds a trained network, or a file that another process wrote meanwhile
                path.rmdir()
    return count, total
