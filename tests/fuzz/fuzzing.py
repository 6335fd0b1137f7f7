"""Runs attacks on whatever reads files and counts how they end; `fuzz_*.py` say what is attacked, and how.

Each target runs in processes of its own, under a limit of address space, so that a crash in a decoder is seen and
counted. An attack that ends in an `InputError` of one line is refused, one that gives an answer is read; whatever else
is raised is foreign. Exit code 1 where anything is foreign, takes over two seconds of the processor, or over 1 GiB.
"""

import argparse
import json
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from bench.inputs.errors import InputError

SECONDS, MEMORY, CHUNK = 2.0, 1 << 30, 500
READ, REFUSED = "read", "refused"
Reading = Callable[[], object]


@dataclass(frozen=True)
class Target:
    """Something that reads files: `make` writes a sound sample into a folder, `attack` returns a reading of a bad one.

    `attack` gets the folder of the sample, an empty folder, and its own random numbers.
    """

    name: str
    make: Callable[[Path], None]
    attack: Callable[[Path, Path, random.Random], Reading]


class Hang(BaseException):
    """A reading that took far too long; no reader can catch it by accident."""


def outcome(reading: Reading) -> str:
    """`READ`, `REFUSED`, or the name of whatever else was raised."""
    try:
        reading()
    except InputError as error:
        return REFUSED if "\n" not in str(error) else "a message of several lines"
    except (Exception, SystemExit, Hang) as error:
        return type(error).__name__
    return READ


def attacked(
    target: Target, indices: range, seed: int, folder: Path, patience: float = 0.0
) -> tuple[Counter[str], float, dict[str, int]]:
    """How often each outcome came, the longest seconds of the processor, and the first attack of each outcome.

    A reading is given up after `patience` seconds, for which the process needs a handler of SIGALRM; 0: never. Then
    none is called slow either, since tests depend on no speed.
    """
    found: Counter[str] = Counter()
    slowest, first = 0.0, {}
    sample = folder / "sample"
    sample.mkdir()
    target.make(sample)
    for index in indices:
        (folder / "LAST").write_text(f"{index} {json.dumps(found)}")
        with tempfile.TemporaryDirectory(dir=folder) as scratch:
            reading = target.attack(sample, Path(scratch), random.Random(f"{target.name} {seed} {index}"))
            begin = time.process_time()
            _alarm(patience or None)
            try:
                word = outcome(reading)
            finally:
                _alarm(0.0 if patience else None)
            seconds = time.process_time() - begin
        word = "slow" if patience and seconds > SECONDS and word in (READ, REFUSED) else word
        found[word] += 1
        first.setdefault(word, index)
        slowest = max(slowest, seconds)
    return found, slowest, first


def _alarm(seconds: float | None) -> None:
    if seconds is not None:
        signal.setitimer(signal.ITIMER_REAL, seconds)


def _expire(*_: object) -> None:
    raise Hang


def _work(target: Target, start: int, stop: int, seed: int, folder: Path) -> None:
    """One worker process: attacks under a limit of address space, the result as JSON on stdout."""
    warnings.simplefilter("error")
    warnings.filterwarnings("default", category=DeprecationWarning)
    signal.signal(signal.SIGALRM, _expire)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + 2 * MEMORY, used + 2 * MEMORY))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    found, slowest, first = attacked(target, range(start, stop), seed, folder, 16 * SECONDS)
    memory = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024
    print("\n" + json.dumps({"found": found, "slowest": slowest, "first": first, "memory": memory}))


def _run(target: Target, script: str, count: int, seed: int) -> bool:
    """Attack one target in chunks, each in a process of its own; print a line; True where all went well."""
    total: Counter[str] = Counter()
    slowest, memory, first, start = 0.0, 0.0, dict[str, int](), 0
    while start < count:
        stop = min(count, start + CHUNK)
        with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
            work = ["--work", target.name, str(start), str(stop), folder]
            command = [sys.executable, script, *work, "--seed", str(seed)]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:  # a crash: what came before it counts, and the next process goes on behind it
                last = Path(folder, "LAST")
                if not last.exists():
                    sys.exit(f"{target.name}: its sample cannot be made\n{done.stderr[-3000:]}")
                index, _, so_far = last.read_text().partition(" ")
                total.update(json.loads(so_far))
                total["crash"] += 1
                first.setdefault("crash", int(index))
                start = int(index) + 1
                continue
            said = json.loads(done.stdout.splitlines()[-1])  # decoders print words of their own
        total.update(said["found"])
        first = said["first"] | first
        slowest, memory = max(slowest, said["slowest"]), max(memory, said["memory"])
        start = stop
    bad = {f"{word} ({n}, first {first.get(word)})" for word, n in total.items() if word not in (READ, REFUSED)}
    over = ["over 1 GiB"] if memory > MEMORY else []
    print(
        f"{target.name:18s} {total.total():7,} {total[REFUSED]:7,} {total[READ]:7,} "
        f"{total.total() - total[REFUSED] - total[READ]:7,} {slowest:8.2f} {memory / 1e6:8.0f}   "
        + "; ".join([*sorted(bad), *over]),
        flush=True,
    )
    return not bad and not over


def main(targets: Sequence[Target], script: str, description: str | None) -> int:
    """The command line of a `fuzz_*.py`: attacks all of its targets, or some, or one attack of one again."""
    known = {target.name: target for target in targets}
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=2000, help="attacks a target")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="+", choices=known, default=list(known))
    parser.add_argument("--again", type=int, help="this attack alone, with its traceback")
    parser.add_argument("--work", nargs=4, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.work:
        name, start, stop, folder = options.work
        _work(known[name], int(start), int(stop), options.seed, Path(folder))
        return 0
    if options.again is not None:
        return _again(known[options.only[0]], options.again, options.seed)
    print(f"{'target':18s} {'attacks':>7s} {'refused':>7s} {'read':>7s} {'foreign':>7s} {'s':>8s} {'MB':>8s}")
    fine = [_run(known[name], script, options.count, options.seed) for name in options.only]
    return int(not all(fine))


def _again(target: Target, index: int, seed: int) -> int:
    with tempfile.TemporaryDirectory() as folder:
        sample, scratch = Path(folder, "sample"), Path(folder, "scratch")
        sample.mkdir()
        scratch.mkdir()
        target.make(sample)
        warnings.simplefilter("error")
        try:
            target.attack(sample, scratch, random.Random(f"{target.name} {seed} {index}"))()
        except Exception:
            traceback.print_exc()
    return 0
