"""What many jobs cost: eight fits on two workers against one, the runner's own time a job, opening 10,000 records.

    python benchmarks/scaling.py fits [--steps 3000] [--rounds 1] | overhead | records

`fits` wants a machine with two cores that have nothing else to do.
"""

import argparse
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bench import records
from bench.runs import executors, job, runner
from bench.runs.executors import Workers
from bench.runs.runner import Options
from bench.runs.suite import Suite, parse_suite

DATA = "data = {size = 32, views = 16, lights = 16, heldout = 20}"
FITS = f'seeds = [0, 1, 2, 3, 4, 5, 6, 7]\nmaterials = ["satin"]\n{DATA}\ncodecs = [{{codec = "neubtf-direct"}}]'
SHORT = f'seeds = {list(range(20))}\nmaterials = ["satin"]\n{DATA}\ncodecs = [{{codec = "mean-colour"}}]'
RECORDS = 10_000

Place = Callable[[], AbstractContextManager[Workers]]


def endings(suite: Suite, workers: Place) -> Iterator[float]:
    """When each job of a new run ended, in seconds since the run began; nothing is timed or reported after them."""
    with tempfile.TemporaryDirectory() as folder:
        begun = time.perf_counter()
        outcomes = runner.run(suite, Options(Path(folder), workers=workers))
        for _ in suite.seeds:
            assert next(outcomes).record["status"] == "ok"
            yield time.perf_counter() - begun
        outcomes.close()


def measure_fits(steps: int, rounds: int) -> None:
    """Time of 8 fits, each of one thread, on two worker processes over that on one, both from their very start."""
    suite = parse_suite("fits", FITS.replace('direct"', f'direct", steps = {steps}'))
    next(endings(parse_suite("short", SHORT), executors.in_process))  # renders the material
    for _ in range(rounds):
        two, one = (max(endings(suite, partial(executors.processes, count, 1))) for count in (2, 1))
        print(f"8 fits of {steps} steps: {one:.1f} s on one worker, {two:.1f} s on two: {two / one:.3f} ×", flush=True)


def clocks() -> np.ndarray:
    """Seconds of the clock and of the processor; a busy machine stretches the former."""
    return np.array([time.perf_counter(), time.process_time()])


class Stopwatch:
    """What is spent inside some functions, by both clocks."""

    def __init__(self) -> None:
        self.spent = np.zeros(2)

    def on(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*args: Any, **kwargs: Any) -> Any:
            begun = clocks()
            try:
                return function(*args, **kwargs)
            finally:
                self.spent += clocks() - begun

        return timed


def measure_overhead() -> None:
    """What a job takes besides encoding and scoring, in this process; and from one end to the next in a worker."""
    suite, watch = parse_suite("short", SHORT), Stopwatch()
    kept = job.Job._encode, job.evaluate
    job.Job._encode, job.evaluate = map(watch.on, kept)  # type: ignore[method-assign]
    ends = endings(suite, executors.in_process)
    next(ends)  # opens the material
    begun, watch.spent = clocks(), np.zeros(2)
    count = len(list(ends))
    work, besides = 1e3 * watch.spent / count, 1e3 * (clocks() - begun - watch.spent) / count
    print(f"a job, in process: {work[0]:.1f} ms ({work[1]:.1f} ms CPU) of encoding and scoring; "
          f"besides {besides[0]:.1f} ms ({besides[1]:.1f} ms CPU)")  # fmt: skip
    job.Job._encode, job.evaluate = kept  # type: ignore[method-assign]
    ends = list(endings(suite, partial(executors.processes, 1, 1)))
    print(f"a job, in a worker process: {1e3 * float(np.median(np.diff(ends))):.1f} ms from end to end")


def measure_records() -> None:
    """Opening a run of 10,000 jobs and as many timings."""
    with tempfile.TemporaryDirectory() as place:
        small, large = Path(place) / "small", Path(place) / "large"
        suite = parse_suite("one", SHORT.replace(str(list(range(20))), "[0]"))
        kept = next(iter(runner.run(suite, Options(small)))).record
        list(runner.run(suite, Options(small)))
        timing = records.load_run(small).timings[0]
        large.mkdir()
        with open(large / records.FILE, "wb") as file:
            for number in range(RECORDS):
                file.write(records.lines._line(kept | {"job": f"material {number}/codec/0"}))
                file.write(records.lines._line(timing | {"job": f"material {number}/codec/0"}))
        taken = []
        for _ in range(5):
            begun = time.perf_counter(), time.process_time()
            records.load_run(large)
            taken.append((time.perf_counter() - begun[0], time.process_time() - begun[1]))
        size, best = (large / records.FILE).stat().st_size, min(taken)
        print(
            f"{RECORDS} jobs and as many timings, {size / 1e6:.0f} MB: opened in {best[0]:.2f} s ({best[1]:.2f} s CPU)"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["fits", "overhead", "records"])
    parser.add_argument("--steps", type=int, default=3000)
    parser.add_argument("--rounds", type=int, default=1)
    chosen = parser.parse_args()
    if chosen.what == "fits":
        measure_fits(chosen.steps, chosen.rounds)
    else:
        {"overhead": measure_overhead, "records": measure_records}[chosen.what]()


if __name__ == "__main__":
    main()
