"""The commands of `neubtf-bench`, one module each; a method's own come by entry point, `neubtf_bench.commands`.

A command's module has a docstring, whose first line stands in lists, `arguments(parser)`, and `run(options)`, which
prints and returns an exit code of `bench.errors`. It imports what it needs when it runs, so that the others start fast.
"""

import argparse
import importlib
import pkgutil
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import partial
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from bench import atomic
from bench.codecs.registry import first_line
from bench.errors import InputError, writable
from bench.settings import Threads, converted

if TYPE_CHECKING:
    from bench.runs.executors import Workers

GROUP = "neubtf_bench.commands"
GROUPS = {  # how the list of commands is divided; those of other packages follow
    "measure": ("run", "score", "trade", "choose", "demand"),
    "codecs": ("list", "encode", "decode", "pretrain", "sampling", "export", "new"),
    "data": ("info", "bake", "convert", "cache"),
    "look": ("view", "render", "table", "report", "history"),
    "judge": ("check", "stress", "compare", "reference"),
    "share": ("submit", "verify", "results"),
}


def modules() -> dict[str, str]:
    """The module of each command by its name; imports none. Two packages that claim one name are an error."""
    names = (info.name for info in pkgutil.iter_modules(__path__) if not info.name.startswith("_"))  # no helpers
    by_name = {name.replace("_", "-"): f"{__name__}.{name}" for name in names}
    for entry in entry_points(group=GROUP):
        other = by_name.setdefault(entry.name, entry.value)
        if other != entry.value:
            raise InputError(f"two commands are named {entry.name!r}: {other} and {entry.value}: uninstall one")
    return dict(sorted(by_name.items()))


def grouped(known: dict[str, str]) -> str:
    """The commands of `modules` in groups, a line each with what it does."""
    others = [name for name in known if not any(name in names for names in GROUPS.values())]
    lines = []
    for group, names in (GROUPS | ({"of methods": tuple(others)} if others else {})).items():
        lines += [f"{group}:", *(f"  {name:<12}{first_line(known[name])}" for name in names if name in known)]
    return "\n".join(lines)


def load(module: str) -> ModuleType:
    """The module of a command, imported."""
    return importlib.import_module(module)


def assignments(words: list[str], option: str = "--set", form: str = "KEY=VALUE") -> dict[str, str]:
    """The words of an option, `KEY=VALUE`, as a dictionary."""
    for word in words:
        if "=" not in word:
            raise InputError(f"{option} {word}: write {form}")
    return dict(word.split("=", 1) for word in words)


def threads(word: str) -> int:
    """The type of an option that counts CPU threads."""
    try:
        count: int = converted("the count", Threads, word, words=True)
    except InputError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    return count


def write_text(path: Path, text: str, remedy: str = "choose another place") -> None:
    """Write a file whole or not at all, and say so."""
    with writable(path, remedy):
        atomic.write(path, text.encode())
    print(f"wrote {path}")


def usable_device(name: str) -> str:
    """The name of a device of PyTorch that is there."""
    import torch

    try:
        device = torch.device(name)
    except RuntimeError:
        raise InputError(f"--device {name}: no such device; cpu or cuda") from None
    if device.type == "cuda" and not torch.cuda.is_available():
        raise InputError(f"--device {name}: PyTorch finds no CUDA device here; use cpu")
    return name


def workers(
    jobs: int, threads: int, device: str, limit: float | None = None
) -> "Callable[[], AbstractContextManager[Workers]] | None":
    """Where so many jobs run at once, 0: one a core; None where the runner decides."""
    from bench.runs import executors
    from bench.threads import cores

    count = jobs or max(1, cores() // threads)
    if count == 1 and limit is None:
        return None
    return partial(executors.processes, count, threads, device, limit)
