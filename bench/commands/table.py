"""print a run's tables"""

import argparse
from pathlib import Path

from bench.errors import InputError
from bench.exits import FINE

TABLES = ("main", "angular", "radiance", "footprints", "rate", "unfinished")


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "what",
        nargs="*",
        metavar="KIND|RUN",
        help=f"one kind of table ({', '.join(TABLES)}; default: "
        "all) and the folder of a run (default: the newest under runs/)",
    )
    parser.add_argument("--format", default="text", choices=["text", "markdown", "latex", "csv"])


def run(options: argparse.Namespace) -> int:
    kinds = [word for word in options.what if word in TABLES]
    folders = [Path(word) for word in options.what if word not in TABLES]
    if len(kinds) > 1 or len(folders) > 1:
        raise InputError("table: give one kind of table and one folder of a run at most")
    from reports import table_text

    print(table_text(folders[0] if folders else _newest_run(), options.format, kinds[0] if kinds else None))
    return FINE


def _newest_run() -> Path:
    from bench.records import FILE

    found = sorted(Path("runs").glob(f"*/{FILE}"), key=lambda path: path.stat().st_mtime)
    if not found:
        raise InputError("table: there is no run under runs/: give the folder that `neubtf-bench run` wrote")
    return found[-1].parent
