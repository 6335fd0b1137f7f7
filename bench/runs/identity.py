"""Identifies the code that fits a codec, because the file depends on it, as on settings and data.

From the modules of the codec's class it follows imports in the source through the codec's own package, `bench`, and
every other package that is not an installed distribution, of which it takes the version. It hashes the syntax of each
module reached, without comments, docstrings and layout, and every module of a package that imports by a computed name.
"""

import ast
import hashlib
import importlib.util
import sys
import uuid
from collections.abc import Iterable, Iterator
from functools import cache
from importlib.machinery import EXTENSION_SUFFIXES
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from pathlib import Path
from typing import NamedTuple

from bench.codec import Codec
from bench.records import FitKey

# Modules that every fit uses, and those that only fits to a scene use.
ALWAYS = ("bench.codecs.container",)
OF_SCENES = ("bench.demand.fitting",)
INSTALLED = {"site-packages", "dist-packages"}  # folders of installed distributions
# Functions that import or run code whose name may be computed.
BY_NAME = {"import_module", "__import__", "spec_from_file_location", "run_path", "exec", "eval"}


_distributions = cache(packages_distributions)


def identity(codec: Codec, *more: str) -> FitKey:
    """`code`, a hash of the source that a fit of this codec runs and of `more` modules, and `libraries`, the versions
    of what it imports."""
    classes = list(type(codec).__mro__)  # the codec's class and all that it inherits from
    if codec.network is not None:  # the class that trains the network which the codec shares over materials
        classes += codec.network.__mro__
    roots = {each.__module__ for each in classes if each is not object}
    roots |= {*ALWAYS, *more}
    if codec.scene:
        roots.update(OF_SCENES)
    return _identity(frozenset(roots))


@cache
def _identity(roots: frozenset[str]) -> FitKey:
    """`code` and `libraries` as in `identity`, for the modules `roots`."""
    own_packages = {root.partition(".")[0] for root in roots} | {"bench"}
    sources, libraries = _reached(roots, own_packages)
    # Sorted, so that the hash does not depend on the order in which modules are reached.
    lines = "\n".join(f"{name} {digest}" for name, digest in sorted(sources.items()))
    versions: dict[str, str | None] = {}
    for name in sorted(libraries):
        number = _version(name)
        if number:  # a name that no distribution provides, such as an optional import that is missing, has none
            versions[name] = number
    return {"code": hashlib.sha256(lines.encode()).hexdigest(), "libraries": versions}


def _reached(roots: Iterable[str], own_packages: set[str]) -> tuple[dict[str, str], set[str]]:
    """A digest by name of each module that the roots import, directly or through others, and the libraries they import.

    A library is an installed distribution, by the name of its package: it counts by its version, so its modules are not
    read. `own_packages` are the top-level packages whose modules are read even if they are installed.
    """
    sources: dict[str, str] = {}
    libraries: set[str] = set()
    waiting = sorted(roots)
    while waiting:
        name = waiting.pop()
        top = name.partition(".")[0]
        if name in sources or top in sys.stdlib_module_names:  # it is read already, or belongs to Python
            continue
        if top not in own_packages and _is_library(top):
            libraries.add(top)
            continue
        path = _file(name)
        if path is None:  # `from module import name` may name a function: it has no file of its own
            continue
        source = _source(path, name)
        sources[name] = source.digest
        waiting += source.imported
        if "." in name:
            waiting.append(name.rpartition(".")[0])  # a package runs before its modules
        # It may import any module of its package. In `bench` these are codecs, which are roots, and names for scripts.
        if source.imports_by_name and top != "bench":
            waiting += _everything_in(top)
    for root in roots:
        if root not in sources:
            # Code typed into a shell has no source. A new digest in each process: its files are never reused.
            sources[root] = str(uuid.uuid4())
    return sources, libraries


def _is_library(top: str) -> bool:
    """Whether a top-level package is an installed distribution, or has no file, as a module compiled into Python."""
    file = _top_file(top)
    return file is None or bool(INSTALLED & set(file.parts))


class _Source(NamedTuple):
    """What counts of a module's source for the identity of a codec."""

    digest: str  # of its syntax
    imported: tuple[str, ...] = ()  # the modules that it may import
    imports_by_name: bool = False  # whether it imports modules by computed names


@cache
def _source(path: Path, module: str) -> _Source:
    """What counts of the file of the module of that name, which is read but not run."""
    content = path.read_bytes()
    try:
        tree = ast.parse(content)
    except (SyntaxError, ValueError):  # compiled, such as a .so: its imports are not known
        return _Source(hashlib.sha256(content).hexdigest())
    nodes = list(ast.walk(tree))  # walked only once, because that is what takes the time
    by_name = any(isinstance(node, ast.Call) and _called(node) in BY_NAME for node in nodes)
    imported = tuple(_imported(nodes, module, path))
    for node in nodes:
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            if ast.get_docstring(node, clean=False) is not None:
                node.body = node.body[1:]  # without the docstring
    return _Source(hashlib.sha256(ast.dump(tree).encode()).hexdigest(), imported, by_name)


def _called(call: ast.Call) -> str:
    """The name of the called function or method; "" if it has none, as in `f()()`."""
    if isinstance(call.func, ast.Attribute):
        return call.func.attr
    if isinstance(call.func, ast.Name):
        return call.func.id
    return ""


@cache
def _file(module: str) -> Path | None:
    """The file of a module, found without importing it; None if there is none.

    A top-level module is found as Python finds it, and modules inside it by their place in its folder.
    """
    file_of_imported = getattr(sys.modules.get(module), "__file__", None)
    if file_of_imported:
        return Path(file_of_imported)
    top, *parts = module.split(".")
    top_file = _top_file(top)
    if top_file is None:
        return None
    if not parts:
        candidates = [top_file]
    else:
        inside = top_file.parent.joinpath(*parts)
        endings = (".py", "/__init__.py", *EXTENSION_SUFFIXES)
        candidates = [Path(f"{inside}{ending}") for ending in endings]
    for path in candidates:
        if path.is_file():
            return path
    return None


def _top_file(top: str) -> Path | None:
    """The file of a top-level module or package; None if there is none.

    For a package without `__init__.py` it is the place where that file would be.
    """
    try:
        spec = importlib.util.find_spec(top)
    except (ImportError, ValueError):
        return None
    if spec is None:
        return None
    if spec.origin and spec.has_location:
        return Path(spec.origin)
    if spec.submodule_search_locations:  # a package without __init__.py
        folder, *_ = spec.submodule_search_locations
        return Path(folder) / "__init__.py"
    return None


def _imported(nodes: list[ast.AST], module: str, path: Path) -> Iterator[str]:
    """The modules that a module may import anywhere in its source, except those that only a type checker sees."""
    if path.name == "__init__.py":  # the module is a package itself
        package = module
    else:
        package, _, _ = module.rpartition(".")
    guards = [node for node in nodes if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)]
    only_for_types: set[int] = set()  # the identities of the nodes within a guard
    for guard in guards:
        # The `else` of a guard does run. Such a guard counts whole: a module too many does no harm, one too few would.
        if not guard.orelse:
            only_for_types.update(id(inner) for inner in ast.walk(guard))
    for node in nodes:
        if id(node) in only_for_types:
            continue
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name
        elif isinstance(node, ast.ImportFrom):
            parts: list[str] = []
            if node.level:  # one dot is the package itself
                names = package.split(".")
                parts += names[: len(names) - node.level + 1]
            if node.module:
                parts.append(node.module)
            base = ".".join(parts)
            yield base
            for alias in node.names:  # a module of that name in the package or, often, a function, which has no file
                yield f"{base}.{alias.name}"


def _everything_in(top: str) -> Iterator[str]:
    """The name of every module of a package; nothing for a module that is one file, or not found."""
    top_file = _top_file(top)
    if top_file is None or top_file.name != "__init__.py":
        return
    for path in top_file.parent.rglob("*.py"):
        names = [top, *path.relative_to(top_file.parent).with_suffix("").parts]
        if names[-1] == "__init__":  # the package itself
            names.pop()
        yield ".".join(names)


@cache
def _version(top: str) -> str | None:
    """The version of the distribution that a top-level package belongs to; None if it is not installed."""
    # Several distributions may hold parts of one package: the first by name stands for all.
    for distribution in sorted(set(_distributions().get(top, ()))):
        try:
            return version(distribution)
        except PackageNotFoundError:
            continue
    return None
