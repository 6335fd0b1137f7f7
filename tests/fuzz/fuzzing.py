"""Runs attacks on whatever reads files and counts how they end; `fuzz_*.py` say what is attacked, and how.

Each target runs in processes of its own, under a limit of address space, so that a crash in a decoder is seen and
counted. An attack that ends in an `InputError` of one line is refused, one that gives an answer is read; whatever else
is raised is foreign. Exit code 1 where anything is foreign, takes over two seconds of the processor, or over 1 GiB.
"""

import argparse
import io
import json
import random
import resource
import signal
import struct
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
import zipfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.inputs.errors import InputError

SECONDS, MEMORY, CHUNK = 2.0, 1 << 30, 500
READ, REFUSED = "read", "refused"
TOKENS = (b"nan", b"-1", b"1e999", b"", b"../../etc/passwd", b",", b"\n", b"\xff", b"\0", b"9" * 5000, b"(", b"'", b'"')
NUMBERS = (0, 1, 2, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 1 << 20, 1 << 24)
NESTED = (b"[" * 2000 + b"1" + b"]" * 2000, b'{"a":' * 2000 + b"1" + b"}" * 2000)
SIDES = (-300, -1, 0, 1, 2, 3, 4, 9, 255, 65_536, 10**6, 1 << 31, 1 << 40, 1 << 62, 10**30)
TYPES = ("<f4", ">f8", "<f2", "<U0", "|S0", "|V0", "<U9", "|O", "|b1", "|u1", "<i8", "<c8", "<M8[s]", "nonsense")
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


def damaged(data: bytes, rng: random.Random) -> bytes:
    """Bytes damaged in one to four places; half of the places lie in the first 512 bytes, where headers are."""
    out = bytearray(data)
    for _ in range(rng.randint(1, 4)):
        at = 0
        if out:
            reach = min(len(out), 512) if rng.random() < 0.5 else len(out)
            at = rng.randrange(reach)
        kind = rng.randrange(8)
        if kind == 0:
            out[at : at + 1] = bytes([out[at] ^ 1 << rng.randrange(8)]) if out else b""
        elif kind == 1:
            out[at : at + 1] = rng.randbytes(1)
        elif kind == 2:
            out[at : at + 4] = struct.pack(rng.choice("<>") + "I", rng.choice(NUMBERS))
        elif kind == 3:
            del out[at : at + rng.randint(1, 64)]
        elif kind == 4:
            out[at:at] = out[at : at + rng.randint(1, 64)]
        elif kind == 5:
            out[at : at + rng.randrange(8)] = rng.choice(NESTED if rng.random() < 0.1 else TOKENS)
        elif kind == 6:
            out[at : at + 8] = struct.pack("<d", rng.choice((float("nan"), float("inf"), -1e300, 1e-300)))
        elif rng.random() < 0.3:
            del out[at:]
    return bytes(out)


def with_other_header(content: bytes, rng: random.Random) -> bytes:
    """The bytes of an array under the header of another shape or type."""
    stream = io.BytesIO(content)
    np.lib.format.read_magic(stream)
    shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
    sides = list(shape) or [1]
    for _ in range(rng.randint(1, 2)):
        sides[rng.randrange(len(sides))] = rng.choice(SIDES)
    kind = dtype.str if rng.random() < 0.5 else rng.choice(TYPES)
    text = repr({"descr": kind, "fortran_order": rng.random() < 0.5, "shape": tuple(sides)}).encode()
    head = np.lib.format.magic(1, 0) + struct.pack("<H", len(text) + 1) + text + b"\n"
    return head + (stream.read() if rng.random() < 0.7 else b"")


def repacked(path: Path, rng: random.Random, bad: Callable[[str, bytes, random.Random], bytes]) -> None:
    """Damage an entry or two of an archive, or drop one, and pack it anew, with sound checksums."""
    with zipfile.ZipFile(path) as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    for name in {rng.choice(list(entries)) for _ in range(rng.randint(1, 2))}:
        entries[name] = bad(name, entries[name], rng)
    if rng.random() < 0.05:
        entries.popitem()
    with zipfile.ZipFile(path, "w", rng.choice((zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED))) as archive:
        for name, content in entries.items():
            archive.writestr(name, content)


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
