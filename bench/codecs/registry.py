"""Finds codecs by entry point, `neubtf_bench.codecs`: name → "module:Class". Listing them imports none of them."""

import ast
import importlib.util
import re
import tomllib
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.codecs import outside_codecs
from bench.errors import CodecError, InputError, did_you_mean

if TYPE_CHECKING:
    from bench.codec import Codec

GROUP = "neubtf_bench.codecs"
COMMAND = "command"  # the codec of other programs; lists omit it, because it is useless without them
_OF_COMMANDS = EntryPoint(COMMAND, "bench.codecs.command:Programs", GROUP)


def codec_entries() -> dict[str, EntryPoint]:
    """Every installed codec's entry point by name. `InputError` if two packages use the same name."""
    entries: dict[str, EntryPoint] = {}
    for entry in entry_points(group=GROUP):
        other = entries.setdefault(entry.name, entry)
        if other.value != entry.value:
            raise InputError(f"two codecs are named {entry.name!r}: {other.value} and {entry.value}: uninstall one")
    return entries


def load_codec(name: str, wanted_by: str = "") -> "type[Codec]":
    """Import the class of a codec. `InputError` if no codec has the name, or if its class has another name."""
    entry = _entry(name, wanted_by)
    outside_codecs.check(entry, called(entry), _made_in_child)
    return _loaded(entry, wanted_by)


def make_codec(name: str, settings: dict[str, Any]) -> "Codec":
    """Make a codec with some settings. `InputError` if they are invalid, `CodecError` if the codec fails."""
    entry = _entry(name)
    outside_codecs.check(entry, called(entry), _made_in_child, settings)
    try:
        return _loaded(entry)(**settings)
    except (Exception, SystemExit) as error:
        if isinstance(error, InputError):
            raise
        raise CodecError(f"{called(entry)} fails with the settings {settings}: {_kind(error)}") from error


def _made_in_child(name: str, settings: dict[str, Any] | None) -> object:
    """Make a codec; the process that tries an external codec calls this."""
    return load_codec(name) if settings is None else make_codec(name, settings)


def _entry(name: str, wanted_by: str = "") -> EntryPoint:
    entries = codec_entries()
    if name == COMMAND:
        return _OF_COMMANDS
    if name not in entries:
        prefix = f"{wanted_by}: " if wanted_by else ""
        remedy = f": pip install ./{name}" if _lies_here(name) else did_you_mean(name, entries)
        raise InputError(f"{prefix}no codec named {name!r} is installed{remedy}")
    return entries[name]


def _lies_here(name: str) -> bool:
    """Whether a folder of that name is a package with such a codec."""
    try:
        project = tomllib.loads(Path(name, "pyproject.toml").read_text("utf-8"))["project"]
        return name in project["entry-points"][GROUP]
    except (OSError, ValueError, KeyError, TypeError):
        return False


def _loaded(entry: EntryPoint, wanted_by: str = "") -> "type[Codec]":
    prefix = f"{wanted_by}: " if wanted_by else ""
    try:
        codec: type[Codec] = entry.load()
    except (Exception, SystemExit) as error:
        raise CodecError(f"{prefix}{called(entry)} cannot be imported: {_kind(error)}") from error
    if (name := getattr(codec, "name", None)) != entry.name:
        raise InputError(f"{prefix}entry point {entry.name!r} leads to a codec that calls itself {name!r}")
    if not isinstance(getattr(codec, "version", None), int):
        raise InputError(f"{prefix}{called(entry)} has no version: add `version = 1` to its class")
    return codec


def _kind(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"


def from_outside(name: str) -> bool:
    """Whether a codec comes from a distribution other than this suite."""
    entry = codec_entries().get(name)
    return entry is not None and outside_codecs.is_outside(entry)


def called(entry: EntryPoint) -> str:
    """The name of a codec in errors, with its distribution."""
    return f"codec {entry.name} of {origin(entry)}"


def origin(entry: EntryPoint) -> str:
    """The distribution of a codec and its version: `neubtf-bench 0.1.0`."""
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist else "an unknown distribution"


def describe(entry: EntryPoint) -> str:
    """The first line of a codec's docstring, read from its source, so that listing imports no PyTorch."""
    module, _, attribute = entry.value.partition(":")
    return first_line(module, attribute)


def listed(entry: EntryPoint) -> str:
    """`describe`, or what fails when the codec is loaded: an external one is tried, in a process of its own."""
    try:
        outside_codecs.check(entry, called(entry), _made_in_child)
        return describe(entry)
    except Exception as error:  # any exception of a foreign codec is its failure
        return f"FAILS: {' '.join(str(error).split())}"


def reference(entry: EntryPoint) -> dict[str, str]:
    """What a codec's docstring says of its origin: `bibtex`, one entry, the link of its `paper`, and of its `code`.

    The paper's link is the entry's doi or url; the code's follows "Code: ". "" where there is none.
    """
    module, _, attribute = entry.value.partition(":")
    text = _docstring(module, attribute)
    bibtex = _found(r"^@\w+\{.*?^\}$", text)
    doi = _found(r"\bdoi = \{([^{}\s]+)\}", bibtex)
    paper = f"https://doi.org/{doi}" if doi else _found(r"\burl = \{(https://[^{}\s]+)\}", bibtex)
    return {"bibtex": bibtex, "paper": paper, "code": _found(r"^Code: (https://\S+)$", text)}


def _found(pattern: str, text: str) -> str:
    found = re.search(pattern, text, re.M | re.S)
    return found[found.re.groups] if found else ""


def first_line(module: str, class_name: str = "") -> str:
    """The first line of the docstring of a module, or of a class in it, read from the source."""
    return _docstring(module, class_name).split("\n")[0]


def _docstring(module: str, class_name: str) -> str:
    spec = importlib.util.find_spec(module)
    if spec is None or spec.origin is None:
        return f"not importable: {module}"
    tree = ast.parse(Path(spec.origin).read_text(encoding="utf-8"))
    classes = (node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == class_name)
    node = next(classes, None) if class_name else tree
    return (ast.get_docstring(node) or "") if node else ""
