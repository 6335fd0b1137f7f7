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
        if cached != "record":
            self.done += record["status"] == "ok"
            if record["job"] in self.holds:  # the code or the data changed: the other records will not hold either
                self.holds = set()

    @property
    def first(self) -> str:
        """The message before the run starts."""
        jobs, left = f"{self.total} job" + "s" * (self.total != 1), len(self.waiting - self.holds)
        recorded = f", {len(self.holds)} of them recorded" if self.holds else ""
        return f"{jobs}{recorded}: {left} left" if left else f"{jobs}, all recorded; what changed since is done again"

    @property
    def left(self) -> str:
        """The time left at the mean time of done jobs; "" before this run has done a job, and after the last."""
        left = len(self.waiting - self.holds)
        mean = (time.monotonic() - self.start) / max(1, self.done)
        return f"about {duration(mean * left)} left" if left and self.done else ""

    @property
    def progress(self) -> str:
        """How many jobs have ended, and the time left."""
        ended = f"{self.total - len(self.waiting)} of {self.total} job" + "s" * (self.total != 1)
        return f"{ended}, {self.left}" if self.left else ended


def duration(seconds: float) -> str:
    """A length of time in words, in minutes or hours."""
    if seconds <= 30:
        return "half a minute"
    hours, rest = divmod(max(1, round(seconds / 60)), 60)
    return f"{hours} h {rest} min" if hours and rest else f"{hours} h" if hours else f"{rest} min"
