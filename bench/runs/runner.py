"""Runs a suite: hands its jobs to workers, records what they answer, then times the decoders when nothing else runs.

This process alone writes records, under the lock of the run's folder. What a job is, and when it is done already, says
`bench.runs.job`; where it runs, `bench.runs.executors`. Timing is measured anew in every run.
"""

import dataclasses
import itertools
import logging
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import torch

from bench import atomic, records
from bench.codec import Codec, Fit, Progress, silent
from bench.codecs import container, shared
from bench.codecs.registry import from_outside, make_codec
from bench.data.spec import MaterialSpec
from bench.errors import CodecError, InputError
from bench.records import Record, Run
from bench.runs.executors import Workers, in_process, one_process
from bench.runs.job import FACTS, FRESH_STATE, STATE, Answer, Result, Stands, Task, WantsFiles, blamed, failed, work
from bench.runs.lock import locked
from bench.runs.pretraining import ready
from bench.runs.provenance import provenance
from bench.runs.rates import rate_records
from bench.runs.suite import Suite, canonical
from bench.runs.timed import timings
from bench.runs.workbench import demand_of

log = logging.getLogger(__name__)

MOST_LOSSES = 3  # worker processes that a job may lose


@dataclass(frozen=True)
class Options:
    """How to run, besides what: the run's folder, the device, where jobs run, what to do with what is there."""

    folder: Path
    device: str = "cpu"
    fresh: bool = False  # fit and score everything again
    retry_failed: bool = False
    show: Progress = silent
    workers: Callable[[], AbstractContextManager[Workers]] | None = None  # None: here, but codecs from outside


@dataclass(frozen=True)
class Outcome:
    """One job's record, and how much of it was taken from earlier runs: "", "file" or "record"."""

    record: Record
    cached: str = ""


def run(suite: Suite, options: Options) -> Iterator[Outcome]:
    """Run every job of a suite, yielding each as it ends. Records are on the disk before they are yielded."""
    suite = canonical(suite)
    codecs, faults = _made(suite)  # bad settings stop here
    if not suite.demand and (scene := next((codec.name for codec in codecs if codec.scene), "")):
        raise InputError(f"codec {scene}: scene = true needs the demand of a scene: give one with --demand")
    run_id = f"{datetime.now(UTC):%Y%m%dT%H%M%S.%f}"
    if suite.demand:
        demand_of(run_id, str(Path(suite.demand).absolute()))  # and so does what is no demand
    with locked(options.folder, run_id):
        _tidy(options.folder)
        session = _Session(suite, options, run_id, _networks(suite, codecs, options), faults)
        try:
            with (options.workers or _workers(suite))() as workers:
                session.start()
                yield from session.jobs(workers)
        finally:
            _tidy(options.folder)
        session.compare()


def _made(suite: Suite) -> tuple[list[Codec], dict[str, str]]:
    """The codecs of a suite, and why those that could not be made could not, by label: their jobs fail."""
    codecs, faults = [], {}
    for spec in suite.codecs:
        try:
            codecs.append(make_codec(spec.codec, spec.settings))
        except CodecError as error:
            faults[spec.label] = str(error)
    return codecs, faults


def _workers(suite: Suite) -> Callable[[], AbstractContextManager[Workers]]:
    """Where jobs run by default: here, or in a worker process where a codec of another distribution might end it."""
    if any(from_outside(spec.codec) for spec in suite.codecs):
        return partial(one_process, suite.threads)
    return in_process


def _networks(suite: Suite, codecs: list[Codec], options: Options) -> dict[str, tuple[str, bytes]]:
    """For each codec that shares a network over materials, where there is one: its file's name in files/, and content.

    Those that the suite has pretrained are made now where they are not there. The files are written into the run's
    folder, so that it decodes wherever it is copied to.
    """
    found: dict[str, tuple[str, bytes]] = {}
    for name, network in {codec.name: codec.network for codec in codecs}.items():
        if network and name in suite.pretrain:
            ready(network(), Fit(torch.device(options.device), suite.threads, show=options.show))
        if network and shared.place(name).exists():
            trained = shared.find(name)
            found[name] = (shared.hashed_name(name, trained.sha256), trained.path.read_bytes())
            atomic.write(options.folder / "files" / found[name][0], found[name][1])
    return found


def _tidy(folder: Path) -> None:
    """Remove what a killed process left half done and nobody goes on from."""
    for left in (*folder.glob(f"*/*{atomic.SUFFIX}"), *folder.glob(f"files/*{FRESH_STATE}")):
        left.unlink(missing_ok=True)
    for state in folder.glob(f"files/*{STATE}"):
        if state.with_suffix(container.SUFFIX).exists():
            state.unlink(missing_ok=True)


@dataclass
class _Session:
    """A run under way: its jobs, what was recorded before, and what was done."""

    suite: Suite
    options: Options
    run_id: str
    networks: dict[str, tuple[str, bytes]]  # by codec: see `_networks`
    faults: dict[str, str]  # by label: why a codec could not be made
    before: Run = field(init=False)
    done: dict[str, Record] = field(default_factory=dict)  # jobs that have a file, by name

    def __post_init__(self) -> None:
        folder = self.options.folder
        self.before = records.load_run(folder) if (folder / records.FILE).exists() else Run(folder)
        if bad := self.before.unreadable:
            lines = ", ".join(map(str, bad[:10])) + (", …" if len(bad) > 10 else "")
            log.warning("%s: %d line(s) are no records and are skipped: %s", folder / records.FILE, len(bad), lines)

    def record(self, record: Record) -> None:
        records.append(self.options.folder, record)

    @cached_property
    def tasks(self) -> list[Task]:
        """The jobs in the order of the suite."""
        suite, options = self.suite, self.options
        fixed: dict[str, Any] = {"run": self.run_id, "folder": options.folder.absolute(), "data": suite.data}
        fixed |= {"demand": str(Path(suite.demand).absolute()) if suite.demand else "", "uniform": suite.uniform}
        fixed["metrics"] = suite.metrics
        fixed |= {"threads": suite.threads, "device": options.device, "fresh": options.fresh}
        return [Task(material=_anywhere(m), codec=c, repetition=seed, **fixed) for m, c, seed in suite.cells]

    def start(self) -> None:
        """Record what is run, and where: its jobs by name, as they end in another order."""
        suite = self.suite
        says: Record = {"kind": "run", "run": self.run_id, "suite": suite.name, "text": suite.text}
        says |= {"device": self.options.device, "threads": suite.threads, "seeds": list(suite.seeds)}
        self.record(says | {"jobs": [task.name for task in self.tasks]} | provenance())

    def jobs(self, workers: Workers) -> Iterator[Outcome]:
        """Each job's outcome as it ends, recorded."""
        scorers = None if workers.at_once == 1 else self.suite.threads
        # Repetition after repetition, as each opens its material with other test pairs.
        names = [material.name for material in self.suite.materials]
        order = sorted(self.tasks, key=lambda task: (names.index(task.material.name), task.repetition))
        sound = [task for task in order if task.codec.label not in self.faults]
        told = (dataclasses.replace(task, scorers=scorers, **self._told(task)) for task in sound)
        done = _results(told, workers, partial(work, show=self.options.show) if workers.here else work)
        unsound = [task for task in order if task.codec.label in self.faults]
        results = itertools.chain(((task, failed(task, self.faults[task.codec.label])) for task in unsound), done)
        for count, (task, result) in enumerate(results, 1):
            outcome = self._outcome(task, result)
            self.options.show("jobs", count, len(self.tasks))
            if outcome.record["status"] == "ok":
                self.done[task.name] = outcome.record
            yield outcome

    def _told(self, task: Task) -> dict[str, Any]:
        """What a worker cannot look up."""
        return {"earlier": self._earlier(task.name), "network": self.networks.get(task.codec.codec)}

    def _earlier(self, name: str) -> Record | None:
        """What a worker needs of a job's latest record to see whether it stands; None where it does not."""
        found = self.before.job(name)
        if found is None or self.options.fresh:
            return None
        if found["status"] == "failed" and self.options.retry_failed:
            return None
        if found["status"] == "ok" and not (self.options.folder / found["file"]).exists():
            return None
        return {key: found[key] for key in ("status", "fit_key", "score_key", "file") if key in found}

    def _outcome(self, task: Task, result: Result | Stands) -> Outcome:
        """Store what a worker sent, files first, and record it."""
        if isinstance(result, Stands):
            known = self.before.job(task.name)
            assert known is not None, "a worker takes as recorded only what it was told of"
            return Outcome(known, "record")
        for name, content in result.files.items():
            atomic.write(self.options.folder / name, content)
        self.record(result.record)
        return Outcome(result.record, result.cached)

    def compare(self) -> None:
        """Time the decoders of each material in turns, and set its ladders of rates against each other."""
        timed = self._can_time()
        for material in self.suite.materials:
            names = [task.name for task in self.tasks if task.material.name == material.name]
            jobs = [self.done[name] for name in names if name in self.done]
            if jobs and timed:
                self._time(jobs)
            for record in rate_records(jobs):
                self.record(record | {"material": material.name, "run": self.run_id})

    def _can_time(self) -> bool:
        if torch.device(self.options.device).type != "cuda" or torch.cuda.is_available():
            return True
        log.warning("no decoder is timed, as there is no GPU here: give the same command on a machine that has one")
        return False

    def _time(self, jobs: list[Record]) -> None:
        for record in timings(self.options.folder, jobs, self.options.device, self.suite.threads):
            self.record(record | {"run": self.run_id})


def _anywhere(material: MaterialSpec) -> MaterialSpec:
    """The material by a path that does not depend on where a process was started."""
    here = Path(material.path)
    return dataclasses.replace(material, path=str(here.absolute())) if material.path and here.exists() else material


def _results(
    tasks: Iterator[Task], workers: Workers, call: Callable[[Task], Answer]
) -> Iterator[tuple[Task, Result | Stands]]:
    """Each task with its result as it ends; one that lost its worker is started again, some times."""
    waiting: dict[Future[Answer], Task] = {}
    again: deque[Task] = deque()
    try:
        while True:
            while len(waiting) < workers.at_once and (task := again.popleft() if again else next(tasks, None)):
                waiting[workers.executor.submit(call, task)] = task
            if not waiting:
                return
            for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                task = waiting.pop(future)
                answer = _answer(task, future)
                del future  # while it is held, a cluster computes again what it loses, though it was answered
                if isinstance(answer, Task):
                    again.append(answer)
                else:
                    yield task, answer
    finally:
        for future in waiting:
            future.cancel()


def _answer(task: Task, future: Future[Answer]) -> Result | Stands | Task:
    """What a worker answered, or the task to be started again. `InputError` where going on is no use."""
    try:
        result = future.result()
    except BrokenExecutor:
        if task.losses + 1 < MOST_LOSSES:
            log.warning("%s: its worker died; it is started again", task.name)
            return dataclasses.replace(task, losses=task.losses + 1)
        why = f"{MOST_LOSSES} workers died of it, one after the other: killed, or out of memory?"
        return failed(task, blamed(task, why))
    except InputError:
        raise
    except CancelledError:
        raise InputError("the scheduler is gone: start it again, then give the same command") from None
    except Exception as error:  # the executor's own: what a codec raises is in its record
        return failed(task, blamed(task, f"{type(error).__name__}: {error}"))
    if isinstance(result, WantsFiles):
        assert task.earlier is not None, "a worker asks for the files of what it was told of"
        return dataclasses.replace(task, sent=_files_of(task.folder, task.earlier["file"]))
    return result


def _files_of(folder: Path, name: str) -> dict[str, bytes]:
    """A codec file and what is beside it of its fit, by name."""
    beside = str(Path(name).with_suffix(FACTS))
    return {each: (folder / each).read_bytes() for each in (beside, name) if (folder / each).exists()}
