"""Computes the mean difference of two results, slice by slice at the same pairs, with a 95 % interval.

All codecs find the same slices hard, so the difference slice by slice is known far better than either mean. A slice is
all texels for one pair of view and light. A *cell* holds the differences of one material and one seed. For several
materials the interval is Student's over their means, so it includes the scatter of materials, fits and pairs; it holds
for materials like these. For one material the interval comes from a bootstrap, which draws seeds, then pairs of each
seed, with replacement; seeds that are scored at the same pairs draw the same ones. It holds for that material only, and
with one seed it lacks the scatter of fits.
"""

import base64
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache, partial
from pathlib import Path

import numpy as np

from bench.codecs.alike import obstacles
from bench.files.archive import MAX_FILE, read_arrays
from bench.inputs.errors import InputError
from bench.metrics.psnr import psnr
from bench.records import MOST_DB, PSNR, Job, Run, deciding_group, grouped, shown_label

AGAINST = "neubtf-direct"  # the codec that others are compared with, named before anything was measured
FEWEST = 3  # materials on which codecs may be told apart
FALSE = 0.05  # the largest chance that a table of equal codecs tells any of them apart from that codec
DRAWS = 2000
SEED = 0

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
    others = list(others)
    known = dict.fromkeys(map(shown_label, run.jobs))
    for label in (first, *others):
        if label not in known:
            raise InputError(f"against {label!r}: the run has no such label: it has {'; '.join(known)}")
    jobs: dict[str, dict[tuple[str, int], Job]] = {first: {}, **{label: {} for label in others}}
    obstacle = obstacles(run.jobs, run.published)  # by name of job
    for job in run.jobs:
        label = shown_label(job)
        if job["status"] == "ok" and label in jobs and job["job"] not in obstacle:
            jobs[label][job["material"], job["seed"]] = job
    return _against_jobs(run.folder, first, jobs)


def _against_jobs(folder: Path, first: str, jobs: Mapping[str, Mapping[tuple[str, int], Job]]) -> Against:
    """As `against`, for jobs that are given by name, then by material and seed; slices are read in their folder."""
    ours = jobs[first]

    @cache  # each of them is compared with all others
    def slices_of_first(material: str, seed: int) -> np.ndarray | None:
        """The slices of the job of `first` with that material and seed."""
        return decibels(folder, ours[material, seed])

    differences = Against(first, {}, {})
    for label, theirs in jobs.items():
        if label == first:
            continue
        both = [(job, theirs[key]) for key, job in ours.items() if key in theirs]
        try:
            cells = _cells(both, lambda job: slices_of_first(job["material"], job["seed"]), partial(decibels, folder))
        except InputError:  # slices of one codec that cannot be read must not cost the table of all others
            continue
        over_all = interval(cells)
        if over_all is not None:  # None: they have no slices to compare
            differences.over[label] = over_all
        for material, cells_of_material in grouped(cells, lambda cell: cell.material).items():
            on_material = interval(cells_of_material)
            if on_material is not None:
                differences.on.setdefault(material, {})[label] = on_material
    return replace(differences, over=told_apart(differences.over))


def told_apart(over: Mapping[str, Interval]) -> dict[str, Interval]:
    """The differences to a codec named beforehand, with whether each is told apart: by Holm's correction."""
    told = chosen_by_holm({label: each.chance for label, each in over.items()})
    return {label: replace(each, apart=label in told) for label, each in over.items()}


def chosen_by_holm(chances: Mapping[str, float]) -> set[str]:
    """The labels that are told apart, by Holm's correction (1979). `chances` has, by label, the probability of so large
    a difference between equal codecs."""
    told: set[str] = set()
    for label in sorted(chances, key=lambda label: chances[label]):
        limit = FALSE / (len(chances) - len(told))  # after Holm: over the number of those not yet told apart
        if not chances[label] <= limit:  # also if it is no number
            break  # none with a larger chance is told apart either
        told.add(label)
    return told


def chance_if_equal(differences: np.ndarray) -> float:
    """The probability that equal codecs differ as much in the mean over materials; `differences` (materials,) in dB.

    By Student's t; 1 for fewer than `FEWEST` materials, which say nothing about others.
    """
    if len(differences) < FEWEST:
        return 1.0
    _, chance = _student_interval(differences)
    return chance


def interval_between_runs(base: Run, before: Iterable[Job], new: Run, after: Iterable[Job]) -> Interval | None:
    """The mean difference of the jobs of a row in two runs, seed by seed; None if they have no slices to compare."""
    theirs = {job["seed"]: job for job in after}
    pairs = [(job, theirs[job["seed"]]) for job in before if job["seed"] in theirs]
    return interval(_cells(pairs, partial(decibels, base.folder), partial(decibels, new.folder)))


def _cells(pairs: Iterable[tuple[Job, Job]], ours_of: Slices, theirs_of: Slices) -> list[Cell]:
    """The cell of each two jobs that were scored at the same pairs of the same data, and have slices.

    `ours_of` gives the slices of the first job of two, `theirs_of` those of the second.
    """
    cells = []
    for first, second in pairs:
        first_key = first["score_key"]
        second_key = second["score_key"]
        if any(first_key.get(name) != second_key.get(name) for name in ("btf", "deciding")):
            continue
        ours = ours_of(first)
        theirs = theirs_of(second)
        if ours is None or theirs is None:
            continue
        if 0 < len(ours) == len(theirs):  # slices without a number are left out, so lengths may differ
            cells.append(Cell(first["material"], first["seed"], first_key["btf"], theirs - ours))
    return cells


def interval(cells: Sequence[Cell], draws: int = DRAWS) -> Interval | None:
    """The mean over materials of the mean over seeds of the mean over slices, with its interval; None without cells.

    The interval is Student's over the means of the materials, with the chance of so large a mean between equal codecs;
    fewer than `FEWEST` materials say nothing about others, and give a chance of 1. Of one material it is that of a
    bootstrap with so many `draws`; see the module.
    """
    by_material = grouped(cells, lambda cell: cell.material)
    if not by_material:
        return None
    of_materials = []
    for of_seeds in by_material.values():
        of_materials.append(np.mean([cell.differences.mean() for cell in of_seeds]))
    means = np.array(of_materials)  # (materials,) in dB
    if len(means) > 1:
        reach, _ = _student_interval(means)
        low, high = means.mean() - reach, means.mean() + reach
    else:
        # One material says nothing of others, so the interval is of its pairs and fits alone.
        low, high = np.percentile(_bootstrap_means(cells, draws), [2.5, 97.5])
    seeds = max(len(of_seeds) for of_seeds in by_material.values())
    slices = sum(len(cell.differences) for cell in cells)
    return Interval(float(means.mean()), float(low), float(high), len(means), seeds, slices, chance_if_equal(means))


def _student_interval(means: np.ndarray) -> tuple[float, float]:
    """Half the 95 % interval of the mean of means (n,), and the chance of so large a mean if the true one is 0."""
    from scipy.special import stdtr, stdtrit  # slow to import, and needed only here

    mean = abs(means.mean())
    error = means.std(ddof=1) / math.sqrt(len(means))
    freedom = len(means) - 1
    half_interval = float(stdtrit(freedom, 0.975) * error)
    if error > 0:
        return half_interval, float(2 * stdtr(freedom, -mean / error))  # of both tails
    # All means are equal. If they are 0, equal codecs give them for certain, and else never.
    if mean == 0:
        return half_interval, 1.0
    return half_interval, 0.0


def _bootstrap_means(cells: Sequence[Cell], draws: int) -> np.ndarray:
    """Means (draws,) over the drawn seeds and pairs of one material."""
    # The numbers of cells whose seeds are scored at the same pairs, and so draw the same ones.
    alike = grouped(range(len(cells)), lambda number: (cells[number].pairs, len(cells[number].differences)))
    shares, chosen_seeds = _draws_of_slices_and_seeds(tuple(count for _, count in alike), len(cells), draws)
    means = np.empty((len(cells), draws))  # of each seed, over the pairs of each draw
    for shares_of_group, numbers in zip(shares, alike.values(), strict=True):
        differences = np.stack([cells[number].differences for number in numbers])  # (seeds of the group, slices)
        means[numbers] = differences @ shares_of_group.T
    # In each draw, the mean over the seeds that it chooses.
    means_of_draws: np.ndarray = means[chosen_seeds, np.arange(draws)].mean(0)
    return means_of_draws


@lru_cache(maxsize=1)  # the intervals of a table mostly draw from as many slices and seeds
def _draws_of_slices_and_seeds(counts: tuple[int, ...], seeds: int, draws: int) -> tuple[list[np.ndarray], np.ndarray]:
    """How often each slice of each group is drawn, as shares (draws, count) of `counts`, and the numbers of the drawn
    seeds, (seeds, draws)."""
    rng = np.random.default_rng(SEED)
    shares = []
    for count in counts:  # counting drawn numbers takes a seventh of the time of NumPy's `multinomial`
        # Draws are counted together: slice s of draw d has the number d · count + s.
        drawn = rng.integers(0, count, (draws, count)) + count * np.arange(draws)[:, None]
        shares.append(np.bincount(drawn.ravel(), minlength=draws * count).reshape(draws, count) / count)
    return shares, rng.integers(0, seeds, (seeds, draws))


def decibels(folder: Path, job: Job) -> np.ndarray | None:
    """The PSNR (n,) in dB of each slice of the deciding pairs, in the order of the BTF, at most `MOST_DB`.

    Deciding pairs are the held-out ones, or all pairs if none are held out.
    It is read from the file beside the record, or from a reference, which stores it packed; None if it is in neither.
    """
    stored = job.get("slices")
    if isinstance(stored, dict):  # of a reference
        if PSNR not in stored:
            return None
        try:
            return unpacked(stored[PSNR])
        except ValueError as error:
            remedy = "make the reference again"
            raise InputError(f"{folder}: the slices of {job['job']} cannot be read ({error}): {remedy}") from error
    if not stored:
        return None
    path = folder / stored
    if not path.exists():  # the file was not kept with the records
        return None
    try:
        arrays = read_arrays(path, MAX_FILE, (PSNR, "heldout"))
        raw = arrays[PSNR]  # mean squared error of each slice; NaN where the metric does not apply
        heldout = arrays["heldout"]
        if raw.ndim != 1 or raw.shape != heldout.shape or (raw.dtype.kind, heldout.dtype.kind) != ("f", "b"):
            raise ValueError(f"{PSNR} and heldout are {raw.shape} {raw.dtype} and {heldout.shape} {heldout.dtype}")
    except (OSError, ValueError, KeyError) as error:
        remedy = "run it again with --fresh"  # else the record is found again, and no slices are written
        raise InputError(f"{path}: the slices of {job['job']} cannot be read ({error}): {remedy}") from error
    if deciding_group(job["scores"]) == "heldout":
        raw = raw[heldout]
    return np.minimum(psnr(raw[~np.isnan(raw)]), MOST_DB)


def packed(values: np.ndarray) -> str:
    """Encode dB (n,) as text for a reference: in hundredths, as signed numbers of two bytes."""
    hundredths = np.round(100 * values).clip(-32768, 32767).astype("<i2")
    return base64.b64encode(hundredths.tobytes()).decode()


def unpacked(text: str) -> np.ndarray:
    """The dB (n,) of a text from `packed`, at most `MOST_DB`."""
    hundredths = np.frombuffer(base64.b64decode(text), "<i2")
    return np.minimum(hundredths / 100, MOST_DB)
