"""Identifies the code that fits a codec, because the file depends on it, as on settings and data.

From the modules of the codec's class it follows imports in the source. It hashes the bytes of each module of the suite,
of the codec's own package, and of others that are not installed; of an installed distribution it takes the version.
"""

import ast
import hashlib
import sys
import uuid
from collections.abc import Collection, Iterator
from functools import cache
from importlib.metadata import packages_distributions, version
from importlib.util import resolve_name
from pathlib import Path

from bench.codec import Codec
from bench.inputs.plugins import source_of
from bench.records import FitKey

# Modules that every fit uses, and those that only fits to a scene use.
ALWAYS = ("bench.codecs.container",)
OF_SCENES = ("bench.demand.fitting",)
SUITE = {"bench", "baselines", "neubtf"}
INSTALLED = {"site-packages", "dist-packages"}  # folders of installed distributions

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
    return _identity_of_modules(frozenset(roots))


@cache
def _identity_of_modules(roots: frozenset[str]) -> FitKey:
    """`code` and `libraries` as in `identity`, for the modules `roots`."""
    digests, libraries = _digests_and_libraries(roots)
    # Sorted, so that the hash does not depend on the order in which modules are reached.
    lines = "\n".join(f"{name} {digest}" for name, digest in sorted(digests.items()))
    versions: dict[str, str | None] = {}
    for name in sorted(libraries):
        distributions = _distributions().get(name)
        if distributions:  # several may hold parts of one package: the first by name stands for all
            versions[name] = version(min(distributions))
    return {"code": hashlib.sha256(lines.encode()).hexdigest(), "libraries": versions}


def _digests_and_libraries(roots: Collection[str]) -> tuple[dict[str, str], set[str]]:
    """A digest by name of each module that the roots import, directly or through others, and the top-level packages of
    the libraries that they import."""
    always_read = SUITE | {_top(root) for root in roots}  # even if they are installed
    digests: dict[str, str] = {}
    libraries: set[str] = set()
    waiting = list(roots)
    while waiting:
        name = waiting.pop()
        top = _top(name)
        if name in digests or top in sys.stdlib_module_names:
            continue
        path = source_of(name)
        if top not in always_read and (path is None or INSTALLED & set(path.parts)):
            libraries.add(top)
        elif path is not None:  # `from module import name` may name a function, which has no file
            digests[name], imported = _digest_and_imports(path, name)
            waiting += imported
            if "." in name:
                waiting.append(name.rpartition(".")[0])  # a package runs before its modules
    for root in roots:
        if _top(root) not in sys.stdlib_module_names:  # a codec may inherit from a class of the standard library
            # Code typed into a shell has no source. A new digest in each process: its files are never reused.
            digests.setdefault(root, str(uuid.uuid4()))
    return digests, libraries


def _top(module: str) -> str:
    """The top-level package of a module."""
    return module.partition(".")[0]


@cache
def _digest_and_imports(path: Path, module: str) -> tuple[str, tuple[str, ...]]:
    """The digest of the file of the module of that name, which is read but not run, and what the module may import."""
    content = path.read_bytes()
    try:
        imported = tuple(_imports(ast.parse(content), module, path))
    except (SyntaxError, ValueError):  # compiled, such as a .so: its imports are not known
        imported = ()
    return hashlib.sha256(content).hexdigest(), imported


def _imports(tree: ast.Module, module: str, path: Path) -> Iterator[str]:
    """The modules that a module may import anywhere in its source, except those that only a type checker sees."""
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    waiting: list[ast.AST] = [tree]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.If) and ast.unparse(node.test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING"):
            waiting += node.orelse
            continue
        waiting += ast.iter_child_nodes(node)
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name
        elif isinstance(node, ast.ImportFrom):
            try:
                base = resolve_name("." * node.level + (node.module or ""), package)
            except ImportError:  # it leads out of the top-level package
                continue
            yield base
            for alias in node.names:  # a module of that name in the package or, often, a function
                yield f"{base}.{alias.name}"
