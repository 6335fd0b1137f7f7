"""Estimates how long the jobs of a run still take, from those that are done: by codec and by the steps of a fit.

A record of an earlier run *holds* if code, settings and data are the same: then the job takes no time.
"""

import time
from collections import defaultdict
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from bench.codecs.registry import make_codec
from bench.inputs.errors import InputError
from bench.records import Job
from bench.runs.suite import CodecSpec


class Effort(NamedTuple):
    """What the time of a job depends on: its codec, and the steps of its fit, 1 if it is not fitted in steps."""

    codec: str
    steps: int = 1

    @classmethod
    def of(cls, spec: CodecSpec) -> "Effort":
        """The effort of a job with this codec and these settings."""
        try:
            settings = make_codec(spec.codec, spec.settings).settings
        except InputError:  # its jobs fail at once
            return cls(spec.codec)
        return cls(spec.codec, getattr(settings, "steps", 1))


class Estimate:
    """How many jobs of a run are left, and how long they take.

    A step of a codec's jobs is expected to take as long as in the codec's jobs that are done. While a codec is left of
    which no job is done, no time is told: a linear codec takes a second, a network many minutes. `holds` names the jobs
    whose earlier records are expected to hold, so that they take no time. `at_once` jobs run side by side.
    """

    def __init__(self, efforts: Mapping[str, Effort], holds: Iterable[str], at_once: int = 1):
        """`efforts` has each job of the run by name."""
        self.efforts = efforts
        self.waiting = set(efforts)
        self.holds = set(holds)  # emptied at the first job whose earlier record does not hold
        self.total = len(self.waiting)
        self.at_once = max(1, at_once)
        self.last = time.monotonic()  # when the latest job ended
        self.seconds: defaultdict[str, float] = defaultdict(float)  # by codec, of the jobs that were fitted
        self.steps: defaultdict[str, int] = defaultdict(int)  # of the same jobs

    def count_ended(self, record: Job, cached: str) -> None:
        """Count a job that ended, given its record and what was reused for it: "" (nothing), "file" or "record"."""
        name = record["job"]
        now = time.monotonic()
        self.waiting.discard(name)
        if record["status"] == "ok" and not cached:
            effort = self.efforts[name]
            # With `at_once` jobs side by side, so many jobs end in the time that one of them takes.
            self.seconds[effort.codec] += (now - self.last) * self.at_once
            self.steps[effort.codec] += effort.steps
        if cached != "record" and name in self.holds:
            # Code or data changed since the earlier run, so the other records will not hold either.
            self.holds = set()
        self.last = now

    @property
    def first_message(self) -> str:
        """The message before the run starts, such as `12 jobs, 4 of them recorded: 8 left`."""
        jobs = _count_of_jobs(self.total)
        left = len(self.waiting - self.holds)
        if not left:
            return f"{jobs}, all recorded; what changed since is done again"
        if self.holds:
            jobs += f", {len(self.holds)} of them recorded"
        return f"{jobs}: {left} left"

    @property
    def time_left(self) -> str:
        """The time left, such as `about 20 min left`; "" after the last job, and while it cannot be told."""
        waiting = self.waiting - self.holds
        if not waiting:
            return ""
        seconds = 0.0  # if one job ran after another
        for name in waiting:
            effort = self.efforts[name]
            if not self.steps[effort.codec]:  # no job of this codec is done
                return ""
            seconds += self.seconds[effort.codec] / self.steps[effort.codec] * effort.steps
        return f"about {duration(seconds / self.at_once)} left"

    @property
    def progress(self) -> str:
        """How many jobs have ended, and the time left: `8 of 12 jobs, about 20 min left`."""
        text = f"{self.total - len(self.waiting)} of {_count_of_jobs(self.total)}"
        time_left = self.time_left
        return f"{text}, {time_left}" if time_left else text


def _count_of_jobs(count: int) -> str:
    """A number of jobs in words: `1 job`, `12 jobs`."""
    if count == 1:
        return "1 job"
    return f"{count} jobs"


def duration(seconds: float) -> str:
    """A length of time in words, in minutes or hours: "half a minute", "5 min", "1 h 20 min"."""
    if seconds <= 30:
        return "half a minute"
    hours, minutes = divmod(max(1, round(seconds / 60)), 60)
    if not hours:
        return f"{minutes} min"
    if not minutes:
        return f"{hours} h"
    return f"{hours} h {minutes} min"
