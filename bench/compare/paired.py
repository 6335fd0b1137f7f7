"""Computes the mean difference of two results, slice by slice at the same pairs, with a 95 % interval.

All codecs find the same slices hard, so the difference slice by slice is known far better than either mean. A *cell*
holds the differences of one material and one seed. For several materials the interval is Student's over their means, so
it includes the scatter of materials, fits and pairs; it holds for materials like these. For one material the interval
comes from a bootstrap, which draws seeds, then pairs of each seed, with replacement; seeds that are scored at the same
pairs draw the same ones. It holds for that material only, and with one seed it lacks the scatter of fits.
"""

import base64
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np

from bench.codecs.alike import obstacles
from bench.compare.statistics import chance_if_equal, interval_over_slices, student, told_by_holm
from bench.files.archive import MAX_FILE, read_arrays
from bench.inputs.errors import InputError
from bench.metrics.psnr import psnr
from bench.records import MOST_DB, PSNR, Job, Run, deciding_group, grouped, scored_unlike, shown_label, view

AGAINST = "neubtf-direct"  # the codec that others are compared with, named before anything was measured

Slices = Callable[[Job], np.ndarray | None]  # the PSNR (n,) of each slice of a job


@dataclass(frozen=True)
class Cell:
    """The differences (n,) of slices, second − first, of a material and seed; `pairs` identifies the pairs."""

    material: str
    seed: int
    pairs: str
    differences: np.ndarray


@dataclass(frozen=True)
class Interval:
    """A mean difference with its 95 % interval, and the numbers of materials, seeds and slices behind it.

    `chance` is the probability of so large a difference between equal codecs; 1 for fewer than `FEWEST` materials,
    which say nothing about others.
    """

    mean: float
    low: float
    high: float
    materials: int
    seeds: int
    slices: int
    chance: float = 1.0
    apart: bool = False  # whether `told_apart` tells the two apart


@dataclass(frozen=True)
class Against:
    """The difference of each other codec to `first`, by label: over all materials that have both, and on each."""

    first: str
    over: dict[str, Interval]
    on: dict[str, dict[str, Interval]]  # by material


def against(run: Run, first: str, others: Iterable[str]) -> Against:
    """The mean differences in dB per slice between codecs of a run and `first`, by the labels that tables show, without
    codecs that have nothing to compare, or whose slices cannot be read. `InputError` for a label that the run lacks.

    Jobs that cannot stand beside the others, such as those on other data than published ones, do not count.
    """
    labels = [first, *others]
    labels_of_run = dict.fromkeys(map(shown_label, run.jobs))
    for label in labels:
        if label not in labels_of_run:
            raise InputError(f"against {label!r}: the run has no such label: it has {'; '.join(labels_of_run)}")
    # Of a job without the key of its scores nothing says at which pairs it was scored.
    scored = [job for job in run.jobs if job["status"] == "ok" and "score_key" in job]
    obstacle_of = obstacles(scored, run.published)  # by name of job
    comparable = [job for job in scored if job["job"] not in obstacle_of]
    return against_jobs(run, first, *(job["job"] for job in comparable if shown_label(job) in labels))


@view
def against_jobs(run: Run, first: str, *jobs: str) -> Against:
    """As `against`, of jobs given by name that may be compared, those of `first` among them. Kept with the run."""
    chosen = set(jobs)
    by_label: dict[str, dict[tuple[str, int], Job]] = {}  # then by material and seed
    for job in run.jobs:
        if job["job"] in chosen:
            by_label.setdefault(shown_label(job), {})[job["material"], job["seed"]] = job
    ours = by_label.pop(first, {})
    slices_of = partial(decibels, run.folder)

    @cache  # the same slices are compared with those of each other label
    def slices_of_first(material: str, seed: int) -> np.ndarray | None:
        """The slices of the job of `first` with that material and seed."""
        return decibels(run.folder, ours[material, seed])

    over: dict[str, Interval] = {}
    on: dict[str, dict[str, Interval]] = {}
    for label, theirs in by_label.items():
        both = [(job, theirs[key]) for key, job in ours.items() if key in theirs]
        try:
            cells = _paired_cells(both, lambda job: slices_of_first(job["material"], job["seed"]), slices_of)
        except InputError:  # slices of one codec that cannot be read must not cost the table of all others
            continue
        over_all = interval(cells)
        if over_all is None:  # they have no slices to compare
            continue
        over[label] = over_all
        for material, cells_of_material in grouped(cells, lambda cell: cell.material).items():
            on_material = interval(cells_of_material)
            if on_material:
                on.setdefault(material, {})[label] = on_material
    return Against(first, told_apart(over), on)


def told_apart(over: Mapping[str, Interval]) -> dict[str, Interval]:
    """The differences to a codec named beforehand, with whether each is told apart: by Holm's correction."""
    told = told_by_holm([each.chance for each in over.values()])
    return {label: replace(each, apart=apart) for (label, each), apart in zip(over.items(), told, strict=True)}


def interval_between_runs(base: Run, before: Iterable[Job], new: Run, after: Iterable[Job]) -> Interval | None:
    """The mean difference in dB, new − base, of the jobs of a row in two runs, seed by seed.

    None if they have no slices to compare. `InputError` if slices cannot be read.
    """
    theirs = {job["seed"]: job for job in after}
    pairs = [(job, theirs[job["seed"]]) for job in before if job["seed"] in theirs]
    return interval(_paired_cells(pairs, partial(decibels, base.folder), partial(decibels, new.folder)))


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
            cells.append(Cell(first["material"], first["seed"], first["score_key"]["btf"], theirs - ours))
    return cells


def interval(cells: Sequence[Cell]) -> Interval | None:
    """The mean over materials of the mean over seeds of the mean over slices, with its interval; None without cells.

    For several materials the interval is Student's, for one that of a bootstrap: see the module and `chance_if_equal`.
    """
    by_material = grouped(cells, lambda cell: cell.material)
    if not by_material:
        return None
    of_seeds = [[cell.differences.mean() for cell in cells_of_one] for cells_of_one in by_material.values()]
    means = np.array([np.mean(each) for each in of_seeds])  # (materials,) in dB
    if len(means) > 1:
        reach, _ = student(means)
        low, high = means.mean() - reach, means.mean() + reach
    else:
        # One material says nothing of others, so the interval is of its pairs and fits alone.
        differences, pairs = [cell.differences for cell in cells], [cell.pairs for cell in cells]
        low, high = interval_over_slices(differences, pairs)
    seeds = max(map(len, of_seeds))
    slices = sum(len(cell.differences) for cell in cells)
    return Interval(float(means.mean()), float(low), float(high), len(means), seeds, slices, chance_if_equal(means))


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
