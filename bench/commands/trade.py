"""measure what each setting, execution and precision gives up in quality for speed and bytes

examples:
  neubtf-bench trade --material satin
  neubtf-bench trade --material satin --codec neumip
"""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from bench.arguments import assignments, usable_device
from bench.errors import FAILED, FINE, NOTHING

if TYPE_CHECKING:
    from bench.console import Console
    from bench.runs.suite import Suite

SUITE = "trade"


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("suite", nargs="?", default=SUITE, help="a built-in suite or a TOML file (default: trade)")
    parser.add_argument("--out", type=Path, help="the run's folder (default: runs/SUITE)")
    parser.add_argument("--material", action="append", default=[], help="this material, by name or path; repeatable")
    parser.add_argument("--codec", action="append", default=[], help="only this codec; repeatable")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="codec setting, or data.KEY")
    parser.add_argument("--device", default="cpu", help="cpu or cuda (default: cpu)")
    parser.add_argument("--full", action="store_true", help="time batches up to 2^22, half an hour more")


def run(options: argparse.Namespace) -> int:
    from bench.console import Console
    from bench.runs.suite import described_changes, load_suite, with_changes

    changes = assignments(options.set)
    suite = with_changes(load_suite(options.suite), options.material, options.codec, changes, None)
    folder = options.out or Path("runs") / suite.name
    with Console() as console:
        for line in described_changes(suite, changes):
            console.say(line)
        states = measure(suite, folder, usable_device(options.device), console, options.full)
        if "ok" not in states:
            return NOTHING
        from reports import table_text, write_report

        files = write_report(folder).files
        console.say(table_text(folder, kind="trade"))
        console.say("\n".join(f"wrote {path}" for path in files))
    return FAILED if "failed" in states else FINE


def measure(suite: "Suite", folder: Path, device: str, console: "Console", full: bool = False) -> list[str]:
    """Run a suite, then score and time its choices into `trade.json`; what became of each job."""
    from bench.console import job_line
    from bench.records import load_run, load_trade
    from bench.runs import runner, trade
    from bench.timing.execution import Variant

    for variant in suite.variants:
        Variant.parse(variant)  # a wrong word stops here
    load_trade(folder)  # and so does a file that could not be extended
    states = []
    for outcome in runner.run(suite, runner.Options(folder, device, show=console.show)):
        states.append(outcome.record["status"])
        console.say(job_line(outcome.record, outcome.cached))
    if "ok" in states:
        found = trade.measure(suite, load_run(folder), device, full, console.show)
        trade.write(folder, trade.merged(load_trade(folder), found))
    return states
