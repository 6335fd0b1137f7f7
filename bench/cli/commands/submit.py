"""pack the records and codec files of a run into an archive that others can verify

Anyone who has the archive can score every file again with `neubtf-bench verify ARCHIVE`, so nobody has to trust you.

examples:
  neubtf-bench submit runs/mine -o mine.zip
  neubtf-bench submit runs/standard --codec mine -o mine.zip
"""

import argparse
from pathlib import Path

from bench.errors import FINE, InputError


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run", type=Path, help="the folder of a run")
    parser.add_argument("--codec", action="append", default=[], help="only this codec; repeatable")
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="FILE", help="the .zip file to write")


def run(options: argparse.Namespace) -> int:
    from bench.compare.results import published
    from bench.records import load_run
    from bench.runs.archive import chosen, pack

    if options.out.suffix != ".zip":
        raise InputError(f"--out {options.out}: the name must end in .zip")
    run = chosen(load_run(options.run), options.codec)
    pack(run, published(run), options.out)
    print(f"wrote {options.out}: {len(run.jobs)} jobs, {options.out.stat().st_size:,} bytes")
    return FINE
