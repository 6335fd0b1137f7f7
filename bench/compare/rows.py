"""Compares one row: a material and a codec with its settings, in two runs.

The base is the older run, new the one under test. A `Change` holds the means of a quantity in both runs and the
verdict. Decoding times are compared as multiples of the floor timed with them; they are shown and decide nothing.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from statistics import fmean

from bench.codecs.alike import obstacles
from bench.compare.paired import interval_between_runs
from bench.compare.quantities import MAIN, deciding, undeciding
from bench.compare.verdicts import Change, Verdict, is_random, judge, other_settings, why_unlike
from bench.records import CONDITIONS, Job, Run, Timing, by_row, method_of

FACTOR = 1.25  # a smaller change of a ratio is not mentioned
ABSENT = "no such job in the run"
# The verdicts on a row that has numbers or jobs to judge, the gravest first.
ORDER = (Verdict.FAILED, Verdict.GONE, Verdict.WORSE, Verdict.UNLIKE, Verdict.BETTER, Verdict.SAME)


@dataclass(frozen=True)
class Multiple:
    """A decoding time as a multiple of the floor's, one bilinear fetch of a colour, over the seeds of a row.

    `interval` is the 95 % interval that contains those of all seeds, and `conditions` are values of `CONDITIONS`, such
    as the device.
    """

    mean: float
    interval: tuple[float, float]
    conditions: list[object]


@dataclass(frozen=True)
class TwoTimes:
    """The times of one row in two runs, under the same conditions."""

    base: Multiple
    new: Multiple

    @property
    def words(self) -> str:
        """ "slower" or "faster" if the intervals do not overlap and the factor is large enough to matter; else ""."""
        if self.new.mean > FACTOR * self.base.mean and self.new.interval[0] > self.base.interval[1]:
            return "slower"
        if self.base.mean > FACTOR * self.new.mean and self.new.interval[1] < self.base.interval[0]:
            return "faster"
        return ""


def comparable_times(base: Multiple | None, new: Multiple | None) -> TwoTimes | None:
    """The times of one row in two runs; None if one lacks them or was timed under other conditions."""
    if base is None or new is None or base.conditions != new.conditions:
        return None
    return TwoTimes(base, new)


def multiples(jobs: Iterable[Job], timings: Iterable[Timing]) -> dict[tuple[str, str], Multiple]:
    """Times over the seeds of each row, (material, label); rows without a time are left out."""
    timing_of = {timing["job"]: timing for timing in timings if "ratio_to_floor" in timing}
    multiple_of = {}
    for row, jobs_of_row in by_row(job for job in jobs if job["job"] in timing_of).items():
        of_row = [timing_of[job["job"]] for job in jobs_of_row]
        mean = fmean(timing["ratio_to_floor"] for timing in of_row)
        lows, highs = zip(*(timing["ratio_interval95"] for timing in of_row), strict=True)
        multiple_of[row] = Multiple(mean, (min(lows), max(highs)), [of_row[0].get(name) for name in CONDITIONS])
    return multiple_of


@dataclass(frozen=True)
class ComparedRow:
    """A material and a codec: the changes, the verdict, and its reason if the numbers do not show it."""

    material: str
    label: str
    method: str  # the name of the codec, as `method_of` says it; of a mean row, its label
    verdict: Verdict
    why: str = ""
    seeds: tuple[int, ...] = ()  # the seeds that the means are over
    deciding: list[Change] = field(default_factory=list)
    shown: list[Change] = field(default_factory=list)
    timing: TwoTimes | None = None
    notes: list[str] = field(default_factory=list)
    allowed: bool = False  # the row may be gone or not comparable

    @property
    def forbids(self) -> bool:
        """Whether this row stops the change under test."""
        verdicts = {self.verdict, *(change.verdict for change in self.deciding)}
        stops = {Verdict.FAILED, Verdict.WORSE}
        if not self.allowed:
            stops |= {Verdict.GONE, Verdict.UNLIKE}
        return bool(verdicts & stops)

    @property
    def name(self) -> str:
        """The row as `allow` and tables name it: material/label."""
        return f"{self.material}/{self.label}"

    @property
    def advice(self) -> str:
        """A sentence on a notable change of decoding time; "" if there is none."""
        if self.timing is None or not self.timing.words:
            return ""
        times = f"{self.timing.base.mean:.2f} → {self.timing.new.mean:.2f} × floor"
        return f"decodes {self.timing.words}, {times} (a time is only advice)"

    def findings(self) -> list[tuple[Verdict, str]]:
        """A sentence for each difference of this row, and the verdict on it."""
        findings = []
        if self.why:
            findings.append((self.verdict, self.why))
        for change in self.deciding:
            if change.verdict not in (Verdict.SAME, Verdict.SHOWN):
                findings.append((change.verdict, sentence(change)))
        return findings

    def reasons(self) -> list[str]:
        """The sentences that speak against this row, so without gains."""
        return [text for verdict, text in self.findings() if verdict != Verdict.BETTER]


def sentence(change: Change) -> str:
    """A change in words: "PSNR 26.31 → 25.81 dB (−0.50; up to 0.25 counts as the same)"."""
    quantity = change.quantity
    if change.verdict == Verdict.UNLIKE:
        return f"{quantity.name}: {change.why}"
    text = f"{quantity.name} {quantity.written(change.base)} → {quantity.written(change.new)}"
    if quantity.unit:
        text += f" {quantity.unit}"
    details = quantity.difference(change.difference or 0.0)
    if change.weighted is not None:
        details += " as a weighted mean"
    if change.interval is not None:
        details += f", 95 % {quantity.difference(change.interval.low)} to {quantity.difference(change.interval.high)}"
    if change.margin:  # None, or 0 where any change counts
        details += f"; up to {change.margin:,.{quantity.digits}f} counts as the same"
    return f"{text} ({details})"


def compare_row(
    runs: tuple[Run, Run], before: list[Job], after: list[Job], declared: set[int], timing: TwoTimes | None
) -> ComparedRow:
    """The row of the jobs of base and new, of which one may be empty; `declared` are the seeds that new should have.

    `runs` are base and new. A verdict on jobs that failed or vanished precedes that on numbers, which are shown.
    """
    any_job, *_ = [*before, *after]
    row = any_job["material"], any_job["label"], method_of(any_job)
    finished = [job for job in before if job["status"] == "ok"]
    new = [job for job in after if job["status"] == "ok"]
    unfinished, why = _verdict_on_unfinished(finished, after, declared)  # None and "" unless jobs failed or vanished
    if not finished or not new:
        return ComparedRow(*row, unfinished or Verdict.NEW, why)
    # A base may hold seeds of several versions of a codec, or with pairs of their own, as earlier versions of the suite
    # drew them. Those unlike the first tell nothing of its scatter.
    base = [job for job in finished if not why_unlike(finished[0], job)]
    ours, theirs = _jobs_of_shared_seeds(base, new)  # of base, and of new
    obstacle = _why_new_is_mixed(new) or _first_obstacle(base, ours, theirs)
    changes = [] if obstacle else _changes(runs, ours, theirs, base)
    if not changes:
        reason = why or obstacle or "neither record has a score"
        return ComparedRow(*row, unfinished or Verdict.UNLIKE, reason)
    others = [judge(quantity, ours, theirs, base) for quantity in undeciding(base[0])]
    settings = other_settings(base[0], new[0])  # "" if they are the same
    notes = [f"settings: {settings}"] if settings else []
    seeds = tuple(job["seed"] for job in theirs)
    verdict = unfinished or gravest_verdict(changes)
    return ComparedRow(*row, verdict, why, seeds, changes, others, timing, notes)


def _why_new_is_mixed(new: list[Job]) -> str:
    """Why one of the jobs of new cannot stand beside its newest seed, as after a run that ended early; "" if each can.

    The jobs of a reference do not name their runs, so which is the newest is not known.
    """
    obstacle_of = obstacles([job for job in new if job.get("run")])
    for job in new:
        if job["job"] in obstacle_of:
            return f"seed {job['seed']}: {obstacle_of[job['job']]}: give the command of the run again"
    return ""


def _first_obstacle(base: list[Job], ours: list[Job], theirs: list[Job]) -> str:
    """Why a job of new, `theirs`, cannot be compared with the base's; "" if each can.

    It is compared with the job of its seed among `ours` or, if they share no seed, with the first of the base.
    """
    job_of_seed = {job["seed"]: job for job in ours}
    reasons = (why_unlike(job_of_seed.get(job["seed"], base[0]), job) for job in theirs)
    return next(filter(None, reasons), "")


def gravest_verdict(changes: list[Change]) -> Verdict:
    """The verdict on a row: the gravest of those on its numbers."""
    verdicts = {change.verdict for change in changes}
    gravest, *_ = [verdict for verdict in ORDER if verdict in verdicts]
    return gravest


def _changes(runs: tuple[Run, Run], ours: list[Job], theirs: list[Job], base: list[Job]) -> list[Change]:
    """The changes of the deciding numbers, with verdicts; none if neither side has a score.

    `ours` and `theirs` are the compared jobs of base and new, and `base` all jobs of the base's row.
    """
    quantities = deciding(base[0])
    draws = is_random(quantities, base)
    changes = [judge(quantity, ours, theirs, base, draws) for quantity in quantities]
    if all(change.base is None and change.new is None for change in changes if change.quantity.metric):
        return []
    if len(ours) < len(base):  # means are over more seeds than differences slice by slice would be
        return changes
    base_run, new_run = runs
    interval = interval_between_runs(base_run, ours, new_run, theirs)  # of the differences of PSNR, slice by slice
    return [replace(change, interval=interval if change.quantity.name == MAIN else None) for change in changes]


def _jobs_of_shared_seeds(base: list[Job], new: list[Job]) -> tuple[list[Job], list[Job]]:
    """The jobs of the seeds that both have; all jobs if they share no seed."""
    shared = {job["seed"] for job in base} & {job["seed"] for job in new}
    if not shared:
        return base, new
    ours = [job for job in base if job["seed"] in shared]
    theirs = [job for job in new if job["seed"] in shared]
    return ours, theirs


def _verdict_on_unfinished(base: list[Job], after: list[Job], declared: set[int]) -> tuple[Verdict | None, str]:
    """The verdict on a row whose jobs failed or vanished, and why; None and "" for any other row.

    `base` are the finished jobs of the base, `after` all jobs of new, `declared` the seeds that new should have.
    """
    failed = [job for job in after if job["status"] == "failed"]
    if failed:
        which = "the job" if len(failed) == 1 else f"{len(failed)} jobs"
        return Verdict.FAILED, f"{which} failed: {_on_one_line(failed[0]['error'])}"
    if not after:
        return Verdict.GONE, ABSENT
    if not base:  # new, or never finished in the base
        return None, ""
    missing = [job for job in after if job["status"] == "unavailable"]
    if missing:
        return Verdict.GONE, f"not available: {_on_one_line(missing[0]['error'])}"
    expected = {job["seed"] for job in base} & declared
    gone = sorted(expected - {job["seed"] for job in after})
    if not gone:
        return None, ""
    return Verdict.GONE, f"seed {', '.join(map(str, gone))} has no result"


def _on_one_line(error: str) -> str:
    """An error on one line, without the colours and other control codes that some programs print."""
    printable = [character if character.isprintable() else " " for character in error]
    return " ".join("".join(printable).split())
