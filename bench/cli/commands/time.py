"""time each setting of a suite on this machine, apart from what it was fitted to

A time depends on the setting, not on the fit. So each setting is fitted for one step, on two surfaces, and all are
timed in turns, twice. If `table budgets` or `table front` is given such a folder, it uses no other times. With
--variants each execution and precision is timed instead, first compared with float64, then batches of 2^14 to 2^22 for
some settings, and the steps of fits: for a GPU. The command then ends after --minutes; give it again to continue.

examples:
  neubtf-bench time budgets --out runs/times
  neubtf-bench table times runs/times
  neubtf-bench table budgets runs/budgets runs/times
  neubtf-bench results add runs/times docs/results/budgets.jsonl
  neubtf-bench time budgets --out runs/times --device cuda --variants --minutes 9
"""

import argparse
from pathlib import Path

from bench.cli.commands import assignments, suite_options, usable_device
from bench.cli.console import Console
from bench.inputs.errors import FINE
from bench.runs.setting_times import time_settings
from bench.runs.setting_variants import time_variants
from bench.runs.suite import described_changes, load_suite, with_changes
from reports import table_text


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    suite_options(parser, "budgets", folder="runs/SUITE-times")
    add = parser.add_argument
    add("--variants", action="store_true", help="time executions, precisions, batches and steps of fits")
    add("--minutes", type=float, default=60.0, help="end --variants after so many minutes (default: 60)")


def run(options: argparse.Namespace) -> int:
    """Time the settings, or with --variants their executions and precisions, and print the table; returns the exit
    code."""
    changes = assignments(options.set)
    suite = with_changes(load_suite(options.suite), options.material, options.codec, changes)
    folder = options.out or Path("runs") / f"{suite.name}-times"
    device = usable_device(options.device)
    with Console() as console:
        for line in described_changes(suite, changes):
            console.say(line)
        if options.variants:
            time_variants(suite, folder, device, options.minutes, console.show)
        else:
            time_settings(suite, folder, device, console.show)
        console.say(table_text(folder, kind="times"))
        console.say(f"wrote {folder}")
    return FINE
