"""run a suite: encode, write, decode, score, time, record, report

If a run was stopped by Ctrl-C, a kill or a full disk, the same command resumes it.

examples:
  neubtf-bench run quick
  neubtf-bench run quick --material satin --codec pca --codec neumip --set pca.components=24 --out runs/mine
  neubtf-bench run budgets --jobs 8
"""

import argparse
from dataclasses import replace
from functools import partial
from pathlib import Path

from bench.cli.commands import (
    assignments,
    jobs_option,
    read_as,
    reading_options,
    seed_option,
    several,
    suite_options,
    usable_device,
    workers,
)
from bench.cli.commands._scene import demand_file, scene_options
from bench.cli.console import Console
from bench.inputs.errors import FAILED, FINE, INTERRUPTED, NOTHING, InputError
from bench.records import load_run
from bench.runs import executors, runner
from bench.runs.executors import Seats
from bench.runs.suite import described_changes, load_suite, require_materials, with_changes, with_metrics
from reports import write_report


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    add = parser.add_argument
    suite_options(parser, "quick")
    several(parser, "--metric", "score with this metric too; repeatable")
    add("--all-pairs", action="store_true", help="use measured data whole, however many pairs it has")
    reading_options(parser)
    scene_options(parser, "score in a scene too; codecs with scene=true fit to it")
    only = "run only this seed, instead of the suite's; repeatable"
    add("--seed", type=seed_option, action="append", default=[], metavar="SEED", help=only)
    add("--fresh", action="store_true", help="fit and score finished jobs again")
    add("--retry-failed", action="store_true", help="try failed jobs again")
    jobs_option(parser, "jobs")
    add("--max-seconds", type=float, metavar="S", help="a job that takes longer fails (default: no limit)")
    dask = "run jobs on the workers of a Dask scheduler: its address, or the .json file that it wrote"
    add("--scheduler", metavar="ADDRESS", help=dask)
    needs = "a resource that a job needs of a Dask worker, such as GPU=1; repeatable"
    several(parser, "--resource", needs, "NAME=COUNT")


def run(options: argparse.Namespace) -> int:
    """Run the suite and write its report; returns `FINE`, `FAILED` if a job failed, `NOTHING` if none has a result.

    After Ctrl-C no report is written, and it returns `INTERRUPTED`.
    """
    changes = _changes(options)
    suite = with_changes(load_suite(options.suite), options.material, options.codec, changes, options.seed)
    suite = with_metrics(suite, options.metric)
    # The workers of a scheduler are elsewhere, where other devices and other data may be.
    if not options.scheduler:
        require_materials(suite, "--material" if options.material else f"{options.suite}: materials")
    folder = options.out or Path("runs") / suite.name
    device = options.device if options.scheduler else usable_device(options.device)
    seats = _workers_asked_for(options, suite.threads)
    outcomes: list[runner.Outcome] = []
    with Console() as console:
        demand = demand_file(options, folder, console)
        if demand:
            suite = replace(suite, demand=str(demand))
        for line in described_changes(suite, changes):
            console.say(line)
        settings = runner.Options(folder, device, options.fresh, options.retry_failed, console.show, console.say, seats)
        try:
            for outcome in runner.run(suite, settings):
                outcomes.append(outcome)
                console.ended(outcome)
        except KeyboardInterrupt:
            done = f"{len(outcomes)} of {len(suite.cells)} jobs are done"
            console.say(f"{_summary(outcomes, timed=False)}\ninterrupted: {done}; the same command resumes: {folder}")
            return INTERRUPTED
        console.show("drawing tables, figures and pages", 0, 1)
        written = write_report(folder)
        console.show("drawing tables, figures and pages", 1, 1)
    console.say(written.text)
    recorded = load_run(folder)
    timed = any(recorded.start_of(timing) is recorded.starts[-1] for timing in recorded.timings)
    console.say(_summary(outcomes, timed))
    console.say(f"records, files, tables and pictures: {folder}")
    states = {outcome.record["status"] for outcome in outcomes}
    if "failed" in states:
        return FAILED
    return FINE if "ok" in states else NOTHING


def _changes(options: argparse.Namespace) -> dict[str, str]:
    """The settings that the options change, of codecs and, by `data.KEY`, of the data."""
    changes = assignments(options.set)
    if options.all_pairs:
        changes["data.pairs"] = "0"  # no limit
    return changes | read_as(options)


def _workers_asked_for(options: argparse.Namespace, threads: int) -> Seats | None:
    """The workers that run jobs with `threads` threads each, here or on Dask; None if the runner decides."""
    if options.resource and not options.scheduler:
        raise InputError("--resource: only for the workers of a Dask --scheduler: give it, or leave --resource out")
    if options.max_seconds is not None and options.scheduler:
        raise InputError("--max-seconds: not with a --scheduler, because this process cannot end its workers")
    if options.scheduler:
        if options.jobs != 1:
            raise InputError("--jobs, --scheduler: give only one of them; the scheduler knows how many workers it has")
        counts = assignments(options.resource, "--resource", "NAME=COUNT, such as GPU=1")
        try:
            resources = {name: float(count) for name, count in counts.items()}
        except ValueError:
            raise InputError(f"--resource {' '.join(options.resource)}: write NAME=COUNT, such as GPU=1") from None
        return partial(executors.dask, options.scheduler, resources)
    return workers(options.jobs, threads, options.device, options.max_seconds)


def _summary(outcomes: list[runner.Outcome], timed: bool) -> str:
    """How many jobs ended in which state, and how many were reused, in one line.

    `timed` says whether this start of the run measured times.
    """
    cached = [outcome.cached for outcome in outcomes]
    status = [outcome.record["status"] for outcome in outcomes]
    others = {"failed": "failed (see the records; --retry-failed tries them again)", "unavailable": "not available"}
    words = [f"{len(outcomes)} jobs: {status.count('ok')} ok"]
    words += [f"{status.count(word)} {text}" for word, text in others.items() if word in status]
    if any(cached):
        reused = f"{cached.count('record')} from the cache, {cached.count('file')} scored again from cached files"
        words.append(f"{reused} (--fresh runs them again)")
        if timed:
            words.append("times were measured again")
    return "; ".join(words)
