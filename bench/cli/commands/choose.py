"""pick the codec and settings that meet a wish for quality, bytes or time

If no measured setting meets the wish, and some settings of the suite are not measured yet, the command first fits and
measures these. It says how many fits that takes, and about how long.

examples:
  neubtf-bench choose satin --min-psnr 30
  neubtf-bench choose satin --max-bytes 300k --max-ns 40
  neubtf-bench choose satin --min-psnr 30 --codec neumip --codec pca --steps 300 --jobs 0
"""

import argparse
import re
import shlex
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from bench.cli.commands import several, usable_device, workers
from bench.inputs.errors import FAILED, FINE, NO, InputError

if TYPE_CHECKING:
    from bench.compare.choosing import Rung
    from bench.runs.suite import Suite


def arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("material", help="a built-in material or the path of a BTF")
    add("--min-psnr", type=float, metavar="DB", help="the least PSNR of validation pairs")
    add("--max-bytes", metavar="BYTES", help="the largest size of the file: 300k, 1.5M, 20000")
    time = "the longest time of a sample, as a whole query: CPU time on the suite's threads, one in a built-in suite "
    add("--max-ns", type=float, metavar="NS", help=f"{time}(GPU time with --device cuda)")
    several(parser, "--codec", "fit and choose only this codec; repeatable")
    add("--steps", type=int, metavar="N", help="fit missing settings in N steps (default: the suite's)")
    jobs = "how many fits at once, each in its own process (and on its own GPU); 0: one a core (default: 1)"
    add("--jobs", type=int, default=1, metavar="N", help=jobs)
    add("--suite", default="trade", help="the suite whose settings are fitted if missing (default: trade)")
    add("--out", type=Path, help="the folder of a `trade`, extended if need be (default: runs/SUITE)")
    add("--device", default="cpu", help="cpu or cuda (default: cpu)")


def run(options: argparse.Namespace) -> int:
    from bench.compare.choosing import Limits, chosen, described, held, nearest
    from bench.runs.suite import canonical

    size = None if options.max_bytes is None else parse_bytes(options.max_bytes)
    wishes = Limits(size, options.max_ns, options.min_psnr)
    if wishes == Limits():
        raise InputError("choose: no wish is given: give --min-psnr, --max-bytes or --max-ns")
    suite = _suite(options)
    folder, material = options.out or Path("runs") / suite.name, suite.materials[0].name
    if not suite.data.validation:
        why = f"suite {suite.name} has no validation pairs to choose by"
        raise InputError(f"choose: {why}: add `validation = true` to [data]")
    rungs, missing = _measured(folder, suite, options.device)
    if missing and not chosen(rungs, wishes):
        suite = canonical(suite)  # by the names of the records; it loads the codecs
        if missing := _measured(folder, suite, options.device)[1]:
            _measure(folder, suite, options, len(missing))
            rungs, _ = _measured(folder, suite, options.device)
    if not rungs:
        print(f"{material}: nothing could be measured; the reasons are in {folder}")
        return FAILED
    best = chosen(rungs, wishes)
    if best is None:
        print(f"{material}: no setting meets that; the nearest is {described(nearest(rungs, wishes).of)}")
        return NO
    print(f"{material}: {described(best.of)}")
    print(held(folder, best.of))
    words = ["encode", options.material, "--codec", best.of["codec"]]
    for key, value in best.of["settings"].items():
        words += ["--set", f"{key}={value}"]
    for key, value in asdict(suite.data).items():  # as they differ from the defaults
        if key != "validation" and value != getattr(type(suite.data)(), key):
            words += ["--set", f"data.{key}={str(value).lower() if value is True else value}"]
    print(f"neubtf-bench {shlex.join([*words, '-o', f'{material}.nbtf'])}")
    return FINE


def parse_bytes(text: str) -> int:
    """A size in bytes from its text: `300k`, `1.5M`, `20000`."""
    match = re.fullmatch(r"(\d+(?:\.\d+)?)([kM]?)B?", text)
    if not match or float(match[1]) <= 0:
        raise InputError(f"--max-bytes {text}: write a number, or a number with k or M, such as 300k")
    return round(float(match[1]) * {"": 1, "k": 1_000, "M": 1_000_000}[match[2]])


def _suite(options: argparse.Namespace) -> "Suite":
    """The suite that the options name, for one material."""
    from bench.runs.suite import load_suite, with_changes

    suite = with_changes(load_suite(options.suite), [options.material], options.codec, {}, None)
    if options.steps is None:
        return suite
    try:
        return with_changes(suite, [], [], {"steps": str(options.steps)}, None)
    except InputError as error:
        raise InputError(f"--steps {options.steps}: {error}") from error


def _measured(folder: Path, suite: "Suite", device: str) -> tuple[list["Rung"], list[str]]:
    """The choices of a suite's material that were measured on a device, and the labels that were not tried."""
    from bench.compare.choosing import usable
    from bench.records import load_trade

    codecs, material = {codec.codec for codec in suite.codecs}, suite.materials[0].name
    every = (load_trade(folder) or {"choices": []})["choices"]
    of_device = [row for row in every if (row["material"], row["device"]) == (material, device)]
    rows = [row for row in of_device if row.get("codec") in codecs]
    tried = {row["label"] for row in rows if "validation" in row or "error" in row}
    return usable(rows, material), [codec.label for codec in suite.codecs if codec.label not in tried]


def _measure(folder: Path, suite: "Suite", options: argparse.Namespace, missing: int) -> None:
    """Run a trade over the suite, which fits only the missing settings."""
    from bench.cli.console import Console
    from bench.runs.runner import Options
    from bench.runs.trade import run_and_measure

    with Console() as console:
        several = f"{missing} of {len(suite.codecs)} settings of {suite.name}"
        console.say(f"{suite.materials[0].name}: {several} are not in {folder}: fitted, scored and timed first")
        device, seats = usable_device(options.device), workers(options.jobs, suite.threads, options.device)
        run_options = Options(folder, device, show=console.show, say=console.say, workers=seats)
        run_and_measure(suite, run_options, console.ended)
