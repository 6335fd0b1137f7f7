"""Kills a run again and again: in the end each job has one good record, and every file is that of an undisturbed run.

    python tests/bench/kill.py [--kills 20] [--workers here|processes|dask] [--seed 0] [--quick]

`here` and `processes` kill the whole run (`kill -9`) at random moments and start it again in the same folder; `dask`
kills one of the two workers of a local cluster in the middle of a job each time, and starts nothing again. Exit code 1
where anything is lost, doubled, different or left behind.
"""

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from bench import records, timing
from bench.runs import evaluation, executors, runner
from bench.runs.executors import Workers
from bench.runs.job import FACTS
from bench.runs.runner import Options
from bench.runs.suite import Suite, parse_suite
from bench.training import fitting as training

if TYPE_CHECKING:
    from distributed import LocalCluster

# Worker processes import this file, too.
training.KEEP_EVERY, training.SAVE_SECONDS = 20, 0.0  # so that short fits are killed with a state to go on from
timing.TURNS = 3  # what is timed does not matter here
evaluation.DRAWN_FLOATS = 0  # to record a program for a page takes a second a job

SUITE = """
threads = 1
seeds = [0, 1, 2]
materials = ["satin", "leather"]
data = {size = 16, views = 9, lights = 9, heldout = 10}
codecs = [
    {codec = "mean-colour"},
    {codec = "pca"},
    {codec = "neubtf-direct", steps = 300},
    {codec = "rainer2019", steps = 200},
]
"""  # 24 jobs
QUICK = SUITE.replace("[0, 1, 2]", "[0]").replace(', "leather"', "").replace("steps = 300", "steps = 100")
QUICK = QUICK.replace('    {codec = "rainer2019", steps = 200},\n', "")  # 3 jobs
# Of a record: what two runs need not share.
OWN = ("run", "fit_seconds", "fit_memory", "history", "fit_cached", "machine", "fitted", "scored")

Place = Callable[[], AbstractContextManager[Workers]]


def start(suite: Suite, folder: Path, workers: Place) -> int:
    """A run in a process of its own, forked so that nothing is imported again; its process id."""
    process = os.fork()
    if process:
        return process
    os._exit(go_on(suite, folder, workers))


def go_on(suite: Suite, folder: Path, workers: Place) -> int:
    """The run in this process; 0 where it comes to its end."""
    try:
        for _ in runner.run(suite, Options(folder, workers=workers)):
            pass
    except BaseException:
        traceback.print_exc()
        return 1
    return 0


def finish(process: int) -> None:
    code = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
    if code:
        sys.exit(f"a run that nobody killed ended with {code}")


def killed_run(suite: Suite, folder: Path, workers: Place, kills: int, span: float, rng: random.Random) -> None:
    """The run, killed after up to `span` seconds, so many times, and then left to end."""
    for kill in range(1, kills + 1):
        process = start(suite, folder, workers)
        delay = rng.uniform(0, span)
        time.sleep(delay)
        os.kill(process, signal.SIGKILL)
        os.waitpid(process, 0)
        print(f"kill {kill} after {delay:.2f} s: {left(folder)}", flush=True)
    finish(start(suite, folder, workers))


def left(folder: Path) -> str:
    """What a kill left, in words."""
    done = len(job_lines(folder)) if (folder / records.FILE).exists() else 0
    states, halves = len(list(folder.glob("files/*.state"))), len(list(folder.glob("*/*.partial")))
    return f"{done} records, {states} states of fits, {halves} half-written files"


def dask_run(suite: Suite, folder: Path, kills: int, span: float, rng: random.Random) -> None:
    """The run on a local cluster of two workers, of which one is killed up to `span` seconds into a job each time."""
    import dask
    from distributed import Client, LocalCluster

    patient = {
        # By default a job is given up whose worker was lost four times, even one that had not begun it.
        "distributed.scheduler.allowed-failures": 10 * kills,
        # A local cluster gives a worker up for good that is away this long after it was lost, be it for another kill.
        "distributed.deploy.lost-worker-timeout": "1h",
        # A worker on a busy machine is not lost.
        "distributed.scheduler.worker-ttl": None,
        "distributed.comm.timeouts.connect": "300s",
        "distributed.comm.timeouts.tcp": "300s",
    }
    with (
        dask.config.set(patient),
        LocalCluster(2, threads_per_worker=1, dashboard_address=":0") as cluster,
        Client(cluster) as client,
    ):
        # Not a fork, which would hold the cluster's sockets open.
        command = [sys.executable, __file__, "--coordinate", str(folder), cluster.scheduler_address]
        process = subprocess.Popen([*command, *sys.argv[1:]])
        done = 0
        for worker in busy_workers(cluster, process):
            time.sleep(rng.uniform(0, span))
            state = cluster.scheduler.workers.get(worker)
            if done < kills and state is not None and state.processing:
                os.kill(client.run(os.getpid, workers=[worker])[worker], signal.SIGKILL)
                done += 1
                print(f"kill {done} of a worker: {left(folder)}", flush=True)
    if done < kills:
        sys.exit(f"the run ended after {done} kills: give it longer fits")


def busy_workers(cluster: "LocalCluster", run: subprocess.Popen[bytes]) -> Iterator[str]:
    """The address of a worker that has a job, again and again until the run has ended."""
    while run.poll() is None:
        busy = [name for name, state in list(cluster.scheduler.workers.items()) if state.processing]
        if busy:
            yield busy[0]
        time.sleep(0.02)
    if run.returncode:
        sys.exit(f"the run ended with {run.returncode}")


def job_lines(folder: Path) -> list[records.Record]:
    """Every record of a job, also those that another took the place of."""
    lines = (json.loads(line) for line in (folder / records.FILE).read_bytes().splitlines())
    return [record for record in lines if record.get("kind") == "job"]


def contents(folder: Path) -> dict[str, bytes]:
    """What is in a run's folder by name, but records; of what says how long fits took, the name alone."""
    found = {}
    for path in folder.rglob("*"):
        if not path.is_file() or path.name == records.FILE:
            continue
        found[str(path.relative_to(folder))] = b"" if path.name.endswith(FACTS) else path.read_bytes()
    return found


def shared_part(folder: Path) -> dict[str, records.Record]:
    """What the record of each job says of what it is, not of when and where it was done."""
    return {job["job"]: {k: v for k, v in job.items() if k not in OWN} for job in records.load_run(folder).jobs}


def faults(folder: Path, undisturbed: Path, jobs: int) -> Iterator[str]:
    """What is wrong with a run that was killed."""
    lines = job_lines(folder)
    good = {record["job"] for record in lines if record["status"] == "ok"}
    if len(lines) != jobs or len(good) != jobs:
        yield f"{len(lines)} records of jobs, of {len(good)} good jobs; there should be {jobs}"
    said, wanted = shared_part(folder), shared_part(undisturbed)
    for job in sorted(said.keys() | wanted.keys()):
        one, other = said.get(job, {}), wanted.get(job, {})
        for part in sorted(one.keys() | other.keys()):
            if one.get(part) != other.get(part):
                yield f"{job}: {part} is {one.get(part)!r}, undisturbed {other.get(part)!r}"[:500]
    ours, theirs = contents(folder), contents(undisturbed)
    for name in sorted(ours.keys() ^ theirs.keys()):
        yield f"{name}: {'left behind' if name in ours else 'missing'}"
    for name in sorted(ours.keys() & theirs.keys()):
        if ours[name] != theirs[name]:
            yield f"{name}: differs"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--workers", choices=["here", "processes", "dask"], default="here")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--quick", action="store_true", help="3 jobs instead of 24")
    parser.add_argument("--coordinate", nargs=2, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    suite, rng = parse_suite("kill", QUICK if chosen.quick else SUITE), random.Random(chosen.seed)
    if chosen.coordinate:
        folder, address = chosen.coordinate
        return go_on(suite, Path(folder), partial(executors.dask, address, {}))
    jobs = len(suite.cells)
    with tempfile.TemporaryDirectory() as place:
        undisturbed, folder = Path(place) / "undisturbed", Path(place) / "killed"
        begun = time.monotonic()
        finish(start(suite, undisturbed, executors.in_process))
        seconds = time.monotonic() - begun
        print(f"undisturbed: {jobs} jobs in {seconds:.1f} s", flush=True)
        if chosen.workers == "dask":
            dask_run(suite, folder, chosen.kills, 1.5 * seconds / jobs, rng)
        else:
            workers = partial(executors.processes, 2, 1) if chosen.workers == "processes" else executors.in_process
            killed_run(suite, folder, workers, chosen.kills, 1.5 * seconds / chosen.kills, rng)
        found = list(faults(folder, undisturbed, jobs))
    print("\n".join(found) or f"{jobs} good records, identical files, nothing left behind")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
