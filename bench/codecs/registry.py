"""Finds codecs by entry point, `neubtf_bench.codecs`: name → "module:Class". Listing them imports none of them.

Importing a codec imports PyTorch, which takes seconds. So docstrings and versions are read from the source.
"""

import ast
import re
import tomllib
from collections.abc import Mapping
from functools import cache
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.inputs import plugins
from bench.inputs.errors import CodecError, InputError, did_you_mean
from bench.inputs.plugins import source_of

if TYPE_CHECKING:
    from bench.codec import Codec

GROUP = "neubtf_bench.codecs"
STORE = "bench.training.stored_texture"  # its `VERSION` is part of the version of every codec
COMMAND = "command"  # the codec of other programs; lists omit it, because it is useless without them
UNLABELLED = ("called", "encode", "decode")  # its settings that no label shows as KEY=VALUE: names and command lines
_OF_COMMANDS = EntryPoint(COMMAND, "bench.codecs.command:Programs", GROUP)


def codec_entries() -> dict[str, EntryPoint]:
    """Every installed codec's entry point by name. `InputError` if two packages use the same name."""
    return plugins.entries(GROUP, "codec")


def load_codec(name: str, wanted_by: str = "") -> "type[Codec]":
    """Import the class of a codec. `InputError`, beginning with `wanted_by`, if no codec has the name, or if its class
    has another name or no version; `CodecError` if it cannot be imported."""
    return _imported_class(entry_of(name, wanted_by), wanted_by)


def make_codec(name: str, settings: dict[str, Any]) -> "Codec":
    """Make a codec with some settings. `InputError` if they are invalid or no codec has the name, `CodecError` if the
    codec fails."""
    entry = entry_of(name)
    words = f"{codec_in_words(entry)} fails with the settings {settings}"
    with plugins.naming(words, kind=CodecError, passed=(InputError,)):
        return _imported_class(entry)(**settings)


def entry_of(name: str, wanted_by: str = "") -> EntryPoint:
    """The entry point of a codec, or of `COMMAND`. `InputError`, beginning with `wanted_by`, if there is none."""
    entries = codec_entries()
    if name == COMMAND:
        return _OF_COMMANDS
    if name not in entries:
        here = [folder for folder in (name, f"{name}-codec") if _has_codec(folder, name)]
        remedy = f": pip install ./{here[0]}" if here else did_you_mean(name, entries)
        raise InputError(f"{_prefix(wanted_by)}no codec named {name!r} is installed{remedy}")
    return entries[name]


def _prefix(wanted_by: str) -> str:
    """The beginning of a message, which says what wants a codec, such as the path of a file; "" if nothing does."""
    return f"{wanted_by}: " if wanted_by else ""


def _has_codec(folder: str, name: str) -> bool:
    """Whether a folder of the working directory is a package with a codec of that name."""
    try:
        project = tomllib.loads(Path(folder, "pyproject.toml").read_text("utf-8"))["project"]
        return name in project["entry-points"][GROUP]
    except (OSError, ValueError, KeyError, TypeError):
        return False


def _imported_class(entry: EntryPoint, wanted_by: str = "") -> "type[Codec]":
    """Import the class of an entry point in this process; its errors are those of `load_codec`."""
    prefix = _prefix(wanted_by)
    place = f"({entry.value}, which its [project.entry-points] name)"
    with plugins.naming(f"{prefix}{codec_in_words(entry)} {place} cannot be imported", kind=CodecError):
        codec: type[Codec] = entry.load()
    name = getattr(codec, "name", None)
    if name != entry.name:
        fault = "has no name" if name is None else f"calls itself {name!r}"
        raise InputError(f"{prefix}{codec_in_words(entry)} {fault}: write `name = {entry.name!r}` into its class")
    if not isinstance(getattr(codec, "version", None), int):
        raise InputError(f"{prefix}{codec_in_words(entry)} has no version: add `version = 1` to its class")
    return codec


def from_outside(name: str) -> bool:
    """Whether a codec comes from a distribution other than this suite."""
    entry = codec_entries().get(name)
    return entry is not None and plugins.is_outside(entry)


def codec_in_words(entry: EntryPoint) -> str:
    """The name of a codec in errors, with its distribution."""
    return plugins.called(entry, "codec")


def describe(entry: EntryPoint) -> str:
    """The first line of a codec's docstring, read from its source, so that listing imports no PyTorch."""
    return first_line(*_module_and_class(entry))


def _module_and_class(entry: EntryPoint) -> tuple[str, str]:
    """The names of a codec's module and of its class; "" where the entry point of another package names no class."""
    module, _, class_name = entry.value.partition(":")
    return module, class_name


def listed(entry: EntryPoint) -> str:
    """`describe`, or why the codec cannot be used: one of another distribution is imported to tell."""
    try:
        if plugins.is_outside(entry):
            _imported_class(entry)
        return describe(entry)
    except Exception as error:  # any exception of a foreign codec is its failure
        return f"FAILS: {' '.join(str(error).split())}"


def reference(entry: EntryPoint) -> dict[str, str]:
    """What a codec's docstring says of its origin: `bibtex`, one entry, the link of its `paper`, and of its `code`.

    The paper's link is the entry's doi or url; the code's follows "Code: ". Each is "" where there is none. If the
    docstring says "Cited as `NAME`.", all three are those that the codec of that name states itself.
    """

    def first_match(pattern: str, string: str) -> str:
        """The group of the pattern's first match, or the whole match if it has none; "" without a match."""
        match = re.search(pattern, string, re.M | re.S)
        if match is None:
            return ""
        return match[1] if match.re.groups else match[0]

    text = _docstring(*_module_and_class(entry))
    cited_as = first_match(r"^Cited as `([\w-]+)`\.$", text)
    another = codec_entries().get(cited_as)
    if another is not None:
        text = _docstring(*_module_and_class(another))
    bibtex = first_match(r"^@\w+\{.*?^\}$", text)
    paper = first_match(r"\burl = \{(https://[^{}\s]+)\}", bibtex)
    doi = first_match(r"\bdoi = \{([^{}\s]+)\}", bibtex)
    if doi:
        paper = f"https://doi.org/{doi}"
    return {"bibtex": bibtex, "paper": paper, "code": first_match(r"^Code: (https://\S+)$", text)}


def first_line(module: str, class_name: str = "") -> str:
    """The first line of the docstring of a module, or of a class in it, read from the source."""
    return _docstring(module, class_name).split("\n")[0]


def current_versions(codec: str, recipe: str = "", entries: Mapping[str, EntryPoint] | None = None) -> dict[str, int]:
    """The installed `version` of a codec, and that of the `store` of textures, as a fit key names them.

    If the recipe has a version of its own, `version` is that. Both are read from the source. Empty if no such codec is
    installed, or if its source does not state its version as a number. `entries` are the `codec_entries`, for a caller
    that has them.
    """
    if entries is None:
        entries = codec_entries()
    entry = entries.get(codec)
    if entry is None:
        return {}
    module, class_name = _module_and_class(entry)
    version = _assigned(module, class_name, "version")
    recipe_versions = _assigned(module, class_name, "recipe_versions")  # by recipe; None if none has its own
    if recipe_versions is not None:
        version = recipe_versions.get(recipe, version)
    if not isinstance(version, int):
        return {}
    return {"version": version, "store": _assigned(STORE, "", "VERSION") or 0}


def _assigned(module: str, class_name: str, wanted: str) -> Any:
    """The literal that a module or a class assigns to a name; None if it assigns none to it.

    The name may stand alone or among others, as in `name, version = "pca", 4`. An expression is no literal: its value
    is not known without importing the module.
    """
    node = _definition(module, class_name)
    for statement in node.body if node is not None else ():
        if isinstance(statement, ast.Assign):
            target = statement.targets[0]
        elif isinstance(statement, ast.AnnAssign):
            target = statement.target
        else:
            continue
        names = [each.id for each in ast.walk(target) if isinstance(each, ast.Name)]
        if wanted not in names or statement.value is None:
            continue
        try:
            value = ast.literal_eval(statement.value)
        except ValueError:  # an expression
            continue
        if isinstance(target, ast.Tuple):  # as in `name, version = "pca", 4`: names and values have the same places
            return value[names.index(wanted)]
        return value
    return None


def _docstring(module: str, class_name: str = "") -> str:
    """The docstring of a module, or of a class in it, from the source; "" if it has none, or no such class.

    If the module itself is not found, a line that says so, because lists show this text.
    """
    node = _definition(module, class_name)
    if node is not None:
        return ast.get_docstring(node) or ""
    return f"not importable: {module}" if _definition(module, "") is None else ""


@cache
def _definition(module: str, class_name: str) -> "ast.Module | ast.ClassDef | None":
    """The syntax of a module, or of a class in it; None if there is none, or if it is no Python."""
    source = source_of(module)
    if source is None or source.suffix != ".py":
        return None
    try:
        tree = ast.parse(source.read_bytes())
    except (SyntaxError, ValueError):  # of another package: importing it says what is wrong
        return None
    if not class_name:
        return tree
    for node in tree.body:
        if isinstance(node, ast.ClassDef) and node.name == class_name:
            return node
    return None
