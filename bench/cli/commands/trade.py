"""measure the quality, speed and bytes of each setting, execution and precision

examples:
  neubtf-bench trade --material satin
  neubtf-bench trade --material satin --codec neumip
  neubtf-bench trade --material satin --codec pca --noise
"""

import argparse
from pathlib import Path

from bench.cli.commands import assignments, suite_options, usable_device
from bench.cli.console import Console
from bench.inputs.errors import FAILED, FINE, NOTHING
from bench.runs.runner import Options
from bench.runs.suite import described_changes, load_suite, with_changes
from bench.runs.trade import run_and_measure
from reports import table_text, write_report


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    add = parser.add_argument
    suite_options(parser, "trade")
    add("--emulated", action="store_true", help="also measure precisions that the processor only emulates")
    noise = "render each file with Mitsuba: samples and seconds to 1 %% noise; takes a minute or two a file"
    add("--noise", action="store_true", help=noise)


def run(options: argparse.Namespace) -> int:
    """Run the suite, measure its choices and write the report.

    Returns `FINE`, `FAILED` if some jobs failed, or, without a report, `NOTHING` if none has a result.
    """
    changes = assignments(options.set)
    suite = with_changes(load_suite(options.suite), options.material, options.codec, changes)
    folder = options.out or Path("runs") / suite.name
    device = usable_device(options.device)
    with Console() as console:
        for line in described_changes(suite, changes):
            console.say(line)
        run_options = Options(folder, device, show=console.show)
        states = run_and_measure(suite, run_options, console.ended, emulated=options.emulated, noise=options.noise)
        if "ok" not in states:
            return NOTHING
        files = write_report(folder).files
        console.say(table_text(folder, kind="trade"))
        console.say("\n".join(f"wrote {path}" for path in files))
    return FAILED if "failed" in states else FINE
