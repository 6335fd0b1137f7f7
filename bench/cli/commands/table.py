"""print the tables of one run, or of several runs together

`table parameters` shows decoder parameters and texture channels beside those of the NeuBTF paper. It needs no run: for
codecs that the run did not measure, it makes a small file and counts in that.

examples:
  neubtf-bench table
  neubtf-bench table budgets runs/ladders
  neubtf-bench table main runs/quick --format latex
  neubtf-bench table summary docs/results/quick.jsonl runs/mine
  neubtf-bench table summary --format latex --codec neubtf-direct --codec pca --column "PSNR pooled" --column total
  neubtf-bench table main runs/quick --name neubtf-direct="NeuBTF, direct" --name "total=bytes"
"""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from bench.errors import FINE, NOTHING, InputError

if TYPE_CHECKING:
    from reports.choice import Choice


def arguments(parser: argparse.ArgumentParser) -> None:
    from reports import KINDS

    parser.add_argument(
        "what",
        nargs="*",
        metavar="KIND|RUN",
        help=f"one kind of table ({', '.join(KINDS)}; default: "
        "all), and folders of runs or files of records (default: the newest run under runs/)",
    )
    parser.add_argument(
        "--format",
        default="text",
        choices=["text", "markdown", "latex", "csv", "raw"],
        help="the format; raw is a CSV of every number of every job (default: text)",
    )
    parser.add_argument("--codec", action="append", default=[], help="only this codec, or this row; repeatable")
    parser.add_argument("--column", action="append", default=[], help="only this column, by its header; repeatable")
    parser.add_argument(
        "--name",
        action="append",
        default=[],
        metavar="WORD=NAME",
        help="rename a codec, row, column or material in rows, headers, title and notes; repeatable",
    )


def run(options: argparse.Namespace) -> int:
    from reports import KINDS, WHY_EMPTY, table_text

    kinds = [word for word in options.what if word in KINDS]
    folders = [Path(word) for word in options.what if word not in KINDS]
    choice = _choice(options)
    if len(kinds) > 1:
        raise InputError(f"table: give one kind of table, not {' and '.join(kinds)}")
    if kinds == ["parameters"]:
        print(_parameters(folders or _runs()[-1:], options.format, choice))
        return FINE
    folders = folders or [_newest_run(kinds)]
    text = table_text(folders, options.format, kinds[0] if kinds else None, choice)
    if not text.strip():
        names = ", ".join(map(str, folders))
        print(f"neubtf-bench: {names}: no such table: {WHY_EMPTY[kinds[0] if kinds else 'main']}", file=sys.stderr)
        return FINE if kinds == ["unfinished"] else NOTHING
    print(text)
    return FINE


def _choice(options: argparse.Namespace) -> "Choice | None":
    """The rows, columns and names that the options choose; None if they choose none."""
    from reports.choice import Choice

    if not (options.codec or options.column or options.name):
        return None
    if options.column and options.format == "raw":
        raise InputError("--column: not with --format raw, which has every number: choose --format csv")
    names = {word: name for word, _, name in (words.rpartition("=") for words in options.name)}
    if "" in names:
        raise InputError("--name: write WORD=NAME, such as 'neubtf-direct=NeuBTF, direct'")
    return Choice(options.codec, options.column, names)


def _parameters(folders: list[Path], format: str, choice: "Choice | None") -> str:
    """The table of parameters, from the records of runs where they have the codec."""
    from bench.codecs.registry import codec_entries
    from bench.records import load_together, require
    from reports import parameters_text
    from reports.parameters import PUBLISHED

    jobs = [job for job in load_together(folders).jobs if job["status"] == "ok"] if folders else []
    for job in jobs:
        require(job, "tables", folders[-1])
    wanted = [name for name in PUBLISHED if name in codec_entries() and name not in {job["codec"] for job in jobs}]
    if wanted:
        from bench.conformance.verdicts import count

        jobs += [count(name) for name in wanted]
    return parameters_text(jobs, format, choice)


def _newest_run(kinds: list[str]) -> Path:
    from bench.records import FILE, STRESS

    folders = _runs()
    if kinds == [STRESS] and (Path("runs") / STRESS / FILE).is_file():
        return Path("runs") / STRESS
    if not folders:
        raise InputError("table: there is no run under runs/: give the folder that `neubtf-bench run` wrote")
    return folders[-1]


def _runs() -> list[Path]:
    """The folders of runs under runs/, without the stress test's, newest last."""
    from bench.records import FILE, STRESS

    files = [path for path in Path("runs").glob(f"*/{FILE}") if path.parent.name != STRESS]
    return [path.parent for path in sorted(files, key=lambda path: path.stat().st_mtime)]
