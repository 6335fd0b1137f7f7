"""Computes the mean difference of two results at the same pairs, with a 95 % interval.

For several materials the interval is Student's over their mean differences, so it includes the scatter of materials,
fits and pairs; it holds for materials like these. For one material the interval comes from its slices: all codecs find
the same ones hard, so the difference slice by slice is known far better than either mean. A *cell* holds the
differences of one material and one seed. A bootstrap draws seeds, then pairs of each seed, with replacement; seeds that
are scored at the same pairs draw the same ones. It holds for that material only, and with one seed it lacks the scatter
of fits.
"""

import base64
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import product
from operator import itemgetter
from pathlib import Path
from statistics import fmean

import numpy as np

from bench.codecs.alike import obstacles
from bench.compare.statistics import chance_if_equal, interval_over_slices, student, told_by_holm
from bench.files.archive import MAX_FILE, read_arrays
from bench.inputs.errors import InputError
from bench.metrics import stats_of
from bench.metrics.psnr import psnr
from bench.records import MOST_DB, PSNR, Job, Run, counted, deciding_group, grouped, scored_unlike, view

AGAINST = "neubtf-direct"  # the codec that others are compared with, named before anything was measured

Slices = Callable[[Job], np.ndarray | None]  # the PSNR (n,) of each slice of a job


@dataclass(frozen=True)
class Cell:
    """The differences (n,) of slices, second − first, of two fits, by the seed of the first; `pairs` identifies the
    pairs."""

    seed: int
    pairs: str
    differences: np.ndarray


@dataclass(frozen=True)
class Interval:
    """A mean difference with its 95 % interval, and the numbers of materials and seeds behind it.

    `chance` is the probability of so large a difference between equal codecs; 1 for fewer than `FEWEST` materials,
    which say nothing about others.
    """

    mean: float
    low: float
    high: float
    materials: int
    seeds: int
    chance: float = 1.0
    apart: bool = False  # whether `told_apart` tells the two apart


@dataclass(frozen=True)
class Against:
    """The difference of each other codec to `first`, by label: over all materials of `first`, and on each."""

    first: str
    over: dict[str, Interval]
    on: dict[str, dict[str, Interval]]  # by material


def against(run: Run, first: str, others: Iterable[str]) -> Against:
    """The mean differences in dB per slice between codecs of a run and `first`, by the labels that tables show.

    Codecs that lack a material of `first` have none over all; on one material, and over a single one, codecs without
    slices have none. `InputError` for a label that the run lacks.

    Jobs that cannot stand beside the others, such as those on other data than published ones, do not count.
    """
    labels = [first, *others]
    labels_of_run = dict.fromkeys(job["label"] for job in run.jobs)
    for label in labels:
        if label not in labels_of_run:
            raise InputError(f"against {label!r}: the run has no such label: it has {'; '.join(labels_of_run)}")
    # Of a job without the key of its scores nothing says at which pairs it was scored.
    scored = [job for job in run.jobs if job["status"] == "ok" and "score_key" in job]
    obstacle_of = obstacles(scored, run.published)  # by name of job
    comparable = [job for job in scored if job["job"] not in obstacle_of]
    return against_jobs(run, first, *(job["job"] for job in comparable if job["label"] in labels))


@view
def against_jobs(run: Run, first: str, *jobs: str) -> Against:
    """As `against`, of jobs given by name that may be compared, those of `first` among them. Kept with the run."""
    chosen = {*jobs}
    job_of_name = {job["job"]: job for job in run.jobs if job["job"] in chosen}
    jobs_of_label = grouped(job_of_name.values(), lambda job: job["label"])
    ours = grouped(jobs_of_label.pop(first, []), itemgetter("material"))

    @cache  # those of `first` are compared with those of each other label
    def slices_of_name(name: str) -> np.ndarray | None:
        """The slices of the job of that name."""
        return decibels(run.folder, job_of_name[name])

    def slices_of(job: Job) -> np.ndarray | None:
        """The slices of a job."""
        return slices_of_name(job["job"])

    over: dict[str, Interval] = {}
    on: dict[str, dict[str, Interval]] = {}
    for label, jobs_of_other in jobs_of_label.items():
        theirs = grouped(jobs_of_other, itemgetter("material"))
        for material in ours:
            pairs = _pairs_of_fits(ours[material], theirs.get(material, []))
            with suppress(InputError):  # slices of one codec that cannot be read must not cost the table of all others
                cells = _paired_cells(pairs, slices_of, slices_of)
                if cells and len(cells) == len(pairs):  # else it would be over fewer seeds than its means
                    on.setdefault(material, {})[label] = interval_of(cells)
        if len(ours) > 1:
            over_all = _from_means(ours, theirs)
        else:
            over_all = next((of_material.get(label) for of_material in on.values()), None)
        if over_all:
            over[label] = over_all
    return Against(first, told_apart(over), on)


def _pairs_of_fits(ours: Sequence[Job], theirs: Sequence[Job]) -> list[tuple[Job, Job]]:
    """The fits of two codecs that are compared: seed by seed, or each with each if they have other seeds."""
    job_of_seed = {job["seed"]: job for job in theirs}
    if job_of_seed.keys() == {job["seed"] for job in ours}:
        return [(job, job_of_seed[job["seed"]]) for job in ours]
    return [*product(ours, theirs)]


def _from_means(ours: Mapping[str, Sequence[Job]], theirs: Mapping[str, Sequence[Job]]) -> Interval | None:
    """The difference over the materials of `ours`, by which both sides are given, from the recorded means, over all
    seeds; None where theirs lack one of these, or were scored otherwise there."""
    if ours.keys() - theirs.keys():
        return None
    differences = []
    for material, our_jobs in ours.items():
        their_jobs = theirs[material]
        if any(scored_unlike(our_jobs[0]["score_key"], job["score_key"]) for job in (*our_jobs, *their_jobs)):
            return None
        differences.append(_mean_psnr(their_jobs) - _mean_psnr(our_jobs))
    return over_materials(np.array(differences), max(map(len, (*ours.values(), *theirs.values()))))


def over_materials(differences: np.ndarray, seeds: int) -> Interval:
    """The mean of differences on several materials, (materials,) in dB, with Student's interval."""
    reach, _ = student(differences)
    mean = float(differences.mean())
    return Interval(mean, mean - reach, mean + reach, len(differences), seeds, chance_if_equal(differences))


def _mean_psnr(jobs: Iterable[Job]) -> float:
    """The mean over seeds of the mean PSNR of the slices that decide, in dB, which have `MOST_DB` if they are exact."""
    return fmean(counted(stats_of(job, PSNR).get("mean")) for job in jobs)


def told_apart(over: Mapping[str, Interval]) -> dict[str, Interval]:
    """The differences to a codec named beforehand, with whether each is told apart: by Holm's correction."""
    told = told_by_holm([each.chance for each in over.values()])
    return {label: replace(each, apart=apart) for (label, each), apart in zip(over.items(), told, strict=True)}


def interval_between_runs(base: Run, before: Iterable[Job], new: Run, after: Iterable[Job]) -> Interval | None:
    """The mean difference in dB, new − base, of the jobs of a row on one material in two runs, seed by seed.

    None if they have no slices to compare. `InputError` if slices cannot be read.
    """
    theirs = {job["seed"]: job for job in after}
    pairs = [(job, theirs[job["seed"]]) for job in before if job["seed"] in theirs]
    cells = _paired_cells(pairs, partial(decibels, base.folder), partial(decibels, new.folder))
    return interval_of(cells) if cells else None


def _paired_cells(two_jobs: Iterable[tuple[Job, Job]], slices_of_first: Slices, slices_of_second: Slices) -> list[Cell]:
    """The cell of each two jobs that have slices, scored at the same pairs of the same data and at one exposure."""
    cells = []
    for first, second in two_jobs:
        if scored_unlike(first["score_key"], second["score_key"]):
            continue
        ours = slices_of_first(first)
        theirs = slices_of_second(second)
        if ours is None or theirs is None:
            continue
        if 0 < len(ours) == len(theirs):  # slices without a number are left out, so lengths may differ
            cells.append(Cell(first["seed"], first["score_key"]["btf"], theirs - ours))
    return cells


def interval_of(cells: Sequence[Cell]) -> Interval:
    """The mean over the cells of a material, at least one, of the mean over slices, with the interval of a bootstrap.

    One material says nothing of others, so the interval is of its pairs and fits alone.
    """
    low, high = interval_over_slices([cell.differences for cell in cells], [cell.pairs for cell in cells])
    mean = fmean(cell.differences.mean() for cell in cells)
    return Interval(mean, float(low), float(high), 1, len({cell.seed for cell in cells}))


def decibels(folder: Path, job: Job) -> np.ndarray | None:
    """The PSNR (n,) in dB of each slice of the deciding pairs, in the order of the BTF, at most `MOST_DB`.

    Deciding pairs are the held-out ones, or all pairs if none are held out. The PSNR is read from the file beside the
    record, or from a reference or published results, which store it packed; None if it is in none of these.
    `InputError` if it cannot be read.
    """
    stored = job.get("slices")
    if isinstance(stored, dict):  # of a reference, or of published results
        if PSNR not in stored:
            return None
        try:
            return unpacked(stored[PSNR])
        except ValueError as error:
            remedy = "get the file of records again, or make it again"
            raise InputError(f"{folder}: the slices of {job['job']} cannot be read ({error}): {remedy}") from error
    if not stored or not (folder / stored).exists():  # the file was not kept with the records
        return None
    raw = _errors_of_deciding_pairs(folder / stored, job)
    return np.minimum(psnr(raw[~np.isnan(raw)]), MOST_DB)


def _errors_of_deciding_pairs(path: Path, job: Job) -> np.ndarray:
    """The mean squared error (n,) of each slice of a job's deciding pairs, NaN where the metric does not apply.

    `InputError` if the file at `path` cannot be read.
    """
    try:
        arrays = read_arrays(path, MAX_FILE, (PSNR, "heldout"))
        raw = arrays[PSNR]
        heldout = arrays["heldout"]
        if raw.ndim != 1 or raw.shape != heldout.shape or (raw.dtype.kind, heldout.dtype.kind) != ("f", "b"):
            raise ValueError(f"{PSNR} and heldout are {raw.shape} {raw.dtype} and {heldout.shape} {heldout.dtype}")
    except (OSError, ValueError, KeyError) as error:
        remedy = "run it again with --fresh"  # else the record is found again, and no slices are written
        raise InputError(f"{path}: the slices of {job['job']} cannot be read ({error}): {remedy}") from error
    if deciding_group(job["scores"]) == "heldout":
        return raw[heldout]
    return raw


def packed_slices(job: Job, folder: Path) -> Job:
    """The field with the PSNR of each slice of a job, packed; empty if the run has no file of them. `InputError` if it
    cannot be read."""
    slices = decibels(folder, job)
    return {} if slices is None else {"slices": {PSNR: packed(slices)}}


def packed(values: np.ndarray) -> str:
    """Encode dB (n,) as text for a reference: in hundredths, as signed numbers of two bytes."""
    hundredths = np.round(100 * values).clip(-32768, 32767).astype("<i2")
    return base64.b64encode(hundredths.tobytes()).decode()


def unpacked(text: str) -> np.ndarray:
    """The dB (n,) of a text from `packed`, at most `MOST_DB`."""
    hundredths = np.frombuffer(base64.b64decode(text), "<i2")
    return np.minimum(hundredths / 100, MOST_DB)
