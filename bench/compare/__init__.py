"""Compares two runs: what got worse, by more than chance and by more than matters.

A run is its folder, or a file of records such as the reference that a project commits. A row is a material and a codec
with its settings; its numbers are means over the seeds that both runs have (over all seeds where they share none).
`bench.compare.verdicts` states the rules. Imports neither PyTorch nor pandas nor NumPy.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from bench.compare.quantities import deciding, shown
from bench.compare.timings import Advice, advice, multiples
from bench.compare.verdicts import Change, Verdict, judge, other_settings, unlike
from bench.errors import InputError
from bench.exits import FAILED, FINE, NO, NOTHING
from bench.records import Record, Run

_ORDER = (Verdict.FAILED, Verdict.GONE, Verdict.WORSE, Verdict.UNLIKE, Verdict.BETTER, Verdict.SAME)
_NEEDED = ("fit_key", "score_key", "metrics", "scores", "bytes", "parameters", "seed")
REGRESSIONS = (Verdict.WORSE, Verdict.GONE, Verdict.FAILED)


@dataclass(frozen=True)
class Row:
    """A material and a codec: what was compared, the verdict, and why where it is not plain from the numbers."""

    material: str
    label: str
    codec: str
    verdict: Verdict
    why: str = ""
    seeds: tuple[int, ...] = ()  # of the means
    deciding: list[Change] = field(default_factory=list)
    shown: list[Change] = field(default_factory=list)
    timing: Advice | None = None
    notes: list[str] = field(default_factory=list)

    @property
    def name(self) -> str:
        return f"{self.material}/{self.label}"

    def reasons(self) -> list[str]:
        """Each thing that keeps this row from being the same as before, in words."""
        found = [self.why] if self.why else []
        return found + [sentence(change) for change in self.deciding if change.verdict not in (Verdict.SAME, "")]


@dataclass(frozen=True)
class Comparison:
    """Two runs compared."""

    rows: list[Row]
    notes: list[str]

    def having(self, *verdicts: Verdict) -> list[Row]:
        """The rows with one of these verdicts."""
        return [row for row in self.rows if row.verdict in verdicts]

    @property
    def exit_code(self) -> int:
        """3 where a job failed, 4 where nothing could be compared, 1 for a regression, else 0."""
        if self.having(Verdict.FAILED):
            return FAILED
        decided = (Verdict.SAME, Verdict.BETTER, Verdict.WORSE)
        if not any(change.verdict in decided for row in self.rows for change in row.deciding):
            return NOTHING
        return NO if self.having(*REGRESSIONS) else FINE


def compare(base: Run, new: Run, materials: Sequence[str] = (), codecs: Sequence[str] = ()) -> Comparison:
    """Compare two runs, all rows or those of some materials and codecs."""

    def wanted(job: Record) -> bool:
        codec = job["label"].split()[0]
        return (not materials or job["material"] in materials) and (not codecs or codec in codecs)

    before, after = ([_checked(job, run) for job in run.jobs if wanted(job)] for run in (base, new))
    ours, theirs = (multiples(jobs, list(run.timings)) for jobs, run in ((before, base), (after, new)))
    declared = {seed for start in new.starts for seed in start.get("seeds", ())} or {job["seed"] for job in after}
    order = list(dict.fromkeys(job["material"] for job in [*before, *after]))
    keys = dict.fromkeys((job["material"], job["label"]) for job in [*before, *after])
    rows = [
        _row(_of(before, key), _of(after, key), declared, advice(ours.get(key), theirs.get(key)))
        for key in sorted(keys, key=lambda key: order.index(key[0]))
    ]
    return Comparison(rows, list(_notes(base, new, rows)))


def sentence(change: Change) -> str:
    """A change in words: "PSNR 26.31 → 25.81 dB (−0.50; within 0.25 is chance)"."""
    quantity = change.quantity
    if change.verdict == Verdict.UNLIKE:
        return f"{quantity.name}: {change.why}"
    text = f"{quantity.name} {quantity.written(change.base)} → {quantity.written(change.new)}"
    text += f" {quantity.unit}" * bool(quantity.unit) + f" ({quantity.difference(change.difference or 0.0)}"
    return text + (f"; up to {change.margin:,.{quantity.digits}f} counts as the same)" if change.margin else ")")


def _checked(job: Record, run: Run) -> Record:
    """The job, where it has what a comparison needs."""
    for name in _NEEDED if job["status"] == "ok" else ():
        if name not in job:
            raise InputError(f"{run.folder}: {job['job']} has no {name!r}: of another version; run it again")
    return job


def _of(jobs: list[Record], key: tuple[str, str]) -> list[Record]:
    return sorted((job for job in jobs if (job["material"], job["label"]) == key), key=lambda job: job["seed"])


def _row(before: list[Record], after: list[Record], declared: set[int], timing: Advice | None) -> Row:
    first = (before or after)[0]
    codec = first["label"].split()[0]
    base, new = ([job for job in jobs if job["status"] == "ok"] for jobs in (before, after))
    verdict, why = _unfinished(base, after, declared)
    if not base or not new:
        return Row(first["material"], first["label"], codec, verdict or Verdict.NEW, why)
    base = [job for job in base if not unlike(base[0], job)]
    obstacle = next((reason for job in new if (reason := unlike(base[0], job))), "")
    if obstacle:
        return Row(first["material"], first["label"], codec, verdict or Verdict.UNLIKE, why or obstacle)
    ours, theirs = _paired(base, new)
    changes = [judge(quantity, ours, theirs, base) for quantity in deciding(base[0])]
    others = [judge(quantity, ours, theirs, base) for quantity in shown(base[0])]
    return Row(
        first["material"],
        first["label"],
        codec,
        verdict or next(v for v in _ORDER if any(change.verdict == v for change in changes)),
        why,
        tuple(job["seed"] for job in theirs),
        changes,
        others,
        timing,
        [f"settings: {changed}"] if (changed := other_settings(base[0], new[0])) else [],
    )


def _paired(base: list[Record], new: list[Record]) -> tuple[list[Record], list[Record]]:
    """The jobs of the seeds that both have, all of both where they share none."""
    shared = {job["seed"] for job in base} & {job["seed"] for job in new}
    if not shared:
        return base, new
    ours, theirs = ([job for job in jobs if job["seed"] in shared] for jobs in (base, new))
    return ours, theirs


def _unfinished(base: list[Record], after: list[Record], declared: set[int]) -> tuple[Verdict | None, str]:
    """The verdict on a row whose jobs failed or vanished, and why."""
    if failed := [job for job in after if job["status"] == "failed"]:
        return Verdict.FAILED, f"{_count(failed)} failed: {_plain(failed[0]['error'])}"
    if not base:
        return None, ""
    if missing := [job for job in after if job["status"] == "unavailable"]:
        return Verdict.GONE, f"not available: {_plain(missing[0]['error'])}"
    expected = {job["seed"] for job in base} & declared
    gone = sorted(expected - {job["seed"] for job in after})
    if gone or not after:
        return Verdict.GONE, f"no result of seed {', '.join(map(str, gone))}" if after else "no job of this name"
    return None, ""


def _plain(error: str) -> str:
    """An error on one line, without the colours and other codes that some print."""
    return " ".join("".join(c if c.isprintable() else " " for c in error).split())


def _count(jobs: list[Record]) -> str:
    return "the job" if len(jobs) == 1 else f"{len(jobs)} jobs"


def _notes(base: Run, new: Run, rows: list[Row]) -> Iterator[str]:
    """What a reader of the comparison should know besides."""
    for name, run in (("BASE", base), ("NEW", new)):
        if run.unreadable:
            yield f"{len(run.unreadable)} line(s) of {name} could not be read: {', '.join(map(str, run.unreadable))}"
    if base.starts and new.starts:
        mine, theirs = _conditions(base.starts[-1]), _conditions(new.starts[-1])
        changed = [f"{key} {mine[key]} → {theirs[key]}" for key in mine if mine[key] != theirs[key]]
        if changed:
            yield "not measured under the same conditions: " + "; ".join(changed)
    if alone := [row.name for row in rows if any(_alone(change) for change in row.deciding)]:
        yield f"one seed in BASE, so that the spread is not known and the margin is a guess: {', '.join(alone)}"


def _alone(change: Change) -> bool:
    return bool(change.margin) and change.spread is None


def _conditions(start: Record) -> dict[str, object]:
    packages, machine = start.get("packages", {}), start.get("machine", {})
    return {
        "torch": packages.get("torch"),
        "processor": machine.get("processor"),
        "device": start.get("device"),
        "threads": start.get("threads"),
    }
