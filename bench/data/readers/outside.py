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
from bench.inputs.errors import InputError
from bench.inputs.plugins import PluginError, called, naming, remedy

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
    others. Raises `PluginError` that names the file and the reader, if the reader fails or returns something else than
    a BTF whose first slice is (H, W, 3) float32. Its errors about the file or the machine are passed on.
    """
    faults = []
    for entry in readers:
        try:
            reader = _module(entry)
        except PluginError as error:
            faults.append(str(error))
            continue
        words = f"{seen.path}: {called(entry, KIND)} fails"
        with naming(words, remedy(entry), passed=(InputError, OSError, MemoryError)):
            btf = reader.opened(seen)
            if btf is not None:
                _check(btf)
                return btf, faults
    return None, faults


def _check(btf: Any) -> None:
    """Read the first slice of what a reader returned. `TypeError` unless it is a BTF, and the slice (H, W, 3) float32.

    The slice is read from the source, because `btf[0]` would refuse NaN, which the option --repair may mask later.
    """
    if not isinstance(btf, BTF):
        raise TypeError(f"opened returned a {type(btf).__name__}, but must return a BTF, or None")
    first: Any = btf.source.slice(int(btf.pairs[0]))
    form = f"{first.shape} {first.dtype}" if isinstance(first, np.ndarray) else f"a {type(first).__name__}"
    due = f"{(*btf.shape, 3)} float32"
    if form != due:
        raise TypeError(f"slice 0 is {form}, but must be {due}")


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
