"""The command line, `neubtf-bench`: finds the command, runs it, and turns exceptions into exit codes."""

import argparse
import gc
import importlib
import io
import logging
import os
import signal
import sys
import textwrap
import traceback
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import bench
from bench.cli import commands
from bench.inputs.errors import (
    FAILED,
    INTERNAL,
    INTERRUPTED,
    UNREAD,
    USAGE,
    EncodeError,
    InputError,
    did_you_mean,
    unwritable,
    visible,
)
from bench.machine.threads import handling

WIDTH = 100  # maximal width of a help text, in columns
EXAMPLES = "\n\nexamples:\n"  # text after this line of a command's docstring is not wrapped
DEBUG = "--debug"  # an option of every command
EVERYDAY = """  neubtf-bench run quick                                 eleven codecs on two materials, in minutes
  neubtf-bench run quick --material PATH --codec pca     one codec on a measured BTF
  neubtf-bench COMMAND --help                            options of a command, with examples
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code; see `bench.inputs.errors`.

    Without `argv` it is the program itself, and takes the words of the command line. A character that the terminal's
    encoding lacks is printed as `?`.
    """
    if isinstance(sys.stdout, io.TextIOWrapper):  # stderr replaces such characters by itself
        sys.stdout.reconfigure(errors="replace")
    words = list(sys.argv[1:] if argv is None else argv)
    warnings_to = logging.StreamHandler()
    warnings_to.setFormatter(_Visible())
    logging.basicConfig(handlers=[warnings_to])
    code = _run(words)
    if argv is not None:
        return code
    if "torch" not in sys.modules:  # libraries that come with PyTorch check, at the end, whether all is freed
        gc.freeze()  # else Python looks for garbage among all objects as it ends: a seventh of a table's time
    return code


class _Visible(logging.Formatter):
    """Warnings on one line, without control characters: names in data files must neither steer a terminal nor CI."""

    def format(self, record: logging.LogRecord) -> str:
        return visible(record.getMessage())


def _run(words: list[str]) -> int:
    """Run one command, and turn exceptions into exit codes and lines for people."""
    if "OMP_WAIT_POLICY" not in os.environ:
        # Idle threads of PyTorch spin for 8 ms before they sleep. Let it be 0.2 ms: Dr.Jit's threads need the cores.
        os.environ.setdefault("GOMP_SPINCOUNT", "5000")
    try:
        # Schedulers send SIGTERM: keep finished work, as after Ctrl-C.
        with handling(signal.SIGTERM, signal.default_int_handler):
            if not words:
                parser(words).print_help()
                return USAGE
            options = parser(words[:1]).parse_args(words)
            _refuse_overwriting(options)
            code: int = options.command(options)
            sys.stdout.flush()  # here, where an error has an exit code
            return code
    except InputError as error:
        if DEBUG in words:
            traceback.print_exc()
        print(f"neubtf-bench: {visible(str(error))}", file=sys.stderr)
        return FAILED if isinstance(error, EncodeError) else USAGE
    except KeyboardInterrupt:
        print("\nneubtf-bench: interrupted; finished work is kept", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # nobody reads the output any more, as after `| head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # else Python fails on the rest at its end
        return UNREAD
    except Exception as error:
        why = unwritable(error) if isinstance(error, OSError) else ""
        if why:
            print(f"neubtf-bench: {visible(why)}", file=sys.stderr)
            return USAGE
        traceback.print_exc()
        print("neubtf-bench: internal error: please report the lines above", file=sys.stderr)
        return INTERNAL


# The options that name a file to write.
_WRITTEN = ("out", "json", "markdown", "junit", "picture", "copy")
# Those that name a BTF or maps, which may be a folder of pictures.
_PICTURES = ("btf", "folder", "material", "path", "truth")


def _refuse_overwriting(options: argparse.Namespace) -> None:
    """Raise an `InputError` if a file to write is one of the files to read: a measurement would be lost."""
    inputs: list[str | os.PathLike[str]] = []  # all words that may be files to read
    folders: list[str | os.PathLike[str]] = []  # those that may be folders of pictures to read
    for name, value in vars(options).items():
        if name not in _WRITTEN:
            words = value if isinstance(value, list) else [value]
            paths = [word for word in words if isinstance(word, str | os.PathLike)]
            inputs += paths
            folders += paths if name in _PICTURES else []
    outputs: dict[str, str] = {}  # by real path: the option that names the file
    for written in _WRITTEN:
        out = getattr(options, written, None)
        if out is None:
            continue
        other = outputs.setdefault(os.path.realpath(out), written)
        if other != written:
            raise InputError(f"--{other}, --{written}: both name {out}: give one of them another name")
        if not os.path.isfile(out):
            continue
        if any(_same_file(word, out) for word in inputs) or any(_is_read_in(word, out) for word in folders):
            remedy = f"give --{written} another name"
            raise InputError(f"{out}: this file is read, so it cannot be written, too: {remedy}")


def _same_file(given: str | os.PathLike[str], out: str | os.PathLike[str]) -> bool:
    """Whether both are paths of one file that exists."""
    return os.path.exists(given) and os.path.samefile(given, out)


def _is_read_in(folder: str | os.PathLike[str], out: str | os.PathLike[str]) -> bool:
    """Whether a command that reads a folder would read the file `out` in it, as a picture of a BTF."""
    inside = os.path.realpath(folder)
    place = os.path.realpath(out)
    if not os.path.isdir(inside) or os.path.isfile(os.path.join(inside, "records.jsonl")):
        return False  # pictures in the folder of a run are drawn from its records
    return os.path.commonpath([inside, place]) == inside and place.lower().endswith((".png", ".exr"))


def _of_package(run: Callable[..., int], options: argparse.Namespace) -> int:
    """Run a command of another package: on a device that is there, with a terminal to speak to."""
    if hasattr(options, "device"):
        commands.usable_device(options.device)
    from bench.cli.console import Console

    return run(options, Console())


class _Once(argparse.Action):
    """Stores the value of an option, and refuses a second one: argparse would keep the last without a word."""

    is_given = False

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, value: Any, option: str | None = None
    ) -> None:
        if option and self.is_given:
            raise InputError(f"{option}: it is given twice: give it once")
        self.is_given = True
        setattr(namespace, self.dest, value)


class _Parser(argparse.ArgumentParser):
    """A parser, for one command line, of options that are repeatable, or given once."""

    def __init__(self, *words: Any, **options: Any):
        super().__init__(*words, **options)
        self.register("action", None, _Once)  # of an option that names no action
        self.register("action", "store", _Once)


def parser(wanted: Sequence[str]) -> argparse.ArgumentParser:
    """The parser of the wanted command; the others are only listed, not imported. `InputError` if there is none."""
    known = commands.modules()
    is_command = bool(wanted) and not wanted[0].startswith("-")
    if is_command and wanted[0] not in known:
        if wanted[0] in commands.RENAMED:
            raise InputError(f"`{wanted[0]}` is now `{commands.RENAMED[wanted[0]]}`")
        raise InputError(f"no command named {wanted[0]!r}{did_you_mean(wanted[0], known)}")
    about = "Compares neural codecs of bidirectional texture functions: real bytes, error, time per sample."
    if not is_command:  # the list of commands is shown where none is wanted
        about += f"\n\n{commands.in_groups(known)}"
    top = _Parser(
        prog="neubtf-bench",
        usage="neubtf-bench [--version] COMMAND ...",
        description=about,
        epilog=EVERYDAY,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        add_help=False,
    )
    # The list of commands fills a screen: no section of argparse repeats what the usage says.
    hidden = argparse.SUPPRESS
    top.add_argument("-h", "--help", action="help", help=hidden)
    top.add_argument("--version", action="version", version=f"neubtf-bench {bench.__version__}", help=hidden)
    listing = top.add_subparsers(prog="neubtf-bench", required=True, metavar="COMMAND", help=hidden)
    for name, module in known.items():
        if name in wanted:
            _add_command(listing, name, module)
        else:
            listing.add_parser(name)
    return top


def _add_command(listing: Any, name: str, module: str) -> None:
    """Import the module of a command, and add the parser of its options to `listing`, argparse's list of commands."""
    loaded = importlib.import_module(module)
    text, _, examples = (loaded.__doc__ or "").partition(EXAMPLES)
    wrapped = [textwrap.fill(paragraph, WIDTH) for paragraph in text.split("\n\n")]
    command = listing.add_parser(
        name,
        help=text.split("\n")[0],
        description="\n\n".join(wrapped),
        epilog=f"examples:\n{examples}" if examples else None,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    loaded.arguments(command)
    command.add_argument(DEBUG, action="store_true", help="show the traceback of an error, too")
    ours = module.startswith(f"{commands.__name__}.")
    command.set_defaults(command=loaded.run if ours else partial(_of_package, loaded.run))
