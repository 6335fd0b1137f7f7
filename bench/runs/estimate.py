"""Estimates how many jobs of a run are left and how long they take, from recorded fits of the same codecs.

A fit is assumed to take as long as the most similar recorded one, in proportion to its steps and batch or, without
steps, to its data. Recorded fits are those of this folder and of the folders beside it, made on this processor. The
time of a job besides its fit (opening, scoring) is known once one job of this run has ended. A codec that was never
fitted here has no estimate; its jobs are counted separately.
"""

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from bench.codec import settings_dict
from bench.codecs.registry import make_codec
from bench.errors import InputError
from bench.records import FILE, Record, load_run
from bench.runs.provenance import processor
from bench.runs.task import Task


@dataclass(frozen=True)
class Fitted:
    """A recorded fit: its job, its amount of work, and its time."""

    codec: str
    material: str
    settings: Record
    size: float  # values of its training pairs
    seconds: float

    @classmethod
    def from_job(cls, job: Record) -> "Fitted":
        rows, cols = job["shape"]
        size = float(rows * cols * job["pairs"].get("train", 0))
        return cls(job["codec"], job["material"], job["settings"], size, job["fit_seconds"])


class Estimate:
    """The remaining jobs of a run; `holds` are those whose records are expected to hold.

    `seats` gives the number of jobs that run at once.
    """

    def __init__(self, tasks: Iterable[Task], holds: set[str], folder: Path, seats: Callable[[], int]):
        self.waiting = {task.name: task for task in tasks}
        self.total, self.holds, self.seats = len(self.waiting), holds, seats
        self.known: dict[str, list[Fitted]] = {}  # by codec, the latest last
        for fit in _on_record(folder):
            self._keep(fit)
        self.start = time.monotonic()
        self.worked, self.spent = 0, 0.0  # jobs that were fitted or scored, and seconds of their fits

    def ended(self, record: Record, cached: str) -> None:
        """Count a job that ended, given its record and its earlier record."""
        name = record["job"]
        self.waiting.pop(name, None)
        if cached == "record":
            return
        self.worked += 1
        if name in self.holds:  # the code or the data changed: the other records will not hold either
            self.holds = set()
        if not cached and record["status"] == "ok":
            self._keep(Fitted.from_job(record))
            self.spent += record["fit_seconds"]

    def _keep(self, fit: Fitted) -> None:
        alike = self.known.setdefault(fit.codec, [])
        alike[:] = [each for each in alike if (each.material, each.settings) != (fit.material, fit.settings)] + [fit]

    @property
    def first(self) -> str:
        """The message before the run starts."""
        left = len(self._left)
        recorded = f", {len(self.holds)} of them recorded" if self.holds else ""
        seconds, unknown = self._ahead()
        names = ", ".join(sorted({task.codec.codec for task in unknown}))
        if not left:
            return f"{_jobs(self.total)}, all recorded; what changed since is done again"
        start = f"{_jobs(self.total)}{recorded}: {left} left, "
        if len(unknown) == left:
            return f"{start}no estimate before the first fit of {names} on this machine"
        rest = f", and {_jobs(len(unknown))} of {names}, which have no recorded fit here" if unknown else ""
        return f"{start}about {duration(seconds)} of fits{rest}"

    @property
    def left(self) -> str:
        """The message during the run: the time left; "" if nothing is known."""
        seconds, unknown = self._ahead()
        left = len(self._left)
        if not left or len(unknown) == left:
            return ""
        rest = f" and {_jobs(len(unknown))} of unknown time" if unknown else ""
        return f"about {duration(seconds)}{rest} left"

    @property
    def progress(self) -> str:
        """How many jobs are done, and the time left."""
        return ", ".join(filter(None, [f"{self.total - len(self.waiting)} of {_jobs(self.total)}", self.left]))

    @property
    def _left(self) -> list[Task]:
        return [task for name, task in self.waiting.items() if name not in self.holds]

    def _ahead(self) -> tuple[float, list[Task]]:
        """The seconds of the remaining jobs whose fits can be estimated, and the other jobs."""
        fits = dict[tuple[str, str], float | None]()
        left = self._left
        for task in left:
            cell = task.material.name, task.codec.label
            fits[cell] = fits[cell] if cell in fits else self._fit(task)
        seconds, seats = [fits[task.material.name, task.codec.label] for task in left], self.seats()
        # The time of a job besides its fit, as measured in this run so far.
        apart = (time.monotonic() - self.start) * min(seats, self.total) - self.spent
        besides = max(0.0, apart / self.worked) if self.worked else 0.0
        known = [each + besides for each in seconds if each is not None]
        unknown = [task for task, each in zip(left, seconds, strict=True) if each is None]
        return sum(known) / min(seats, max(1, len(left))), unknown

    def _fit(self, task: Task) -> float | None:
        """Seconds of the fit of a job, estimated from the most similar recorded fit; None without one."""
        try:
            settings = settings_dict(make_codec(task.codec.codec, task.codec.settings))
        except InputError:  # it fails with this error
            return 0.0
        if not (alike := self.known.get(task.codec.codec)):
            return None
        likeness = lambda fit: (fit.settings == settings, fit.material == task.material.name)  # noqa: E731
        nearest = max(reversed(alike), key=likeness)  # of several, the latest
        return nearest.seconds * self._ratio(task, settings, nearest)

    def _ratio(self, task: Task, settings: Record, fit: Fitted) -> float:
        """How much more work a job's fit is than one on record."""
        if "steps" in settings:
            work = [float(each.get("steps", 0)) * float(each.get("batch", 1)) for each in (settings, fit.settings)]
            return work[0] / work[1] if all(work) else 1.0
        size = self._size(task)
        return size / fit.size if size and fit.size else 1.0

    def _size(self, task: Task) -> float:
        """Values of a job's training pairs; 0 where the data must be opened to tell."""
        data = task.data
        if not task.material.path:
            return float(data.size**2 * data.views * data.lights)
        return max((fit.size for fits in self.known.values() for fit in fits if fit.material == task.material.name),
                   default=0.0)  # fmt: skip


def _on_record(folder: Path) -> Iterator[Fitted]:
    """The fits of the runs beside a folder, then of its own, that this processor made."""
    here, own = processor(), folder / FILE
    for file in [*sorted(set(folder.parent.glob(f"*/{FILE}")) - {own}), *([own] if own.exists() else [])]:
        try:
            jobs = list(load_run(file.parent).jobs)
        except InputError:  # the estimate does without it; a run goes on or stops by its own records elsewhere
            continue
        for job in jobs:
            whole = job["status"] == "ok" and {"codec", "shape", "pairs", "settings", "fit_seconds"} <= job.keys()
            if whole and job.get("machine", {}).get("processor") == here:
                yield Fitted.from_job(job)


def duration(seconds: float) -> str:
    """A length of time in words, in minutes or hours."""
    if seconds <= 30:
        return "half a minute"
    hours, rest = divmod(max(1, round(seconds / 60)), 60)
    return f"{hours} h {rest} min" if hours and rest else f"{hours} h" if hours else f"{rest} min"


def _jobs(count: int) -> str:
    return f"{count} job" + "s" * (count != 1)
