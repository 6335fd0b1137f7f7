"""print a run's tables

`table parameters` sets decoder parameters and texture channels beside those of the NeuBTF paper. Codecs that the run
did not measure are counted in a small file that is made for it, so that it needs no run.

examples:
  neubtf-bench table
  neubtf-bench table rate runs/rd
  neubtf-bench table main runs/quick --format latex
"""

import argparse
import sys
from pathlib import Path

from bench.errors import FINE, NOTHING, InputError


def arguments(parser: argparse.ArgumentParser) -> None:
    from reports import KINDS

    parser.add_argument(
        "what",
        nargs="*",
        metavar="KIND|RUN",
        help=f"one kind of table ({', '.join(KINDS)}; default: "
        "all) and the folder of a run (default: the newest under runs/)",
    )
    parser.add_argument("--format", default="text", choices=["text", "markdown", "latex", "csv"])


def run(options: argparse.Namespace) -> int:
    from reports import KINDS, WHY_EMPTY, table_text

    kinds = [word for word in options.what if word in KINDS]
    folders = [Path(word) for word in options.what if word not in KINDS]
    if len(kinds) > 1 or len(folders) > 1:
        raise InputError("table: give one kind of table and one folder of a run at most")
    if kinds == ["parameters"]:
        print(_parameters(folders[0] if folders else None, options.format))
        return FINE
    folder = folders[0] if folders else _newest_run(kinds)
    text = table_text(folder, options.format, kinds[0] if kinds else None)
    if not text.strip():
        print(f"neubtf-bench: {folder}: no such table: {WHY_EMPTY[kinds[0] if kinds else 'main']}", file=sys.stderr)
        return FINE if kinds == ["unfinished"] else NOTHING
    print(text)
    return FINE


def _parameters(folder: Path | None, format: str) -> str:
    """The table of parameters, from the records of a run as far as it goes."""
    from bench.codecs.registry import codec_entries
    from bench.records import load_run
    from reports import parameters_text
    from reports.parameters import PUBLISHED

    folders = [folder] if folder else _runs()[-1:]
    jobs = [job for folder in folders for job in load_run(folder).jobs if job["status"] == "ok"]
    wanted = [name for name in PUBLISHED if name in codec_entries() and name not in {job["codec"] for job in jobs}]
    if wanted:
        from bench.conformance.verdicts import count

        jobs += [count(name) for name in wanted]
    return parameters_text(jobs, format)


def _newest_run(kinds: list[str]) -> Path:
    from bench.records import FILE, STRESS

    found = _runs()
    if kinds == [STRESS] and (Path("runs") / STRESS / FILE).is_file():
        return Path("runs") / STRESS
    if not found:
        raise InputError("table: there is no run under runs/: give the folder that `neubtf-bench run` wrote")
    return found[-1]


def _runs() -> list[Path]:
    """The folders of runs under runs/, the newest last; that of the stress test is none."""
    from bench.records import FILE, STRESS

    found = [path for path in Path("runs").glob(f"*/{FILE}") if path.parent.name != STRESS]
    return [path.parent for path in sorted(found, key=lambda path: path.stat().st_mtime)]
