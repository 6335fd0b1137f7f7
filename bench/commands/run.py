"""run a suite: encode, write, decode, score, time, record, report"""

import argparse
from pathlib import Path
from typing import Any

from bench.arguments import assignments, usable_device
from bench.exits import FAILED, FINE, NOTHING


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("suite", nargs="?", default="quick", help="a built-in suite or a TOML file (default: quick)")
    parser.add_argument("--out", type=Path, help="the run's folder (default: runs/SUITE)")
    parser.add_argument(
        "--material", action="append", default=[], help="only this material, by name or path; repeatable"
    )
    parser.add_argument("--codec", action="append", default=[], help="only this codec; repeatable")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="codec setting, or data.KEY")
    parser.add_argument("--all-pairs", action="store_true", help="use measured data whole, however many pairs it has")
    parser.add_argument("--device", default="cpu", help="cpu or cuda (default: cpu)")
    parser.add_argument("--seed", type=int, help="run this one seed instead of the suite's")
    parser.add_argument("--fresh", action="store_true", help="fit and score again what is already there")
    parser.add_argument("--retry-failed", action="store_true", help="try jobs again that failed before")


def run(options: argparse.Namespace) -> int:
    from bench import runner
    from bench.console import Console, job_line
    from bench.suite import load_suite, with_changes

    changes = assignments(options.set) | ({"data.pairs": "0"} if options.all_pairs else {})
    suite = with_changes(load_suite(options.suite), options.material, options.codec, changes, options.seed)
    folder = options.out or Path("runs") / suite.name
    device = usable_device(options.device)
    outcomes = []
    with Console() as console:
        settings = runner.Options(folder, device, options.fresh, options.retry_failed, console.show)
        for outcome in runner.run(suite, settings):
            outcomes.append(outcome)
            console.say(job_line(outcome.record, outcome.cached))
    from reports import write_report

    written = write_report(folder)
    console.say(written.text)
    console.say(_summary(outcomes))
    console.say(f"records, files, tables and pictures: {folder}")
    return _verdict([outcome.record["status"] for outcome in outcomes])


def _summary(outcomes: list[Any]) -> str:
    cached = [outcome.cached for outcome in outcomes]
    status = [outcome.record["status"] for outcome in outcomes]
    words = [f"{len(outcomes)} jobs: {status.count('ok')} ok"]
    words += [f"{status.count(word)} {text}" for word, text in _WORDS.items() if word in status]
    if any(cached):
        words += [f"{cached.count('record')} cached whole, {cached.count('file')} scored again from cached files"]
    return "; ".join(words) + ("" if not any(cached) else " (--fresh runs them anew); timings are new")


_WORDS = {"failed": "failed (see the records; --retry-failed tries again)", "unavailable": "not available"}


def _verdict(status: list[str]) -> int:
    if "failed" in status:
        return FAILED
    return FINE if "ok" in status else NOTHING
