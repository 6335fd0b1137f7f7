"""The command line, `neubtf-bench`: finds the command, runs it, and turns what it raises into an exit code."""

import argparse
import os
import sys
from collections.abc import Sequence

from bench import commands
from bench.codecs.registry import first_line
from bench.errors import InputError
from bench.exits import FINE, INTERNAL, INTERRUPTED, USAGE


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code; see `bench.exits`."""
    if "OMP_WAIT_POLICY" not in os.environ:
        # PyTorch's threads wait for work by turning in place: for 0.2 ms, not 8, in which Dr.Jit's need the cores.
        os.environ.setdefault("GOMP_SPINCOUNT", "5000")
    words = list(sys.argv[1:] if argv is None else argv)
    try:
        options = _parser(words[:1]).parse_args(words)
        code: int = options.command(options)
        return code
    except InputError as error:
        print(f"neubtf-bench: {error}", file=sys.stderr)
        return USAGE
    except KeyboardInterrupt:
        print("\nneubtf-bench: interrupted; what is finished is recorded", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        sys.stderr.close()
        return FINE
    except Exception:
        import traceback

        traceback.print_exc()
        print("neubtf-bench: internal error: please report the lines above", file=sys.stderr)
        return INTERNAL


def _parser(wanted: Sequence[str]) -> argparse.ArgumentParser:
    """The parser of the command that is wanted; of the others their names, so that none of them is imported."""
    parser = argparse.ArgumentParser(
        prog="neubtf-bench",
        description="Compares neural codecs of bidirectional texture functions: real bytes, error, time per sample.",
    )
    known = commands.modules()
    listing = parser.add_subparsers(required=True, metavar="COMMAND")
    for name in known:
        module = known[name]
        if name in wanted:
            loaded = commands.load(module)
            text = (loaded.__doc__ or "").split("\n")[0]
            command = listing.add_parser(name, help=text, description=loaded.__doc__)
            loaded.arguments(command)
            command.set_defaults(command=loaded.run)
        else:
            listing.add_parser(name, help="" if wanted and wanted[0] in known else first_line(module))
    return parser


if __name__ == "__main__":
    sys.exit(main())
