"""try codecs on extreme data, queries, precision and training, and print what breaks

It tries every installed codec, or those of --codec, and every metric and loss on extreme pictures. Rows are extremes,
columns are codecs; a cell is pass, FAIL with the wrong number, or n/a with the reason below. Records go to --out, and
every report beside it shows them. --query and --data try one drawn case again, in the form that a failure prints.

examples:
  neubtf-bench stress
  neubtf-bench stress --codec my-codec --case "two constants" --out runs/constants
"""

import argparse
import tempfile
from itertools import chain
from pathlib import Path
from typing import Any

from bench import records
from bench.cli.commands import say_line, several
from bench.cli.console import Console
from bench.codecs.registry import load_codec
from bench.conformance.check import CheckError
from bench.conformance.stress import CASES, Case, metrics
from bench.conformance.stress import run as stress
from bench.conformance.stress.case import subject_of
from bench.conformance.stress.properties import LARGEST_EXPONENT, LEAST_EXPONENT, data_hold, query_holds
from bench.files.atomic import make_folder
from bench.inputs.errors import FINE, NO, InputError, writable
from bench.machine.threads import cores
from bench.records import STRESS
from bench.runs.executors import in_process, processes
from bench.runs.provenance import provenance
from reports import stress_text


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    add = parser.add_argument
    several(parser, "--codec", "only this codec; repeatable")
    several(parser, "--case", "only this extreme; repeatable", "NAME")
    add("--cheap", action="store_true", help="only the extremes that `check` tries too")
    add("--list", action="store_true", help="only list the extremes and what must hold in each")
    add("--out", type=Path, default=Path("runs") / STRESS, help="the folder of the records (default: runs/stress)")
    add("--jobs", type=int, default=cores(), metavar="N", help="how many processes to use (default: one a core)")
    add("--format", default="text", choices=["text", "markdown"], help="format of the printed tables")
    add("--query", metavar="NUMBERS", help='ask one query: "u v ω_o ω_i footprint", nine numbers')
    add("--data", metavar="NUMBERS", help='try one drawn material: "height width views lights exponent seed"')


def run(options: argparse.Namespace) -> int:
    """Try codecs at the extremes and print the tables; returns `FINE`, or `NO` if one fails."""
    if options.list:
        width = max(len(case.name) for case in CASES)
        every: list[Case | metrics.PictureCase] = [*CASES, *metrics.CASES]
        print("\n".join(f"{case.group:<10}  {case.name:<{width}}  {case.holds}" for case in every))
        return FINE
    if options.query or options.data:
        return _try_again(options)

    # Try the catalogue on codecs and, unless only some extremes are asked for, the pictures on metrics and losses.
    codecs, cases = stress.chosen(options.codec, options.case)
    cases = [case for case in cases if case.cheap or not options.cheap]
    if not cases:
        raise InputError("--cheap: none of the cases given is cheap: leave it out")
    with writable(options.out, "choose another --out"):
        make_folder(options.out)
    start: records.RunStart = {"kind": "run", "suite": "stress", "device": "cpu"}
    records.append(options.out, start | provenance())
    tried: list[records.Stress] = []
    count = min(options.jobs, 2 * len(codecs))  # a codec is two tasks
    seats = in_process() if count == 1 else processes(count, threads=1)
    with Console() as console, seats as workers:
        pictures = () if options.case else stress.picture_records()
        for record in chain(stress.run(codecs, cases, workers, console.show), pictures):
            records.append(options.out, record)
            tried.append(record)
    print(stress_text(tried, options.format))
    verdicts = [record["verdict"] for record in tried]
    say_line(
        f"{verdicts.count('pass')} pass, {verdicts.count('fail')} fail, {verdicts.count('n/a')} n/a: {options.out}"
    )
    return NO if "fail" in verdicts else FINE


def _try_again(options: argparse.Namespace) -> int:
    """Try one query or one drawn material, in the form that a failed property prints, on each codec; returns `FINE`, or
    `NO` if one fails."""
    queries = _numbers("--query", options.query, float, 9)
    data = _numbers("--data", options.data, int, 6)
    if data and (min(data[:4]) < 1 or max(data[2:4]) > 81):
        raise InputError(f"--data {options.data!r}: at least one texel and pair, at most 81 views and lights")
    if data and (not LEAST_EXPONENT <= data[4] <= LARGEST_EXPONENT or data[5] < 0):
        limits = f"an exponent from {LEAST_EXPONENT} to {LARGEST_EXPONENT}, and a seed of at least 0"
        raise InputError(f"--data {options.data!r}: the last two are {limits}")
    failed = False
    codecs, _ = stress.chosen(options.codec, [])
    for name in codecs:
        with tempfile.TemporaryDirectory() as folder:
            subject = subject_of(load_codec(name), Path(folder))
            try:
                answers: list[Any] = []
                if queries:
                    answers.append(query_holds(subject, queries))
                if data:
                    answers.append(data_hold(subject, data))
                say_line(f"pass  {name}: {', '.join(map(str, answers))}")
            except InputError:
                raise
            except Exception as error:  # any exception of a codec is its failure
                failed = True
                what = error if isinstance(error, CheckError) else f"{type(error).__name__}: {error}"
                say_line(f"FAIL  {name}: {what}")
    return NO if failed else FINE


def _numbers(option: str, text: str | None, kind: type, wanted: int) -> list[Any]:
    """The numbers of that kind, `float` or `int`, that an option gives, exactly as many as wanted; none without it."""
    if text is None:
        return []
    try:
        numbers = [kind(word) for word in text.replace(",", " ").split()]
    except ValueError as error:
        raise InputError(f"{option} {text!r}: {error}: give numbers with spaces between them") from error
    if len(numbers) != wanted:
        raise InputError(f"{option} {text!r}: it takes {wanted} numbers, not {len(numbers)}")
    return numbers
