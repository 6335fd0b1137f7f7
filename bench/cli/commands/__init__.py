"""The commands of `neubtf-bench`, one module each; other packages add theirs by entry point, `neubtf_bench.commands`.

A command's module has a docstring, whose first line stands in the list of commands; `arguments(parser)`; and
`run(options)`, which prints and returns an exit code of `bench.inputs.errors`. That of another package is called as
`run(options, terminal)`, with a `bench.codec.Terminal`. Only the wanted command is imported, so that all start fast.
"""

import argparse
import json
import pkgutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.codecs.registry import first_line
from bench.files import atomic
from bench.inputs import plugins
from bench.inputs.errors import InputError, visible, writable
from bench.inputs.settings import Seed, Threads, converted
from bench.machine.devices import require_present

if TYPE_CHECKING:
    from bench.runs.executors import Seats

GROUP = "neubtf_bench.commands"
GROUPS = {  # the groups of the list of commands; commands of other packages follow
    "compare codecs": ("run", "table", "report", "figure", "history", "compare"),
    "find the best setting": ("choose", "trade", "time"),
    "make and see a codec file": ("encode", "score", "view", "render", "decode", "export", "info", "pretrain"),
    "bring materials": ("bake", "convert"),
    "add a codec, share results": ("list", "new", "check", "stress", "results"),
}

RENAMED = {  # commands of earlier versions, and what does their work now
    "cache": "info --cache",
    "demand": "encode --scene SCENE",
    "reference": "compare RUN --update",
    "sampling": "export FILE --lobes",
    "submit": "results pack",
    "verify": "results verify",
}


def modules() -> dict[str, str]:
    """The module of each command by name; imports none. `InputError` if two packages use the same name."""
    by_name = {}
    for info in pkgutil.iter_modules(__path__):
        if not info.name.startswith("_"):  # no helpers
            by_name[info.name.replace("_", "-")] = f"{__name__}.{info.name}"
    for entry in plugins.points(GROUP):
        other = by_name.setdefault(entry.name, entry.value)
        if other != entry.value:
            raise InputError(f"two commands are named {entry.name!r}: {other} and {entry.value}: uninstall one")
    return dict(sorted(by_name.items()))


def in_groups(known: dict[str, str]) -> str:
    """The commands of `modules` in groups, each with a line that says what it does."""
    ours: set[str] = set().union(*GROUPS.values())
    groups = dict(GROUPS)
    others = tuple(name for name in known if name not in ours)
    if others:
        groups["commands of methods"] = others
    lines = []
    for group, names in groups.items():
        lines.append(f"{group}:")
        lines += [f"  {name:<11} {first_line(known[name])}" for name in names]
    return "\n".join(lines)


def assignments(words: list[str], option: str = "--set", form: str = "KEY=VALUE") -> dict[str, str]:
    """The words `KEY=VALUE` that an option was given, as a dictionary; `form` is how errors write the words.

    The value may be empty. `InputError` for a word without a key or without `=`, and for a key that is given twice.
    """
    value_of_key: dict[str, str] = {}
    for word in words:
        key, is_assigned, value = word.partition("=")
        if not (key and is_assigned):
            raise InputError(f"{option} {word}: write {form}")
        if key in value_of_key:
            raise InputError(f"{option} {word}: {key} is given twice: give it once")
        value_of_key[key] = value
    return value_of_key


def several(parser: argparse.ArgumentParser, option: str, words: str, form: str | None = None) -> None:
    """Add an option that may be given again and again; `words` are its help, `form` stands for its value there."""
    parser.add_argument(option, action="append", default=[], metavar=form, help=words)


def reading_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that say how measured data are read; `read_as` gives their settings."""
    parser.add_argument("--repair", action="store_true", help="mask measured values that are NaN or infinite")
    unit = parser.add_mutually_exclusive_group()
    unit.add_argument("--radians", action="store_true", help="angles that should be degrees are radians: convert them")
    unit.add_argument("--degrees", action="store_true", help="angles are degrees, however small they are")


def read_as(options: argparse.Namespace) -> dict[str, str]:
    """The settings `data.KEY` that the options of `reading_options` ask for."""
    changes = {"data.repair": "true"} if options.repair else {}
    for unit in ("radians", "degrees"):
        if getattr(options, unit):
            changes["data.angles"] = unit
    return changes


def suite_options(parser: argparse.ArgumentParser, default: str, folder: str = "runs/SUITE") -> None:
    """Add the options that choose a suite, parts of it, changes of its settings, and the folder of its run.

    `default` is the suite that is taken if none is given; `folder` is what the help says of the run's folder, which the
    command chooses.
    """
    add = parser.add_argument
    add("suite", nargs="?", default=default, help=f"a built-in suite or a TOML file (default: {default})")
    add("--out", type=Path, help=f"the run's folder (default: {folder})")
    several(parser, "--material", "only this material, by name or path; repeatable")
    several(parser, "--codec", "only this codec; repeatable")
    several(parser, "--set", "a codec setting, or data.KEY", "KEY=VALUE")
    add("--device", default="cpu", help="cpu or cuda (default: cpu)")


def _number(what: str, kind: Any) -> Callable[[str], int]:
    """The `type` of an option for argparse: it converts a word as a setting of that kind; `what` names it in errors."""

    def converted_word(word: str) -> int:
        """The number that a word of the command line stands for."""
        try:
            number: int = converted(what, kind, word, words=True)
        except InputError as error:
            raise argparse.ArgumentTypeError(str(error)) from None
        return number

    return converted_word


threads = _number("the count", Threads)  # the type of an option that counts CPU threads
seed_option = _number("the seed", Seed)  # the type of an option that is a seed, as in the seeds of a suite


def say_line(text: str) -> None:
    """Print one line. A name in it, of a file or a record, neither ends it nor steers a terminal."""
    print(visible(text))


def write_text(path: Path, text: str, remedy: str = "choose another place") -> None:
    """Write a file completely or not at all, and print its name."""
    with writable(path, remedy):
        atomic.write(path, text.encode())
    say_line(f"wrote {path}")


def json_option(parser: argparse.ArgumentParser) -> None:
    """Add the option that `json_writer` takes."""
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all of it as JSON")


def json_writer(path: Path | None) -> Callable[[Any], None]:
    """A function that writes values to this file as JSON, or does nothing without one.

    `InputError`, before there are any values, if a file of another kind has this name.
    """
    if path is None:
        return lambda values: None
    atomic.refuse_other_kind(path, ".json", atomic.begins(b"{"))

    def plain(value: Any) -> Any:
        """NumPy's numbers and arrays as Python's; anything else that JSON has no form for, such as a path, as text."""
        return value.tolist() if hasattr(value, "tolist") else str(value)

    def write(values: Any) -> None:
        """Write values; NaN and infinity, which JSON lacks, become null."""
        finite = json.loads(json.dumps(values, default=plain), parse_constant=lambda name: None)
        write_text(path, json.dumps(finite, indent=2), "choose another --json")

    return write


def usable_device(name: str) -> str:
    """The name of a device that PyTorch finds here; `InputError` for any other."""
    require_present(name, "--device")
    return name


def jobs_option(parser: argparse.ArgumentParser, what: str) -> None:
    """Add the option that `workers` takes as `jobs`; `what` are the jobs, in words."""
    words = f"how many {what} at once, each in its own process (and on one of the GPUs); "
    words += "0: as many as the cores allow (default: 1)"
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help=words)


def workers(jobs: int, threads: int, device: str, limit: float | None = None) -> "Seats | None":
    """The workers that run `jobs` jobs at once, each with `threads` threads; None if the runner decides.

    0 jobs means as many as the cores allow. A job that takes longer than `limit` seconds fails.
    """
    from bench.machine.threads import cores
    from bench.runs import executors

    count = jobs or max(1, cores() // threads)
    if count == 1 and limit is None:  # only another process can be ended after a limit
        return None
    return partial(executors.processes, count, threads, device, limit)
