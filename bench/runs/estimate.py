"""Says how many jobs of a run are left, and for how long at the mean time of those that it has done."""

import time
from collections.abc import Iterable

from bench.records import Record


class Estimate:
    """The remaining jobs of a run; `holds` are those whose records are expected to hold."""

    def __init__(self, names: Iterable[str], holds: Iterable[str]):
        self.waiting, self.holds = set(names), set(holds)
        self.total, self.done, self.start = len(self.waiting), 0, time.monotonic()

    def ended(self, record: Record, cached: str) -> None:
        """Count a job that ended, given its record and what was reused for it."""
        self.waiting.discard(record["job"])
        if cached == "record":
            return
        self.done += record["status"] == "ok"
        if record["job"] in self.holds:  # the code or the data changed: the other records will not hold either
            self.holds = set()

    @property
    def first(self) -> str:
        """The message before the run starts."""
        if not self._jobs_left:
            return f"{_jobs(self.total)}, all recorded; what changed since is done again"
        recorded = f", {len(self.holds)} of them recorded" if self.holds else ""
        return f"{_jobs(self.total)}{recorded}: {self._jobs_left} left"

    @property
    def left(self) -> str:
        """The message during the run: the time left; "" before this run has done a job, and after the last."""
        if not self._jobs_left or not self.done:
            return ""
        mean = (time.monotonic() - self.start) / self.done
        return f"about {duration(mean * self._jobs_left)} left"

    @property
    def progress(self) -> str:
        """How many jobs have ended, and the time left."""
        ended = f"{self.total - len(self.waiting)} of {_jobs(self.total)}"
        return f"{ended}, {self.left}" if self.left else ended

    @property
    def _jobs_left(self) -> int:
        return len(self.waiting - self.holds)


def duration(seconds: float) -> str:
    """A length of time in words, in minutes or hours."""
    if seconds <= 30:
        return "half a minute"
    hours, rest = divmod(max(1, round(seconds / 60)), 60)
    return f"{hours} h {rest} min" if hours and rest else f"{hours} h" if hours else f"{rest} min"


def _jobs(count: int) -> str:
    return f"{count} job" + "s" * (count != 1)
