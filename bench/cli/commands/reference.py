"""make the reference that `compare` judges by, from a run

`reference update RUN` writes FILE, or the reference of the run's suite inside the installed package, and prints what
changed. In a clone that is not installed with -e, give --out bench/compare/references/SUITE.jsonl. A reference
should have more seeds than a run, because they tell how far the results of a codec scatter: first add seeds to the
run's folder, with `neubtf-bench run SUITE --seed N --out RUN`. A reference that could not tell a loss of a decibel of
PSNR from chance guards nothing: it is refused without --wide.

examples:
  neubtf-bench reference update runs/ci
  neubtf-bench reference update runs/mine -o reference.jsonl
"""

import argparse
import tempfile
from pathlib import Path

from bench.cli.commands import say_line
from bench.compare.comparison import check_whole, compare
from bench.compare.quantities import MAIN
from bench.compare.reference import committed, few_seeds, pairs_by_seed, reference, seeds_of, smallest_losses
from bench.files.atomic import write
from bench.inputs.errors import FINE, InputError, writable
from bench.records import FILE, Run, load_run
from bench.runs.suite import builtin_suites
from reports.comparison import terminal

WIDEST = 1.0  # dB of PSNR: a reference that cannot tell such a loss from chance is refused


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    actions = parser.add_subparsers(required=True, metavar="ACTION")
    update = actions.add_parser("update", help="write the reference again, and print what changed")
    update.add_argument("run", metavar="RUN", help="the folder of a run")
    place = "the .jsonl file to write (default: that of the installed package)"
    update.add_argument("--wide", action="store_true", help="also write one that hides losses of over 1 dB")
    update.add_argument("-o", "--out", type=Path, metavar="FILE", help=place)


def run(options: argparse.Namespace) -> int:
    """Write the reference again, and print what changed and what it cannot tell; returns the exit code."""
    measured = load_run(options.run)
    if not all("run" in start for start in measured.starts):
        raise InputError(f"{options.run}: it is a reference, not a run: give the folder of a run")
    path = _place(options, measured)
    before = load_run(path) if path.is_file() else None
    if before:
        check_whole(before)
    text = reference(measured, before)
    with tempfile.TemporaryDirectory() as folder:  # judged before it replaces the one that is there
        trial = Path(folder) / path.name
        trial.write_text(text, encoding="utf-8")
        losses = smallest_losses(load_run(trial), seeds_of(measured))
    if not options.wide:
        _refuse_wide(losses, path)
    with writable(path, "give --out FILE"):
        write(path, text.encode())
    after = load_run(path)
    print(terminal(compare(before or after, after)))
    say_line(f"wrote {path}: {len(after.jobs)} jobs, {len(text.encode()):,} bytes")
    _say_limits(after, losses, options.run)
    return FINE


def _place(options: argparse.Namespace, measured: Run) -> Path:
    """The file to write: --out, else the committed reference of the run's suite."""
    path: Path | None = options.out
    if path is None:
        suite = measured.starts[-1]["suite"] if measured.starts else ""
        if suite not in builtin_suites():
            raise InputError(f"{options.run}: not a run of a built-in suite: give --out FILE")
        path = committed(suite)
    if path.suffix != ".jsonl":
        raise InputError(f"{path}: the name of a reference ends in .jsonl")
    if path.name == FILE:  # of this run or of another: its measurements would be lost
        raise InputError(f"{path}: the records of a run have this name: give --out another one")
    return path


def _refuse_wide(losses: dict[str, dict[str, float]], path: Path) -> None:
    """Raise `InputError` for rows whose loss of PSNR must exceed `WIDEST` to be told from chance."""
    wide = {name: loss_of[MAIN] for name, loss_of in losses.items() if loss_of.get(MAIN, 0.0) > WIDEST}
    if wide:
        listed = ", ".join(f"{name} {loss:.1f} dB" for name, loss in wide.items())
        raise InputError(
            f"{path}: not written: smaller losses of PSNR could not be told from chance: {listed}: fit with "
            "more steps, add seeds, or give --wide"
        )


def _say_limits(updated: Run, losses: dict[str, dict[str, float]], folder: str) -> None:
    """Print what the reference cannot tell: losses within chance, and codecs whose scatter is not known."""
    with_own_pairs = pairs_by_seed(updated)
    if losses:
        print("losses below these cannot be told from chance on these materials:")
        width = max(map(len, losses))
        for name, loss_of in losses.items():
            listed = ", ".join(f"{word} {value:.2f} dB" for word, value in loss_of.items())
            say_line(f"  {name:<{width}}  {listed}")
    few = [name for name in few_seeds(updated) if name not in with_own_pairs]
    if few:
        say_line(f"too few seeds to tell a spread; add some with `run --seed N --out {folder}`: {', '.join(few)}")
    if with_own_pairs:
        say_line(
            "warning: each seed is scored at its own test pairs, so only seeds that a run shares with this reference "
            'show a change, and margins are wide; write split = "validation" into [data] of the suite, and run it '
            f"again: {', '.join(with_own_pairs)}"
        )
