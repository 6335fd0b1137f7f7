"""Runs a suite: hands its jobs to workers, records their answers, then times the decoders when nothing else runs.

A `Task` is what a worker gets of a job, and an `Outcome` what it answers: the job's record. Only this process writes
records, under the lock of the run's folder. `bench.runs.job` runs a job and decides whether it is done already;
`bench.runs.executors` defines where it runs. Every run measures the timing again.
"""

import dataclasses
import logging
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import torch

from bench import records, timing
from bench.codec import REMARK, Codec, Progress, silent
from bench.codecs import container, shared
from bench.codecs.command import Programs, permit_program
from bench.codecs.registry import from_outside, make_codec
from bench.codecs.scene_material import without_warnings
from bench.data.spec import MaterialSpec
from bench.demand import require_demand
from bench.files import atomic
from bench.inputs.errors import CodecError, InputError, MissingDataError
from bench.machine.devices import present
from bench.machine.threads import cores
from bench.material import Material
from bench.records import ARTEFACT, Job, Timing
from bench.runs import lock
from bench.runs.evaluation import material_of_job
from bench.runs.executors import Seats, Workers, in_process, processes, tell
from bench.runs.job import FRESH_STATE, STATE, Outcome, error_with_origin, failed_outcome, work
from bench.runs.provenance import new_run, start_of
from bench.runs.suite import CodecSpec, Suite, Task, canonical
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
    say: Callable[[str], None] = lambda text: None  # gets a message before the first job: how many are left
    workers: Seats | None = None  # None: see `_workers`


def run(suite: Suite, options: Options) -> Iterator[Outcome]:
    """Run every job of a suite, then time the decoders; yields each outcome after its record is on the disk.

    `InputError` if the suite, its demand or the folder cannot be used; a job that fails only has a record of its error.
    """
    suite = canonical(suite)
    if not suite.cells:
        raise InputError(f"suite {suite.name}: it has no jobs: name at least one material and one codec")
    codecs, faults = _make_codecs(suite)  # bad settings stop here
    for codec in codecs:
        require_demand(codec, suite.demand)
    run_id = new_run()
    if suite.demand:
        suite = dataclasses.replace(suite, demand=str(Path(suite.demand).absolute()))
        demand_of(run_id, suite.demand)  # a bad demand file stops here
    with lock.locked(options.folder, run_id):
        _tidy(options.folder)
        networks = _write_networks(codecs, options.folder)
        try:
            open_workers = _workers(suite, options)
            with open_workers() as workers:
                session = _Session(suite, options, run_id, networks, workers)
                session.start()
                yield from session.jobs(faults)
        finally:
            _tidy(options.folder)
        session.time()  # when the workers have ended, so that nothing else runs


def _make_codecs(suite: Suite) -> tuple[list[Codec], dict[str, str]]:
    """The codecs of a suite, and by label the errors of those that could not be made, whose jobs fail."""
    codecs = []
    faults = {}
    for spec in suite.codecs:
        try:
            codec = make_codec(spec.codec, spec.settings)
        except CodecError as error:
            faults[spec.label] = str(error)
            continue
        if isinstance(codec, Programs):  # only permitted programs are started; whoever gives the suite permits its own
            permit_program(codec.settings.decode)
        codecs.append(codec)
    return codecs, faults


def _workers(suite: Suite, options: Options) -> Seats:
    """The function that opens the workers of a run: the one of the options, if they have one.

    Else jobs run in this process, or in one worker process if a codec is of another distribution: it might crash.
    """
    if options.workers is not None:
        return options.workers
    if any(from_outside(spec.codec) for spec in suite.codecs):
        return partial(processes, count=1, threads=suite.threads)
    return in_process


def _write_networks(codecs: list[Codec], folder: Path) -> dict[str, str]:
    """For codecs that share one network over all materials, the network's file in the run's folder, by codec.

    Writes these files: workers read them, and a folder that is copied elsewhere can still be decoded. Networks that are
    missing on this machine are left out.
    """
    networks: dict[str, str] = {}
    one_of_each = {codec.name: codec for codec in codecs}  # all settings of a codec share one network
    for name, codec in one_of_each.items():
        try:
            trained = shared.find_for(codec)
        except MissingDataError:
            continue  # each of its jobs fails with this reason
        if trained is not None:  # None: the codec shares no network
            networks[name] = f"files/{shared.hashed_name(name, trained.sha256)}"
            atomic.write(folder / networks[name], trained.path.read_bytes())
    return networks


def _tidy(folder: Path) -> None:
    """Remove the temporary files of killed processes, and checkpoints that no fit resumes from: those of a run with
    `fresh`, and those beside a finished file."""
    for useless in (*folder.glob(f"*/*{atomic.SUFFIX}"), *folder.glob(f"files/*{FRESH_STATE}")):
        useless.unlink(missing_ok=True)
    for state in folder.glob(f"files/*{STATE}"):
        if state.with_suffix(container.SUFFIX).exists():
            state.unlink(missing_ok=True)


class _Session:
    """A run in progress: its jobs, with their records from before, and the finished jobs."""

    def __init__(self, suite: Suite, options: Options, run_id: str, networks: dict[str, str], workers: Workers):
        """Load the records of earlier runs, with a warning if lines are damaged, and make the tasks."""
        self.suite = suite
        self.options = options
        self.run_id = run_id
        self.networks = networks
        self.workers = workers
        self.before = records.run_so_far(options.folder)
        # In the order of the suite; a cell is a material, a codec and a seed.
        self.tasks = [self._task(material, codec, seed) for material, codec, seed in suite.cells]
        self.done: dict[str, Job] = {}  # jobs that have a file, by name

    def _task(self, material: MaterialSpec, codec: CodecSpec, repetition: int) -> Task:
        """The task of one cell of the suite, with absolute paths: a worker may have another working directory."""
        suite = self.suite
        options = self.options
        scorers: int | None = suite.threads
        if self.workers.at_once == 1:  # the only job may score on all cores
            scorers = None
        task = Task(
            run=self.run_id,
            folder=options.folder.absolute(),
            material=_with_absolute_path(material),
            data=suite.data,
            codec=codec,
            repetition=repetition,
            threads=suite.threads,
            demand=suite.demand,
            uniform=suite.uniform,
            metrics=suite.metrics,
            only_material=len(suite.materials) == 1,
            device=options.device,
            scorers=scorers,
            fresh=options.fresh,
            network=self.networks.get(codec.codec, ""),
        )
        return dataclasses.replace(task, earlier=self._record_that_may_hold(task.name))

    def _record_that_may_hold(self, name: str) -> Job | None:
        """The latest record of a job, if it may still hold; None if the job is to be done again in any case."""
        options = self.options
        record = self.before.job(name)
        if record is None or options.fresh:
            return None
        if record["status"] == "failed" and options.retry_failed:
            return None
        if record["status"] == "ok" and not (options.folder / record["file"]).exists():
            return None
        stored = [record.get(field) for field in records.field_names(ARTEFACT)]
        if any(isinstance(file, str) and not (options.folder / file).exists() for file in stored):
            return record | {"score_key": {}}  # matches none: the file is scored again, which stores them again
        return record

    def start(self) -> None:
        """Record the start of the run, with the names of its jobs, which may end in another order."""
        jobs = [task.name for task in self.tasks]
        records.append(self.options.folder, start_of(self.suite, self.run_id, self.options.device, jobs))

    def jobs(self, faults: dict[str, str]) -> Iterator[Outcome]:
        """Run the jobs; records and yields the outcome of each as it ends. `faults`: see `_make_codecs`."""
        total = len(self.tasks)
        waiting = {task.name for task in self.tasks}
        recorded = {task.name for task in self.tasks if task.earlier}  # whose records may still hold, in no time
        self.options.say(f"{len(waiting - recorded)} of {total} jobs to do")
        self.options.show("jobs", 0, total)
        at_once = min(self.workers.at_once, cores())
        start = time.monotonic()
        fitted = 0
        for count, outcome in enumerate(self._outcomes(faults), 1):
            name = outcome.record["job"]
            waiting.discard(name)
            if outcome.cached != "record":
                records.append(self.options.folder, outcome.record)
                if name in recorded:
                    recorded = set()  # code or data changed since, so the other records will not hold either
            if outcome.record["status"] == "ok":
                self.done[name] = outcome.record
                fitted += not outcome.cached
            left = _time_left(time.monotonic() - start, fitted, len(waiting - recorded), at_once)
            label, progress = "jobs", f"{count} of {total} jobs"
            if left:
                label += f"{REMARK}{left}"
                progress += f", {left}"
            self.options.show(label, count, total)
            yield dataclasses.replace(outcome, progress=progress)

    def _outcomes(self, faults: dict[str, str]) -> Iterator[Outcome]:
        """The outcome of each job as it ends; first of those whose codec could not be made."""
        # A worker keeps one material open, so jobs are sorted by material; the first seed of every codec comes first.
        names = [material.name for material in self.suite.materials]
        in_order = sorted(self.tasks, key=lambda task: (names.index(task.material.name), task.repetition))
        runnable = []
        for task in in_order:
            fault = faults.get(task.codec.label)
            if fault:
                # A key that never matches: once the codec can be made, the job is tried again.
                yield failed_outcome(task, fault, {"fit_key": {}})
            else:
                runnable.append(task)
        self.workers.show_with(self.options.show)
        show: Progress = tell  # from another process, to this one
        if self.workers.here:
            show = self.options.show
        yield from _with_restarts(runnable, self.workers, partial(work, show=show))

    def time(self) -> None:
        """Time the decoders of each material in turns, and write the records."""
        if not present(self.options.device):
            remedy = "run the same command on a machine with a GPU"
            log.warning("no decoder is timed, because there is no GPU here: %s", remedy)
            return
        for material in self.suite.materials:
            jobs = self._jobs_to_time(material)
            show = partial(self._show_timing, material.name)
            for record in timings(self.options.folder, jobs, self.options.device, self.suite.threads, show):
                records.append(self.options.folder, record | {"run": self.run_id})

    def _jobs_to_time(self, material: MaterialSpec) -> list[Job]:
        """The jobs on a material whose decoders are timed: for each codec with its settings the first seed that has a
        file, since the time does not depend on the seed."""
        jobs: dict[str, Job] = {}  # by label
        for task in self.tasks:
            if task.material.name == material.name and task.name in self.done:
                jobs.setdefault(task.codec.label, self.done[task.name])
        return list(jobs.values())

    def _show_timing(self, material: str, label: str, done: int, total: int) -> None:
        """Show the progress of timing, with the name of the material before the label."""
        self.options.show(f"{material}: {label}", done, total)


def _time_left(seconds: float, fitted: int, left: int, at_once: int) -> str:
    """About how long the jobs that are `left` take, in words; "" while none is fitted, and after the last one.

    In `seconds` so many were fitted, `at_once` side by side: when the first of these has ended, so have most others.
    """
    if not fitted or not left:
        return ""
    minutes = max(1, round(seconds / max(fitted, at_once) * left / 60))
    return f"about {minutes} min left" if minutes < 100 else f"about {minutes / 60:.0f} h left"


def _with_absolute_path(material: MaterialSpec) -> MaterialSpec:
    """A material with an absolute path, if it has one that exists as written; others lie under `NEUBTF_DATA`."""
    place = Path(material.path)
    if not material.path or not place.exists():  # a built-in material has no path
        return material
    return dataclasses.replace(material, path=str(place.absolute()))


def _with_restarts(tasks: list[Task], workers: Workers, call: Callable[[Task], Outcome]) -> Iterator[Outcome]:
    """The outcome of each task as it ends: what `call` answers for it in a worker.

    A task that loses its worker starts again, until it has lost `MOST_LOSSES` workers.
    """
    waiting = deque(tasks)
    running: dict[Future[Outcome], Task] = {}
    try:
        while waiting or running:
            # Further tasks would only queue at the workers, and be lost with them.
            while waiting and len(running) < workers.at_once:
                task = waiting.popleft()
                running[workers.executor.submit(call, task)] = task
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                task = running.pop(future)
                died = not future.cancelled() and isinstance(future.exception(), BrokenExecutor)
                if died and task.losses + 1 < MOST_LOSSES:
                    log.warning("%s: its worker died; the job is started again", task.name)
                    waiting.appendleft(dataclasses.replace(task, losses=task.losses + 1))
                else:
                    yield _outcome_of_future(task, future)
                del future  # while it is held, a cluster recomputes a lost result, although it was already received
    finally:  # also where the caller stops early: jobs that have not begun do not run
        for future in running:
            future.cancel()


def _outcome_of_future(task: Task, future: Future[Outcome]) -> Outcome:
    """The answer of a worker; a failed outcome if the worker died. `InputError` if the run cannot continue."""
    try:
        return future.result()
    except InputError:  # each further job would fail alike
        raise
    except CancelledError:
        raise InputError("the scheduler is gone: start it again, then give the same command") from None
    except BrokenExecutor as error:
        why = f"{MOST_LOSSES} workers died while they ran it, one after the other, the last: {error}"
    except Exception as error:  # an error of the executor: those of codecs are in their records
        why = f"{type(error).__name__}: {error}"
    return failed_outcome(task, error_with_origin(task, why))


def timings(folder: Path, jobs: list[Job], device: str, threads: int, show: Progress = silent) -> list[Timing]:
    """The timing of each job's decoder, of files in the folder of a run.

    Codecs are from outside if another distribution holds them: their decoders may crash, and end the process. If some
    decoders are from outside, all are timed in a worker process. If that dies, only those of the suite are timed, in
    this process.
    """
    ours = [job for job in jobs if not from_outside(job["codec"])]  # of codecs of this suite
    others = [job["job"] for job in jobs if from_outside(job["codec"])]
    if others:
        with processes(count=1, threads=threads) as workers:
            try:
                return workers.executor.submit(timings_here, folder, jobs, device, threads).result()
            except BrokenExecutor:
                log.warning("not timed, because one of them ended the timing process: %s", ", ".join(others))
    return timings_here(folder, ours, device, threads, show)


class DecoderTimes(NamedTuple):
    """The times of a decoder: of queries anywhere, and of those that one texel answers, where it can answer so."""

    anywhere: timing.Timing
    at_one_texel: timing.Timing | None


def time_decoders(
    materials: dict[str, Material], threads: int, show: Progress, turns: int = 0
) -> dict[str, DecoderTimes]:
    """The times of materials by name, all in turns with each other and the floor; `turns` as in `time_materials`."""
    contestants = dict(materials)
    for name, material in materials.items():
        at_one_texel = material.at_one_texel()
        if at_one_texel is not None:
            contestants[f"{name} at one texel"] = at_one_texel
    measured = timing.time_materials(contestants, threads, show=show, turns=turns)
    return {name: DecoderTimes(measured[name], measured.get(f"{name} at one texel")) for name in materials}


def timings_here(folder: Path, jobs: list[Job], device: str, threads: int, show: Progress = silent) -> list[Timing]:
    """The timing of each job's decoder, measured in this process; `folder` is the run's.

    A decoder whose network answers texels can also answer a query by one texel. It is timed so, too, and its record has
    `ratio_at_one_texel`. Decoders that are other programs are left out, and with a warning those that fail.
    """
    materials = {}
    for job in jobs:
        try:  # a file may not load, and timing asks for any directions, where scoring asked for the pairs of the BTF
            material = without_warnings(material_of_job(folder, job, device))
            if material.opaque:  # another program answers: its time would be that of exchanging files
                continue
            material.query(*timing.random_queries(timing.batch_on(device), torch.device(device)))
        except Exception as error:  # the results of all others must not be lost with it
            log.warning("%s: not timed: %s: %s", job["job"], type(error).__name__, error)
            continue
        materials[job["job"]] = material
    if not materials:
        return []
    rows = []
    for name, (anywhere, at_one_texel) in time_decoders(materials, threads, show).items():
        row: Timing = {"kind": "timing", "job": name}
        row |= timing.conditions(threads, device) | anywhere.summary()
        if at_one_texel is not None:
            row["ratio_at_one_texel"] = at_one_texel.summary()["ratio_to_floor"]
        row |= {"samples_ns": anywhere.samples.tolist(), "floor_ratios": anywhere.ratios.tolist()}
        rows.append(row)
    return rows
