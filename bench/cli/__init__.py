"""The command line, `neubtf-bench`: finds the command, runs it, and turns exceptions into exit codes."""

import argparse
import importlib
import os
import signal
import sys
import textwrap
from collections.abc import Sequence

import bench
from bench.cli import commands
from bench.inputs.errors import FINE, INTERNAL, INTERRUPTED, USAGE, InputError, did_you_mean, unwritable, visible
from bench.machine.threads import handling

WIDTH = 100  # maximal width of a help text, in columns
EXAMPLES = "\n\nexamples:\n"  # text after this line of a command's docstring is not wrapped
EVERYDAY = """examples:
  neubtf-bench run quick                                 eleven codecs on two materials, in minutes
  neubtf-bench run quick --material PATH --codec pca     one codec on a measured BTF
  neubtf-bench encode satin --codec pca -o satin.nbtf    one file
  neubtf-bench score satin.nbtf satin                    its bytes and quality
  neubtf-bench list codecs pca                           the settings of a codec
  neubtf-bench COMMAND --help                            options of a command, with examples
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code; see `bench.inputs.errors`."""
    if "OMP_WAIT_POLICY" not in os.environ:
        # PyTorch's idle threads spin before they sleep, for 0.2 ms instead of 8: Dr.Jit's threads need the cores.
        os.environ.setdefault("GOMP_SPINCOUNT", "5000")
    words = list(sys.argv[1:] if argv is None else argv)
    try:
        # Schedulers send SIGTERM: keep finished work, as after Ctrl-C.
        with handling(signal.SIGTERM, signal.default_int_handler):
            if not words:
                parser(words).print_help()
                return USAGE
            options = parser(words[:1]).parse_args(words)
            code: int = options.command(options)
            return code
    except InputError as error:
        print(f"neubtf-bench: {visible(str(error))}", file=sys.stderr)
        return USAGE
    except KeyboardInterrupt:
        print("\nneubtf-bench: interrupted; finished work is kept", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        sys.stderr.close()
        return FINE
    except Exception as error:
        if isinstance(error, OSError) and (why := unwritable(error)):
            print(f"neubtf-bench: {why}", file=sys.stderr)
            return USAGE
        import traceback

        traceback.print_exc()
        print("neubtf-bench: internal error: please report the lines above", file=sys.stderr)
        return INTERNAL


def parser(wanted: Sequence[str]) -> argparse.ArgumentParser:
    """The parser of the wanted command; the others are only listed, not imported. `InputError` if there is none."""
    known = commands.modules()
    about = "Compares neural codecs of bidirectional texture functions: real bytes, error, time per sample."
    top = argparse.ArgumentParser(
        prog="neubtf-bench",
        description=about if wanted and wanted[0] in known else f"{about}\n\n{commands.grouped(known)}",
        epilog=EVERYDAY,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    top.add_argument("--version", action="version", version=f"neubtf-bench {bench.__version__}")
    if wanted and not wanted[0].startswith("-") and wanted[0] not in known:
        raise InputError(f"no command named {wanted[0]!r}{did_you_mean(wanted[0], known)}")
    listing = top.add_subparsers(required=True, metavar="COMMAND", help="one of these")
    for name, module in known.items():
        if name not in wanted:
            listing.add_parser(name)
            continue
        loaded = importlib.import_module(module)
        text, _, examples = (loaded.__doc__ or "").partition(EXAMPLES)
        command = listing.add_parser(
            name,
            help=text.split("\n")[0],
            description="\n\n".join(textwrap.fill(paragraph, WIDTH) for paragraph in text.split("\n\n")),
            epilog=f"examples:\n{examples}" if examples else None,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        loaded.arguments(command)
        command.set_defaults(command=loaded.run)
    return top
