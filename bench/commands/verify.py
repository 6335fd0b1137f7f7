"""decode and score every codec file of an archive anew on this machine, and say what agrees

Nothing in an archive is run or installed. A codec from elsewhere must be installed here first; otherwise its jobs are
named, with version and hash, and not verified. What was measured here is written as a run, which `table`, `compare` and
`results add` read. Seconds of fits are those that the archive claims, because nothing is fitted.

examples:
  neubtf-bench verify mine.zip
  neubtf-bench results add runs/mine docs/results/quick.jsonl
"""

import argparse
from collections import Counter
from pathlib import Path

from bench.errors import FINE, NO, NOTHING, InputError


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("archive", type=Path, help="an archive of `neubtf-bench submit`")
    parser.add_argument("--out", type=Path, help="the folder of the run to write (default: runs/NAME)")


def run(options: argparse.Namespace) -> int:
    import tempfile

    from tabulate import tabulate

    from bench.console import Console
    from bench.records import FILE
    from bench.runs.archive import AGREES, DIFFERS, unpack, verify

    folder = options.out or Path("runs") / options.archive.stem
    if (folder / FILE).exists():
        raise InputError(f"--out {folder}: there is a run already: name another folder")
    with tempfile.TemporaryDirectory(prefix="neubtf-verify-") as scratch, Console() as console:
        submitted = unpack(options.archive, Path(scratch))
        folder.mkdir(parents=True, exist_ok=True)
        verdicts = list(verify(submitted, folder, console.show))
    print(tabulate([(each.job, each.verdict, each.why) for each in verdicts], ["job", "verdict", ""], "simple"))
    counts = Counter(each.verdict for each in verdicts)
    print(f"\n{', '.join(f'{count} {word}' for word, count in counts.items())}; measured here: {folder}")
    if DIFFERS in counts:
        return NO
    return FINE if AGREES in counts else NOTHING
