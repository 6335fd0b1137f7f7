"""time each setting of a suite on this machine, apart from what it was fitted to

A time depends on the setting, not on the fit. So each setting is fitted for one step, on two surfaces, and all are
timed in turns, twice. `table budgets` and `table front` use these times alone if they are given them:

examples:
  neubtf-bench time budgets --out runs/times
  neubtf-bench table times runs/times
  neubtf-bench table budgets runs/budgets runs/times
  neubtf-bench results add runs/times docs/results/budgets.jsonl
"""

import argparse
from pathlib import Path

from bench.cli.commands import assignments, suite_options, usable_device
from bench.inputs.errors import FINE


def arguments(parser: argparse.ArgumentParser) -> None:
    suite_options(parser, "budgets")


def run(options: argparse.Namespace) -> int:
    from bench.cli.console import Console
    from bench.runs.setting_times import time_settings
    from bench.runs.suite import described_changes, load_suite, with_changes

    changes = assignments(options.set)
    suite = with_changes(load_suite(options.suite), options.material, options.codec, changes, None)
    folder = options.out or Path("runs") / f"{suite.name}-times"
    device = usable_device(options.device)
    with Console() as console:
        for line in described_changes(suite, changes):
            console.say(line)
        time_settings(suite, folder, device, console.show)
        from reports import table_text

        console.say(table_text(folder, kind="times"))
        console.say(f"wrote {folder}")
    return FINE
