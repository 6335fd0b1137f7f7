"""How long the light commands take to start: a process each, in turns with a bare Python, so that all fare alike.

    python benchmarks/startup.py [ROUNDS]

The promise is 0.3 s on a quiet machine. On a busy one the seconds say little; the ratio to the bare Python and the
time of the processor say more. The exit code is 1 where the latter alone exceeds the promise.
"""

import os
import statistics
import subprocess
import sys
import time

from bench.compare.reference import committed

PROMISE = 0.3
REFERENCE = str(committed("ci"))
COMMANDS = {
    "python -c pass": ["-c", "pass"],
    "import bench": ["-c", "import bench"],
    "--help": ["-m", "bench.cli", "--help"],
    "list": ["-m", "bench.cli", "list"],
    "compare ci ci": ["-m", "bench.cli", "compare", REFERENCE, REFERENCE],
}


def took(words: list[str]) -> tuple[float, float]:
    """Seconds on the clock and of the processor that a process took."""
    before, start = os.times(), time.perf_counter()
    subprocess.run([sys.executable, *words], stdout=subprocess.DEVNULL, check=True)
    seconds, after = time.perf_counter() - start, os.times()
    used = after.children_user - before.children_user + after.children_system - before.children_system
    return seconds, used


def main(rounds: int) -> int:
    """Measure and print."""
    turns = [[took(words) for words in COMMANDS.values()] for _ in range(rounds)]
    print(f"medians of {rounds} turns; the promise is {PROMISE} s on a quiet machine\n")
    print(f"{'':<16}{'seconds':>9}{'× bare':>9}{'processor':>11}")
    late = False
    for i, name in enumerate(COMMANDS):
        seconds = statistics.median(turn[i][0] for turn in turns)
        ratio = statistics.median(turn[i][0] / turn[0][0] for turn in turns)
        used = statistics.median(turn[i][1] for turn in turns)
        late |= used > PROMISE
        print(f"{name:<16}{seconds:>9.3f}{ratio:>9.2f}{used:>11.3f}")
    return int(late)


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else 15))
