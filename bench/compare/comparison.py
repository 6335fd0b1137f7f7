"""Compares two runs: finds what got worse by more than chance and by enough to matter.

The base is the older run, or a reference that was kept of it; new is the run under test. The numbers of a row are means
over the seeds that both runs have, or over all seeds if they share none. `bench.compare.quantities` says which numbers
decide the verdict on a row, `bench.compare.verdicts` by which rules. Fits scatter independently, so the mean of several
rows can show a loss that no single row can tell from chance. Imports neither PyTorch nor pandas.
"""

import json
import math
from collections import Counter
from collections.abc import Iterator, Sequence, Set
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from itertools import chain
from statistics import fmean

from bench.compare.quantities import Tolerance
from bench.compare.rows import ORDER, ComparedRow, comparable_times, compare_row, gravest_verdict, multiples
from bench.compare.verdicts import DECIDED, Chance, Change, Verdict, verdict
from bench.inputs.errors import FAILED, FINE, NO, NOTHING, InputError, did_you_mean, visible
from bench.records import Job, Run, RunStart, Stress, by_row, grouped, method_of, planned_jobs, require

FORBIDDEN = (Verdict.WORSE, Verdict.GONE, Verdict.FAILED, Verdict.UNLIKE)


@dataclass(frozen=True)
class Comparison:
    """Two runs compared."""

    rows: list[ComparedRow]
    notes: list[str]
    means: list[ComparedRow] = field(default_factory=list)  # means of each codec over its materials, and of all codecs

    def having(self, *verdicts: Verdict) -> list[ComparedRow]:
        """The rows with one of these verdicts."""
        return [row for row in self.rows if row.verdict in verdicts]

    @property
    def summary(self) -> str:
        """One line that counts the rows by verdict, and their means where not all are the same: it agrees with the
        exit code."""
        parts = [f"{len(self.rows)} rows: {_counts_in_words(self.rows) or 'no rows'}"]
        if any(row.verdict != Verdict.SAME for row in self.means):
            parts.append(f"means of rows: {_counts_in_words(self.means)}")
        allowed = sum(not row.forbids for row in self.having(Verdict.GONE, Verdict.UNLIKE))
        if allowed:
            parts.append(f"{allowed} of them allowed")
        if self.exit_code == NOTHING:
            parts.append("nothing can be compared")
        return "; ".join(parts)

    @property
    def exit_code(self) -> int:
        """3: a job failed; 4: nothing to compare; 1: a row is worse, or gone or unlike and not allowed; 0: else."""
        if self.having(Verdict.FAILED):
            return FAILED
        changes = chain.from_iterable(row.deciding for row in self.rows)
        # Without any number that was compared, "nothing got worse" would say nothing.
        if not any(change.verdict in DECIDED for change in changes):
            return NOTHING
        if any(row.forbids for row in (*self.rows, *self.means)):
            return NO
        return FINE


def _counts_in_words(rows: Sequence[ComparedRow]) -> str:
    """The numbers of rows by verdict: `1 worse, 3 same`."""
    counts = Counter(row.verdict for row in rows)
    return ", ".join(f"{counts[each]} {each.lower()}" for each in (*ORDER, Verdict.NEW) if counts[each])


def compare(
    base: Run, new: Run, materials: Sequence[str] = (), codecs: Sequence[str] = (), allow: Sequence[str] = ()
) -> Comparison:
    """Compare two runs: all rows, or those of some materials and codecs.

    `allow` names rows that may be gone or not comparable: a codec, a label, a material, `material/label`, or a pattern.
    Raises `InputError` for a name that neither has, for a damaged base, and for a job that lacks a needed field.
    """
    check_whole(base)
    every = [*base.jobs, *new.jobs]
    check_names("material", materials, {job["material"] for job in every})
    check_names("codec", codecs, set(map(method_of, every)))
    # The jobs of both runs that are compared, and their times.
    after = _jobs_to_compare(new, materials, codecs)
    before = _with_current_labels(_jobs_to_compare(base, materials, codecs), after)
    times_before = multiples(before, base.timings)
    times_after = multiples(after, new.timings)
    declared_seeds = set(chain.from_iterable(start.get("seeds", ()) for start in new.starts))
    expected_seeds = declared_seeds or {job["seed"] for job in after}  # if no start says its seeds
    planned = grouped(chain.from_iterable(map(planned_jobs, new.starts)), lambda job: (job.material, job.label))

    # Each row of either run, by material and label, with its jobs in the order of their seeds.
    rows_before = by_row(sorted(before, key=lambda job: job["seed"]))
    rows_after = by_row(sorted(after, key=lambda job: job["seed"]))
    rows = []
    for key in _rows_in_order([*before, *after]):
        timing = comparable_times(times_before.get(key), times_after.get(key))
        # A codec may have seeds of its own.
        seeds = {job.seed for job in planned.get(key, []) if job.seed is not None} or expected_seeds
        row = compare_row((base, new), rows_before.get(key, []), rows_after.get(key, []), seeds, timing)
        rows.append(replace(row, allowed=any(_pattern_names(pattern, row) for pattern in allow)))
    return Comparison(rows, list(_notes(base, new, rows)), means(rows))


def _rows_in_order(jobs: Sequence[Job]) -> Iterator[tuple[str, str]]:
    """The rows of jobs, by material and label: materials in the order in which they first appear, labels in theirs."""
    for row_keys in grouped(by_row(jobs), lambda key: key[0]).values():
        yield from row_keys


def _jobs_to_compare(run: Run, materials: Sequence[str], codecs: Sequence[str]) -> list[Job]:
    """The jobs of these materials and codecs, all where none are given. `InputError` if one lacks a needed field."""
    jobs = []
    for job in run.jobs:
        if materials and job["material"] not in materials:
            continue
        if codecs and method_of(job) not in codecs:
            continue
        if job["status"] == "ok":  # others have no numbers
            require(job, "comparison", run.folder)
        jobs.append(job)
    return jobs


def _pattern_names(pattern: str, row: ComparedRow) -> bool:
    """Whether a pattern of `allow` names a row: by material and label, by label, by codec or by material."""
    names = (row.name, row.label, row.method, row.material)
    return any(fnmatchcase(name, pattern) for name in names)


def means(rows: Sequence[ComparedRow]) -> list[ComparedRow]:
    """A mean row for each codec with several rows, and one for all codecs; none for fewer than two rows."""
    rows_of_codec = grouped(rows, lambda row: row.method)
    mean_rows = [_mean_row(name, of_codec, every=False) for name, of_codec in rows_of_codec.items()]
    mean_rows.append(_mean_row("all codecs", list(rows), every=True))
    return [row for row in mean_rows if row is not None]


def _mean_row(label: str, rows: list[ComparedRow], every: bool) -> ComparedRow | None:
    """The row of means over several rows; None where no quantity got a verdict on two or more of them.

    `every` says that the rows are of all codecs, not of one: their mean has a tolerance of its own.
    """
    # Sizes, which have no metric, are exact on each row; and a mean with an infinite number says nothing.
    decided = [
        change for row in rows for change in row.deciding if change.quantity.metric and change.verdict in DECIDED
    ]
    by_quantity = grouped(filter(_is_finite, decided), lambda change: change.quantity.name)
    merged = [_mean_change(of_quantity, every) for of_quantity in by_quantity.values() if len(of_quantity) > 1]
    if not merged:
        return None
    return ComparedRow("all materials", label, label, gravest_verdict(merged), deciding=merged)


def _is_finite(change: Change) -> bool:
    """Whether both values of a change, of base and of new, are finite numbers."""
    return all(value is not None and math.isfinite(value) for value in (change.base, change.new))


def _mean_change(changes: list[Change], every: bool) -> Change:
    """The change of one quantity over some rows, all with finite values: the plain means of base and new, to show, and
    a weighted mean of their differences, which decides, with its margin.

    Rows that scatter more weigh less. `every` is as in `_mean_row`.
    """
    quantity = changes[0].quantity
    tolerance = quantity.tolerance
    assert tolerance is not None, "a deciding quantity has a tolerance"
    weights = _weights(changes, tolerance)
    chance = _scatter_of_mean(changes, weights)
    has_unknown = any(change.chance is None and change.spread is None for change in changes)  # rows of one seed
    margin = _margin_of_mean(tolerance, chance, every, has_unknown)
    base = fmean(change.base for change in changes if change.base is not None)
    new = fmean(change.new for change in changes if change.new is not None)
    differences = [change.difference or 0.0 for change in changes]
    weighted = math.fsum(weight * difference for weight, difference in zip(weights, differences, strict=True))
    merged = Change(quantity, base, new, Verdict.SHOWN, weighted=weighted)
    return replace(merged, verdict=verdict(merged.loss, margin), margin=margin, chance=chance)


def _weights(changes: list[Change], tolerance: Tolerance) -> list[float]:
    """The share of each row in a mean: the inverse of its variance, with which the mean of equal losses scatters least.

    The square of `tolerance.common` is added to it, so that a row that hardly scatters does not outweigh all others.
    """
    inverse = []
    for change in changes:
        error = change.chance.error if change.chance else 0.0  # of a row that does not scatter
        inverse.append(1 / (error**2 + tolerance.common**2))
    total = math.fsum(inverse)
    return [share / total for share in inverse]


def _margin_of_mean(tolerance: Tolerance, chance: Chance | None, every: bool, has_unknown: bool) -> float:
    """How much a mean may lose, at least as much as chance explains; `every` is as in `_mean_row`.

    `has_unknown` says that the scatter of some row is not known.
    """
    if has_unknown:
        least = tolerance.one_seed
    elif every:
        least = tolerance.common
    elif chance is not None:
        least = tolerance.drawn
    else:
        least = tolerance.certain
    return least if chance is None else max(least, chance.margin(tolerance))


def _scatter_of_mean(changes: list[Change], weights: list[float]) -> Chance | None:
    """The scatter of a weighted mean of differences; None if no difference scatters.

    Its variance is the sum of the rows' variances times their squared weights, with the degrees of freedom of Welch and
    Satterthwaite. A row that by chance scatters little in its seeds weighs more, so this sum is too small: it is
    corrected after Meier, "Variance of a weighted mean", Biometrics 9(1), 1953.
    """
    variances = []
    for_freedom = []  # the terms of Welch and Satterthwaite's sum
    for_meier = []  # the terms of Meier's sum
    for weight, change in zip(weights, changes, strict=True):
        if change.chance is not None:
            variance = (weight * change.chance.error) ** 2
            variances.append(variance)
            for_freedom.append(variance**2 / change.chance.freedom)
            for_meier.append(weight * (1 - weight) / change.chance.freedom)
    total = math.fsum(variances)
    if not total:  # no row scatters
        return None
    freedom = total**2 / math.fsum(for_freedom)
    correction = 1 + 4 * math.fsum(for_meier)
    return Chance(math.sqrt(total * correction), freedom)


def _with_current_labels(before: list[Job], after: list[Job]) -> list[Job]:
    """The jobs of `before`. A row that `after` lacks gets the label that `after` has for equal settings, if there is
    one, and if no other row of `before` has that.

    Labels name the settings that differ from the defaults, so a new default gives the same settings another label.
    """
    rows_before = by_row(before)
    rows_after = by_row(after)
    label_after = {_identity(job): job["label"] for job in after if job["status"] == "ok"}
    renamed = []
    for (material, label), jobs in rows_before.items():
        finished = [job for job in jobs if job["status"] == "ok"]
        new_label = label_after.get(_identity(finished[0]), label) if finished else label
        if (material, label) in rows_after or (material, new_label) in rows_before:
            new_label = label
        renamed += [job | {"label": new_label} for job in jobs]  # also those that failed
    return renamed


def _identity(job: Job) -> tuple[str, ...]:
    """Material, codec and settings of a finished job, whatever its label."""
    return job["material"], method_of(job), json.dumps(job["fit_key"]["settings"], sort_keys=True)


def check_whole(base: Run) -> None:
    """Raise `InputError` if a line of the base is damaged: its jobs would be lost without a word."""
    if base.unreadable:
        lines = ", ".join(map(str, base.unreadable))
        why = f"line(s) {lines} cannot be read, so their jobs would be lost"
        remedy = "get the file again, or remove the lines if no job is lost"
        raise InputError(f"{base.folder / base.file}: {why}: {remedy}")


def check_names(option: str, names: Sequence[str], names_of_runs: set[str]) -> None:
    """Raise `InputError` for a name that neither run has."""
    for name in names:
        if name not in names_of_runs:
            raise InputError(f"--{option} {name}: neither run has it{did_you_mean(name, names_of_runs)}")


def _notes(base: Run, new: Run, rows: list[ComparedRow]) -> Iterator[str]:
    """Sentences that tables show below the comparison: unreadable lines, changed conditions, bases with one seed."""
    if new.unreadable:
        yield f"{len(new.unreadable)} line(s) of NEW could not be read: {', '.join(map(str, new.unreadable))}"
    if base.starts and new.starts:
        before = _conditions_of(base.starts[-1])
        after = _conditions_of(new.starts[-1])
        changed = [f"{key} {before[key]} → {after[key]}" for key in before if before[key] != after[key]]
        if changed:
            yield "not measured under the same conditions: " + "; ".join(changed)
    # `spread` is None where one seed alone measures the scatter, and `margin` where a number does not decide.
    guessed = [row.name for row in rows if any(change.margin and change.spread is None for change in row.deciding)]
    if guessed:
        yield (
            "BASE has one seed, or shares only one with NEW at the same pairs, so the spread is unknown and the margin "
            f"is a guess: {', '.join(guessed)}"
        )


def _conditions_of(start: RunStart) -> dict[str, object]:
    """What numbers and times of a run depend on besides the suite, by name; None where its start does not say it."""
    fields = {"torch": start.get("packages", {}).get("torch"), **start.get("machine", {}), **start}
    return {name: fields.get(name) for name in ("torch", "processor", "capability", "device", "threads")}


def compare_extremes(base: Run, new: Run, codecs: Sequence[str] = (), allow: Sequence[str] = ()) -> tuple[str, int]:
    """Compare two stress tests cell by cell; returns the cells that got worse, as text, and the exit code.

    A stress test asks each codec at extremes, such as grazing directions; a cell is `CODEC: EXTREME`. Cells of `codecs`
    are compared, by default those of all codecs of the base. `allow` has patterns of cells that may get worse.

    A codec's version does not matter: an extreme that held must still hold; see `docs/stress.md`. The code is 1 if a
    cell that `allow` does not name got worse, 4 if the two have no cell in common, else 0. Raises `InputError` for a
    codec that neither has, and for a damaged base.
    """
    check_whole(base)
    subjects_of_base = {record["subject"] for record in base.stress}  # names of codecs
    subjects_of_new = {record["subject"] for record in new.stress}
    check_names("codec", codecs, subjects_of_base | subjects_of_new)
    subjects = set(codecs) or subjects_of_base
    cells_of_base = _cells_of_subjects(base, subjects)
    cells_of_new = _cells_of_subjects(new, subjects)
    if not cells_of_base.keys() & cells_of_new.keys():
        return "the two stress tests have no cell in common", NOTHING
    worse = []  # the cells that held and do not any more, in words
    for name, before in cells_of_base.items():
        after = cells_of_new.get(name)
        allowed = any(fnmatchcase(name, pattern) for pattern in allow)
        if _holds(before) and not _holds(after) and not allowed:
            worse.append(f"{name} {_failure(after)}")
    held = sum(map(_holds, cells_of_new.values()))
    lines = [*map(visible, worse), f"{held} cells hold, {len(worse)} got worse"]
    return "\n".join(lines), NO if worse else FINE


def _holds(record: Stress | None) -> bool:
    """Whether an extreme held; None is one that was not tried."""
    return record is not None and record["verdict"] == "pass"


def _failure(record: Stress | None) -> str:
    """How a cell that held got worse, in words that follow its name; None is a cell that was not tried."""
    if record is None:
        return "is gone"
    return f"held, and is now {record['verdict']}: {record['detail'] or record['figure']}"


def _cells_of_subjects(run: Run, subjects: Set[str]) -> dict[str, Stress]:
    """The records of a stress test of these subjects, by the name of the cell: `CODEC: EXTREME`."""
    records = [record for record in run.stress if record["subject"] in subjects]
    return {f"{record['subject']}: {record['extreme']}": record for record in records}
