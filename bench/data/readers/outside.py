"""Readers that other installed packages add: modules with a function `opened(seen)`, as in `bench.data.readers`.

A package names its module by an entry point of the group `neubtf_bench.readers` in its `pyproject.toml`. For a file or
folder that no built-in reader knows, these modules are imported and asked one after another, in the order of the names.
"""

from collections.abc import Collection, Iterable
from importlib.metadata import EntryPoint
from typing import Any

import numpy as np

from bench.btf import BTF
from bench.data.readers.files import Candidate
from bench.inputs import plugins
from bench.inputs.errors import InputError, said_by
from bench.inputs.plugins import PluginError, called, remedy

GROUP, KIND = "neubtf_bench.readers", "reader"


def entries(built_in: Collection[str]) -> dict[str, EntryPoint]:
    """Name → entry point of each reader of another package, in the order of the names; none is imported.

    `built_in` has the names of the built-in readers. Raises `InputError` if two packages use the same name,
    `PluginError` if one has the name of a built-in reader.
    """
    readers = dict(sorted(plugins.entries(GROUP, KIND).items()))
    for name, entry in readers.items():
        if name in built_in:
            fault = "has the name of a built-in reader: choose another name"
            raise PluginError(f"{called(entry, KIND)} {fault}; {remedy(entry)}")
    return readers


def opened(seen: Candidate, readers: Iterable[EntryPoint]) -> tuple[BTF | None, list[str]]:
    """The BTF of the first of these readers that knows the format of `seen`, None if none does; and faults.

    A fault is a sentence on a reader that cannot be imported or has no function `opened`, which does not stop the
    others. Raises `PluginError` that names the reader, if it fails or returns something else than a BTF whose first
    slice is (H, W, 3) float32; an `InputError` of its own, which is about the file, is passed on.
    """
    faults = []
    for entry in readers:
        try:
            reader = _module(entry)
        except PluginError as error:
            faults.append(str(error))
            continue
        btf = _call(entry, seen, reader.opened, seen)
        if btf is None:
            continue
        if not isinstance(btf, BTF):
            fault = f"opened returned a {type(btf).__name__}, but must return a BTF, or None"
            raise PluginError(f"{seen.path}: {called(entry, KIND)}: {fault}")
        # Read from the source: `btf[0]` would refuse NaN, which the option --repair may mask later.
        first = _call(entry, seen, lambda given: given.source.slice(int(given.pairs[0])), btf)
        form = f"{first.shape} {first.dtype}" if isinstance(first, np.ndarray) else f"a {type(first).__name__}"
        if form != f"{(*btf.shape, 3)} float32":
            fault = f"slice 0 is {form}, but must be {(*btf.shape, 3)} float32"
            raise PluginError(f"{seen.path}: {called(entry, KIND)}: {fault}")
        return btf, faults
    return None, faults


def description(entry: EntryPoint) -> str:
    """The first line of the docstring of a reader, which is imported, or words for what is wrong with the reader."""
    try:
        text = (_module(entry).__doc__ or "").strip()
    except PluginError as error:
        return f"FAILS: {error}"
    return text.split("\n")[0] or f"no description: add a docstring to {entry.value}"


def _module(entry: EntryPoint) -> Any:
    """The module of a reader; `PluginError` if it cannot be imported or has no function `opened`."""
    module = plugins.imported(entry, KIND)
    if not callable(getattr(module, "opened", None)):
        raise PluginError(f"{called(entry, KIND)}: {entry.value} has no function `opened`: add it; {remedy(entry)}")
    return module


def _call(entry: EntryPoint, seen: Candidate, function: Any, *arguments: Any) -> Any:
    """What a function of the reader `entry` returns for some arguments; `seen` is named in errors.

    Errors about the file or the machine pass; any other becomes a `PluginError` that names the reader.
    """
    try:
        return function(*arguments)
    except (InputError, OSError, MemoryError):
        raise
    except (Exception, SystemExit) as error:  # a foreign reader must not end the program either
        words = f"{called(entry, KIND)} fails: {said_by(error)}"
        raise PluginError(f"{seen.path}: {words}: {remedy(entry)}") from error
