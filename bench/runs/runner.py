"""Runs a suite: hands its jobs to workers, records their answers, then times the decoders when nothing else runs.

Only this process writes records, under the lock of the run's folder. `bench.runs.job` defines a job and decides whether
it is done already; `bench.runs.executors` defines where it runs. Every run measures the timing again.
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

from bench import atomic, records
from bench.codec import REMARK, Codec, Progress, silent
from bench.codecs import container, shared
from bench.codecs.command import Programs, permit
from bench.codecs.registry import from_outside, make_codec
from bench.data.spec import MaterialSpec
from bench.demand import require_demand
from bench.devices import present
from bench.errors import CodecError, InputError, MissingDataError
from bench.records import Record, Run
from bench.runs.estimate import Estimate
from bench.runs.executors import Workers, in_process, processes
from bench.runs.job import FACTS, FRESH_STATE, STATE, Answer, Result, Stands, WantsFiles, attributed, failed, work
from bench.runs.lock import locked
from bench.runs.provenance import provenance
from bench.runs.suite import Suite, canonical
from bench.runs.task import Task
from bench.runs.timed import timings
from bench.runs.workbench import demand_of

log = logging.getLogger(__name__)

MOST_LOSSES = 3  # worker processes that a job may lose


@dataclass(frozen=True)
class Options:
    """How to run a suite: the run's folder, the device, where jobs run, and whether to reuse earlier results."""

    folder: Path
    device: str = "cpu"
    fresh: bool = False  # fit and score everything again
    retry_failed: bool = False
    show: Progress = silent
    say: Callable[[str], None] = lambda text: None  # gets a message before the first job: jobs and time left
    workers: Callable[[], AbstractContextManager[Workers]] | None = None  # None: see `_workers`


@dataclass(frozen=True)
class Outcome:
    """One job's record, and what was reused from earlier runs: "" (nothing), "file" or "record"."""

    record: Record
    cached: str = ""
    progress: str = ""  # the progress of the run after it, in words


def run(suite: Suite, options: Options) -> Iterator[Outcome]:
    """Run every job of a suite; yields each outcome after its record is on the disk."""
    suite = canonical(suite)
    codecs, faults = _make_codecs(suite)  # bad settings stop here
    for codec in codecs:
        require_demand(codec, suite.demand)
    run_id = f"{datetime.now(UTC):%Y%m%dT%H%M%S.%f}"
    if suite.demand:
        demand_of(run_id, str(Path(suite.demand).absolute()))  # a bad demand file stops here
    with locked(options.folder, run_id):
        _tidy(options.folder)
        session = _Session(suite, options, run_id, _networks(codecs, options), faults)
        try:
            with (options.workers or _workers(suite))() as workers:
                session.start()
                yield from session.jobs(workers)
        finally:
            _tidy(options.folder)
        session.time()


def _make_codecs(suite: Suite) -> tuple[list[Codec], dict[str, str]]:
    """The codecs of a suite, and by label the errors of those that could not be made, whose jobs fail."""
    codecs, faults = [], {}
    for spec in suite.codecs:
        try:
            codec = make_codec(spec.codec, spec.settings)
        except CodecError as error:
            faults[spec.label] = str(error)
            continue
        if isinstance(codec, Programs):
            permit(codec.settings.decode)
        codecs.append(codec)
    return codecs, faults


def _workers(suite: Suite) -> Callable[[], AbstractContextManager[Workers]]:
    """The default workers: this process, or a worker process if a codec of another distribution might crash."""
    if any(from_outside(spec.codec) for spec in suite.codecs):
        return partial(processes, 1, suite.threads)
    return in_process


def _networks(codecs: list[Codec], options: Options) -> dict[str, tuple[str, bytes]]:
    """The network file of each codec that shares a network over materials: its name in files/ and its content.

    Missing ones are left out. Writes the files into the run's folder, so that the folder can be decoded wherever it is
    copied.
    """
    networks: dict[str, tuple[str, bytes]] = {}
    for name, codec in {codec.name: codec for codec in codecs}.items():
        try:
            trained = shared.find_for(codec)
        except MissingDataError:
            continue  # each of its jobs fails with this reason
        if trained:
            networks[name] = (shared.hashed_name(name, trained.sha256), trained.path.read_bytes())
            atomic.write(options.folder / "files" / networks[name][0], networks[name][1])
    return networks


def _tidy(folder: Path) -> None:
    """Remove the temporary files of killed processes, and checkpoints that no fit resumes from."""
    for left in (*folder.glob(f"*/*{atomic.SUFFIX}"), *folder.glob(f"files/*{FRESH_STATE}")):
        left.unlink(missing_ok=True)
    for state in folder.glob(f"files/*{STATE}"):
        if state.with_suffix(container.SUFFIX).exists():
            state.unlink(missing_ok=True)


@dataclass
class _Session:
    """A run in progress: its jobs, the records from before, and the finished jobs."""

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
            log.warning("%s: skipped %d line(s) that are not records: %s", folder / records.FILE, len(bad), lines)

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
        """Record the start of the run: suite, machine, and the names of its jobs, which may end in another order."""
        suite = self.suite
        record: Record = {"kind": "run", "run": self.run_id, "suite": suite.name, "text": suite.text}
        record |= {"device": self.options.device, "threads": suite.threads, "seeds": list(suite.seeds)}
        record |= {"data": dataclasses.asdict(suite.data)}
        record |= {"materials": [dataclasses.asdict(material) for material in suite.materials]}
        self.record(record | {"jobs": [task.name for task in self.tasks]} | provenance())

    def jobs(self, workers: Workers) -> Iterator[Outcome]:
        """Run the jobs; records and yields the outcome of each as it ends."""
        scorers = None if workers.at_once == 1 else self.suite.threads
        # Sorted by repetition, because each repetition opens its material with other test pairs.
        names = [material.name for material in self.suite.materials]
        order = sorted(self.tasks, key=lambda task: (names.index(task.material.name), task.repetition))
        sound = [task for task in order if task.codec.label not in self.faults]
        call = partial(work, show=self.options.show) if workers.here else work
        done = _results((self._complete(task, scorers) for task in sound), workers, call)
        unsound = [task for task in order if task.codec.label in self.faults]
        results = itertools.chain(((task, failed(task, self.faults[task.codec.label])) for task in unsound), done)
        # Jobs whose records agree with their files are expected to hold.
        holds = {task.name for task in self.tasks if self._earlier(task.name) is not None}
        seats = workers.seats or (lambda: workers.at_once)
        estimate = Estimate(self.tasks, holds, self.options.folder.absolute(), seats)
        self.options.say(estimate.first)
        self.options.show("jobs", 0, len(self.tasks))
        for count, (task, result) in enumerate(results, 1):
            outcome = self._outcome(task, result)
            estimate.ended(outcome.record, outcome.cached)
            outcome = dataclasses.replace(outcome, progress=estimate.progress)
            self.options.show(f"jobs{REMARK}{estimate.left}" if estimate.left else "jobs", count, len(self.tasks))
            if outcome.record["status"] == "ok":
                self.done[task.name] = outcome.record
            yield outcome

    def _complete(self, task: Task, scorers: int | None) -> Task:
        """The task with the data that a worker cannot look up."""
        earlier, network = self._earlier(task.name), self.networks.get(task.codec.codec)
        return dataclasses.replace(task, scorers=scorers, earlier=earlier, network=network)

    def _earlier(self, name: str) -> Record | None:
        """The part of a job's latest record by which a worker sees whether it still holds; None if it does not."""
        record = self.before.job(name)
        if record is None or self.options.fresh:
            return None
        if record["status"] == "failed" and self.options.retry_failed:
            return None
        if record["status"] == "ok" and not (self.options.folder / record["file"]).exists():
            return None
        return {key: record[key] for key in ("status", "fit_key", "score_key", "file") if key in record}

    def _outcome(self, task: Task, result: Result | Stands) -> Outcome:
        """Store the files that a worker sent, then record its result."""
        if isinstance(result, Stands):
            known = self.before.job(task.name)
            assert known is not None, "a worker answers `Stands` only if it was sent an earlier record"
            return Outcome(known, "record")
        for name, content in result.files.items():
            atomic.write(self.options.folder / name, content)
        self.record(result.record)
        return Outcome(result.record, result.cached)

    def time(self) -> None:
        """Time the decoders of each material in turns."""
        if not present(self.options.device):
            remedy = "run the same command on a machine with a GPU"
            log.warning("no decoder is timed, because there is no GPU here: %s", remedy)
            return
        for material in self.suite.materials:
            names = [task.name for task in self.tasks if task.material.name == material.name]
            if jobs := [self.done[name] for name in names if name in self.done]:
                self._time(jobs)

    def _time(self, jobs: list[Record]) -> None:
        material, options = jobs[0]["material"], self.options
        show: Progress = lambda label, done, total: options.show(f"{material}: {label}", done, total)  # noqa: E731
        for record in timings(options.folder, jobs, options.device, self.suite.threads, show):
            self.record(record | {"run": self.run_id})


def _anywhere(material: MaterialSpec) -> MaterialSpec:
    """The material with an absolute path, which does not depend on a process's working directory."""
    here = Path(material.path)
    return dataclasses.replace(material, path=str(here.absolute())) if material.path and here.exists() else material


def _results(
    tasks: Iterator[Task], workers: Workers, call: Callable[[Task], Answer]
) -> Iterator[tuple[Task, Result | Stands]]:
    """Each task with its result as it ends; restarts a task that lost its worker, up to `MOST_LOSSES` times."""
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
                del future  # while it is held, a cluster recomputes a lost result, although it was already received
                if isinstance(answer, Task):
                    again.append(answer)
                else:
                    yield task, answer
    finally:
        for future in waiting:
            future.cancel()


def _answer(task: Task, future: Future[Answer]) -> Result | Stands | Task:
    """The answer of a worker, or the task to start again. `InputError` if the run cannot continue."""
    try:
        result = future.result()
    except BrokenExecutor:
        if task.losses + 1 < MOST_LOSSES:
            log.warning("%s: its worker died; the job is started again", task.name)
            return dataclasses.replace(task, losses=task.losses + 1)
        why = f"{MOST_LOSSES} workers died while they ran it, one after the other: killed, or out of memory?"
        return failed(task, attributed(task, why))
    except InputError:
        raise
    except CancelledError:
        raise InputError("the scheduler is gone: start it again, then give the same command") from None
    except Exception as error:  # an error of the executor: those of codecs are in their records
        return failed(task, attributed(task, f"{type(error).__name__}: {error}"))
    if isinstance(result, WantsFiles):
        assert task.earlier is not None, "a worker asks only for the files of an earlier record that it was sent"
        return dataclasses.replace(task, sent=_files_of(task.folder, task.earlier["file"]))
    return result


def _files_of(folder: Path, name: str) -> dict[str, bytes]:
    """A codec file and the facts of its fit, by name."""
    facts = str(Path(name).with_suffix(FACTS))
    return {each: (folder / each).read_bytes() for each in (facts, name) if (folder / each).exists()}
