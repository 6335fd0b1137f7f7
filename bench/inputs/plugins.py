"""What other packages add by entry points: codecs, metrics, readers. Finding them imports none.

An entry point is a line in a package's metadata: under a group such as `neubtf_bench.readers`, a name and the object
that it stands for, `module:object`. A distribution is a package as it is installed, with its version.
"""

import importlib.util
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from importlib.machinery import EXTENSION_SUFFIXES
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from bench.inputs.errors import InputError, said_by

OURS = "neubtf-bench"


class PluginError(InputError):
    """A metric or a reader of another package that cannot be used, or fails; the message names it and its package."""


def entries(group: str, kind: str) -> dict[str, EntryPoint]:
    """The entry points of a group by name. `kind` ("codec") names them in errors.

    Raises `InputError` if two packages use the same name for different objects.
    """
    entry_of_name: dict[str, EntryPoint] = {}
    for entry in points(group):
        other = entry_of_name.setdefault(entry.name, entry)  # the first of that name, maybe this one itself
        if other.value != entry.value:
            raise InputError(f"two {kind}s are named {entry.name!r}: {other.value} and {entry.value}: uninstall one")
    return entry_of_name


def points(group: str) -> tuple[EntryPoint, ...]:
    """The entry points of a group. Finding them takes some 10 ms, so they are kept until a package is installed."""
    state = []  # the folders from which Python imports, each with the time at which something was last added to it
    for folder in map(os.path.abspath, sys.path):  # "" is the working folder
        with suppress(OSError):  # it need not exist
            state.append((folder, os.stat(folder).st_mtime_ns))
    return _points(group, tuple(state))


@lru_cache(maxsize=16)
def _points(group: str, state_of_path: tuple[tuple[str, int], ...]) -> tuple[EntryPoint, ...]:
    """As `points`; read once for each state of the folders from which Python imports."""
    return tuple(entry_points(group=group))


def is_outside(entry: EntryPoint) -> bool:
    """Whether an entry point belongs to another distribution than this suite."""
    return entry.dist is not None and entry.dist.name != OURS


def origin(entry: EntryPoint) -> str:
    """The distribution of an entry point and its version: `neubtf-bench 0.1.0`."""
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist else "an unknown distribution"


def called(entry: EntryPoint, kind: str) -> str:
    """The name of what an entry point adds in errors, with its distribution: `codec mine of my-package 1.0`."""
    return f"{kind} {entry.name} of {origin(entry)}"


def remedy(entry: EntryPoint) -> str:
    """What a user can do about a package that does not work: mend it, or uninstall it by its name."""
    return f"mend it, or uninstall {entry.dist.name}" if entry.dist else "mend it, or uninstall it"


@contextmanager
def naming(
    words: str,
    advice: str = "",
    *,
    kind: type[InputError] = PluginError,
    passed: tuple[type[Exception], ...] = (),
) -> Iterator[None]:
    """Turn what another package raises, even an exit, into one line: `words`, what was raised, and `advice`.

    `words` name what the package adds, and say what fails; `advice` is the remedy, or "". The new error is of type
    `kind`; errors of the types `passed` stay as they are.
    """
    try:
        yield
    except passed:
        raise
    except (Exception, SystemExit) as error:
        ending = f": {advice}" if advice else ""
        raise kind(f"{words}: {said_by(error)}{ending}") from error


def imported(entry: EntryPoint, kind: str) -> Any:
    """The object of an entry point, imported. `PluginError` names the package if it cannot be imported.

    `kind` ("reader") is what the error calls it.
    """
    with naming(f"{called(entry, kind)} cannot be imported", remedy(entry)):
        return entry.load()


def source_of(module: str) -> Path | None:
    """The file of a module, `.py` or compiled; None if there is none. Neither it nor its packages are imported."""
    file_of_imported = getattr(sys.modules.get(module), "__file__", None)
    if file_of_imported:
        return Path(file_of_imported)
    # Python would import the packages around a module to find it, so only the outermost is looked up.
    top, *inside = module.split(".")
    try:
        spec = importlib.util.find_spec(top)
    except (ImportError, ValueError):
        return None
    if spec is None:
        return None
    if not inside:
        return Path(spec.origin) if spec.origin and spec.has_location else None
    for folder in spec.submodule_search_locations or ():
        for ending in (".py", "/__init__.py", *EXTENSION_SUFFIXES):
            path = Path(f"{Path(folder, *inside)}{ending}")
            if path.is_file():
                return path
    return None
