"""Where jobs run: in this process, in worker processes of this machine, or on the workers of a Dask cluster.

All three are a `concurrent.futures.Executor`; any other executor works too. Tasks, which say what a job is to do, and
answers are plain data that this suite's own processes pickle for each other. Nothing is ever unpickled from a file.
"""

import math
import multiprocessing
import os
import queue
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from itertools import cycle, islice
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any, NamedTuple, TypeVar

from bench.inputs.errors import InputError, installed
from bench.machine.devices import is_gpu
from bench.machine.threads import handling

T = TypeVar("T")
Show = Callable[[str, int, int], None]  # shows the progress of a job: label, done, total
PATIENCE = "10s"  # in the words of Dask: how long to wait for the first answer of a scheduler
VISIBLE = {"cuda": "CUDA_VISIBLE_DEVICES", "xpu": "ZE_AFFINITY_MASK"}  # what chooses the GPUs of a process
THREAD_COUNTS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")


@dataclass(frozen=True)
class Workers:
    """An executor, and how many jobs to submit to it at once: further ones would only queue."""

    executor: Executor
    at_once: int
    here: bool = False  # jobs run in the calling thread, and can show their progress
    show_with: Callable[[Show], None] = lambda show: None  # of others: takes what shows the progress of their jobs


Seats = Callable[[], AbstractContextManager[Workers]]  # opens the workers of a run, and ends them
TELL_EVERY = 0.2  # seconds between two messages of a worker about its progress
_pipes: list[Connection] = []  # in a worker process: the one to the process that started it
_last_told: dict[str, float] = {}  # when it last told the progress of each label


@contextmanager
def in_process() -> Iterator[Workers]:
    """Run one job after another, in the calling thread."""
    yield Workers(InProcess(), at_once=1, here=True)


@contextmanager
def processes(count: int, threads: int, device: str = "cpu", limit: float | None = None) -> Iterator[Workers]:
    """Run jobs in `count` processes of this machine, with `threads` threads each; several on GPUs get one each.

    A job that takes longer than `limit` seconds loses its process, and fails with `OutOfTimeError`; None: no limit.
    `InputError` for a count, limit or device that cannot be used so.
    """
    if limit is not None and not 0 < limit < math.inf:
        raise InputError(f"--max-seconds {limit:g}: must be above 0 and finite; leave it out for no limit")
    if count < 1:
        raise InputError(f"--jobs {count}: must be at least 1")
    kind, _, number = device.partition(":")  # "cuda:1" is the second GPU, "cuda" is any
    gpus: list[dict[str, str]] = []
    if is_gpu(device) and count > 1:
        if number:
            raise InputError(f"--device {device}: with --jobs each job has one of the GPUs: give --device {kind}")
        gpus = _gpu_variables(count, device)
    pool = Processes(count, threads, gpus, limit)
    try:
        yield Workers(pool, count, show_with=pool.show_with)
    finally:
        pool.shutdown()


@contextmanager
def dask(address: str, resources: dict[str, float]) -> Iterator[Workers]:
    """Run jobs on a Dask scheduler, given by its address or its scheduler file, whose name ends in `.json`.

    A job takes `resources` of its worker, such as {"GPU": 1}. `InputError` if no scheduler answers.
    """
    with installed("--scheduler needs Dask: pip install 'neubtf-bench[dask]'"):
        from distributed import Client
    is_file = address.endswith(".json")
    try:
        if is_file and not os.path.exists(address):  # the client would wait for it forever
            raise FileNotFoundError("no such file")
        place = {"scheduler_file": address} if is_file else {"address": address}
        client = Client(**place, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        fault = f"no Dask scheduler answers there ({error})"
        raise InputError(f"--scheduler {address}: {fault}: start it, or mend the address") from error
    # As pure functions, the default of Dask, equal calls would run once: a repeated job would get its first answer.
    executor = client.get_executor(pure=False, resources=resources or None)  # None: a job takes no resources
    try:
        _require_package(client)
        # Enough for a cluster that scales with the number of waiting jobs.
        yield Workers(executor, at_once=1000)
    finally:
        executor.shutdown(wait=False)
        client.close()


def _require_package(client: Any) -> None:
    """Raise `InputError` for workers without this package: the first job would end them silently, and hang."""
    versions = client.get_versions(packages=["neubtf-bench"])["workers"]
    lacking = [name for name, worker in versions.items() if not worker["packages"].get("neubtf-bench")]
    if lacking:
        raise InputError(
            f"--scheduler: neubtf-bench is not installed on {', '.join(lacking[:5])}: install it, with the "
            "codecs, where the workers run, and start them again"
        )


class OutOfTimeError(Exception):
    """A job exceeded its time limit, and its process was ended."""


class InProcess(Executor):
    """Runs a submitted call immediately, in the calling thread."""

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """Call a function now. An error, as in any executor, is raised when the result is asked for."""
        future: Future[T] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


class _Worker(NamedTuple):
    """A worker process of this machine, and this process's end of the pipe between both."""

    process: BaseProcess
    pipe: Connection


class Processes(Executor):
    """Worker processes: one that dies loses only its own job, and is replaced.

    `submit` waits until a worker is free. A worker ends when this process does, however that ends.
    """

    def __init__(self, count: int, threads: int, gpus: Sequence[dict[str, str]] = (), limit: float | None = None):
        """No process is started yet. `gpus` has for each seat the environment variable that gives its process a GPU, by
        name and value; it is empty without GPUs."""
        self.threads = threads
        self.gpus = gpus
        self.limit = limit  # seconds that a job may take; None: no limit
        self.show: Show = _show_nothing
        self.workers: dict[int, _Worker] = {}  # by seat, the place of a worker
        self.callers = ThreadPoolExecutor(count)  # a thread for each job, which waits for its answer
        self.free: queue.SimpleQueue[int] = queue.SimpleQueue()  # seats without a job
        for seat in range(count):
            self.free.put(seat)

    def show_with(self, show: Show) -> None:
        """Show the progress of jobs that start from now on; calls come from other threads."""
        self.show = show

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """Call a function in the first worker that is free, which is started if it has no process."""
        seat = self.free.get()  # waits for one
        if seat in self.workers and not self.workers[seat].process.is_alive():
            self._end(seat)  # its process died after its last job, as by the kernel that needed memory
        if seat not in self.workers:
            self.workers[seat] = self._started(seat)
        return self.callers.submit(self._call, seat, self.workers[seat], partial(fn, *args, **kwargs))

    def _started(self, seat: int) -> _Worker:
        """A worker for a seat, whose process starts."""
        context = multiprocessing.get_context("spawn")  # a fork copies locks of threads, and cannot use CUDA
        ours, theirs = context.Pipe()
        gpu_variables = self.gpus[seat] if self.gpus else {}
        process = context.Process(target=_serve, args=(theirs, self.threads, gpu_variables))
        # Worker processes ignore Ctrl-C: this one ends them and prints the message.
        with handling(signal.SIGINT, signal.SIG_IGN), _main_hidden():
            process.start()
        theirs.close()  # the process has its own copy: when it ends, nobody holds this end
        return _Worker(process, ours)

    def _call(self, seat: int, worker: _Worker, call: Callable[[], T]) -> T:
        """Have a worker make a call, in a thread of `callers`, and free its seat.

        If the call raises an error, dies with its process or takes too long, the process is ended. Raises the call's
        error, `BrokenProcessPool` with how the process ended, or `OutOfTimeError`.
        """
        try:
            return self._answer(worker, call)
        except BaseException:
            self._end(seat)
            raise
        finally:
            self.free.put(seat)

    def _answer(self, worker: _Worker, call: Callable[[], T]) -> T:
        """What a call gives in a worker, or raises there; shows what it tells of its progress meanwhile."""
        from bench.codec import ended_bars  # here: a worker imports this module before it may import PyTorch

        left: float | None = None  # seconds; the time to start the process does not count
        with ended_bars(self.show) as show:
            _heard(worker, partial(worker.pipe.send, call))
            while True:
                waited_from = time.monotonic()
                if not _heard(worker, partial(worker.pipe.poll, left)):
                    raise OutOfTimeError(f"it took longer than {self.limit:g} s (--max-seconds)")
                if left is not None:
                    left = max(0.0, left - (time.monotonic() - waited_from))
                kind, value = _heard(worker, worker.pipe.recv)
                match kind:
                    case "begun":
                        left = self.limit
                    case "progress":
                        show(*value)
                    case "error":
                        error, trace = value
                        error.add_note(trace)
                        raise error
                    case _:
                        return value

    def _end(self, seat: int) -> None:
        """End the worker of a seat, if it has one."""
        worker = self.workers.pop(seat, None)
        if worker is not None:
            worker.process.kill()
            worker.process.join()
            worker.pipe.close()

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End every worker, even one that runs a job."""
        for worker in list(self.workers.values()):
            worker.process.kill()
        self.callers.shutdown(wait)  # whose jobs end with their workers
        for seat in list(self.workers):
            self._end(seat)


@contextmanager
def _main_hidden() -> Iterator[None]:
    """Processes that start meanwhile do not run the calling script once more, as `multiprocessing` else has them do.

    A job is plain data and a function of this suite, so workers need nothing of the script, which may call `bench.run`
    without a guard.
    """
    main = vars(sys.modules["__main__"])
    spec, path = main.get("__spec__"), main.pop("__file__", None)
    main["__spec__"] = None
    try:
        yield
    finally:
        main["__spec__"] = spec
        if path is not None:
            main["__file__"] = path


def _heard(worker: _Worker, use: Callable[[], T]) -> T:
    """What a use of a worker's pipe gives. Raises `BrokenProcessPool`, which says how the process ended, if it did."""
    try:
        return use()
    except (EOFError, OSError) as error:
        worker.process.join(1.0)  # seconds: it has ended already, and is collected so that its exit code is known
        code = worker.process.exitcode  # a negative one is the number of a signal
        ending = f"exit code {code}" if code is None or code >= 0 else f"killed by {signal.Signals(-code).name}"
        raise BrokenProcessPool(ending) from error


def _serve(pipe: Connection, threads: int, gpu: dict[str, str]) -> None:
    """The life of a worker process: make the calls that come through the pipe, and send what they give.

    Sets environment variables before NumPy and PyTorch are imported and read them. `gpu` is the one that gives the
    process its GPU, by name and value; empty without a GPU.
    """
    os.environ.update(dict.fromkeys(THREAD_COUNTS, str(threads)) | gpu)
    _pipes.append(pipe)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    while True:
        call = pipe.recv()
        pipe.send(("begun", None))
        try:
            pipe.send(("answer", call()))
        except BaseException as error:  # of the call, or of an answer that cannot be sent
            pipe.send(("error", (error, traceback.format_exc())))


def _end_with_parent() -> None:
    """End this process when the one that started it ends, however that ends."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def tell(label: str, done: int, total: int) -> None:
    """Tell the process that started this worker the progress of its job; does nothing elsewhere.

    The first and the last step are told in any case, steps between them at most every `TELL_EVERY` seconds.
    """
    if not _pipes:  # this process is no worker that was started here
        return
    now = time.monotonic()
    told_lately = now - _last_told.get(label, -math.inf) < TELL_EVERY
    if told_lately and 0 < done < total:
        return
    _last_told[label] = now
    with suppress(OSError):  # the other process has ended
        _pipes[0].send(("progress", (label, done, total)))


def _show_nothing(label: str, done: int, total: int) -> None:
    """A `Show` that shows nothing."""


def _gpu_variables(count: int, device: str) -> list[dict[str, str]]:
    """For each of `count` jobs, the environment variable that gives its process a GPU, by name and value.

    If the variable is set already, as a cluster's scheduler does, only the GPUs that it names are handed out. More jobs
    than GPUs share them: fits of small networks leave most of a GPU idle. `InputError` if there is no GPU to give.
    """
    variable = VISIBLE.get(device)
    if variable is None:
        raise InputError(f"--jobs {count}: no variable gives a process a {device} of its own: leave --jobs out")
    visible = os.environ.get(variable)  # names of GPUs, with commas between
    if visible is None:
        import torch

        names = [str(index) for index in range(torch.get_device_module(device).device_count())]
    else:
        names = [name.strip() for name in visible.split(",") if name.strip()]
    if not names:
        fault = "there is no GPU here: run it on a machine with one, or leave --device out"
        if visible is not None:
            fault = f"{variable} names no GPU: leave it unset, or name one"
        raise InputError(f"--jobs {count}: {fault}")
    return [{variable: name} for name in islice(cycle(names), count)]
