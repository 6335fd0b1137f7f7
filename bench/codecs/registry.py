"""Finds codecs by entry point, `neubtf_bench.codecs`: name → "module:Class". Listing them imports none of them."""

import ast
import importlib.util
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import TYPE_CHECKING

from bench.errors import InputError, did_you_mean

if TYPE_CHECKING:
    from bench.codec import Codec

GROUP = "neubtf_bench.codecs"


def codec_entries() -> dict[str, EntryPoint]:
    """Every installed codec's entry point by name. Two packages that claim one name are an error."""
    found: dict[str, EntryPoint] = {}
    for entry in entry_points(group=GROUP):
        other = found.setdefault(entry.name, entry)
        if other.value != entry.value:
            raise InputError(f"two codecs are named {entry.name!r}: {other.value} and {entry.value}: uninstall one")
    return found


def load_codec(name: str, wanted_by: str = "") -> "type[Codec]":
    """The class of a codec. `InputError` where none has the name, or where the class does not bear it."""
    entries = codec_entries()
    prefix = f"{wanted_by}: " if wanted_by else ""
    if name not in entries:
        raise InputError(f"{prefix}no codec named {name!r} is installed{did_you_mean(name, entries)}")
    codec = entries[name].load()
    if codec.name != name:
        raise InputError(f"{prefix}entry point {name!r} leads to a codec that calls itself {codec.name!r}")
    return codec


def origin(entry: EntryPoint) -> str:
    """The distribution that a codec comes from, and its version: `neubtf-bench 0.1.0`."""
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist else "an unknown distribution"


def describe(entry: EntryPoint) -> str:
    """The first line of a codec's docstring, read from its source, so that listing imports no PyTorch."""
    module, _, attribute = entry.value.partition(":")
    return first_line(module, attribute)


def first_line(module: str, class_name: str = "") -> str:
    """The first line of the docstring of a module, or of a class in it, read from the source."""
    spec = importlib.util.find_spec(module)
    if spec is None or spec.origin is None:
        return f"not importable: {module}"
    tree = ast.parse(Path(spec.origin).read_text(encoding="utf-8"))
    classes = (node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == class_name)
    node = next(classes, None) if class_name else tree
    return (ast.get_docstring(node) or "").split("\n")[0] if node else ""
