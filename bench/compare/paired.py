"""Computes the mean difference of two results, slice by slice at the same pairs, with a bootstrap interval.

All codecs find the same slices hard, so the difference slice by slice is known far better than either mean. A *cell*
holds the differences of one material and one seed. The bootstrap draws materials, then seeds of each material, then
pairs of each seed, all with replacement; seeds that are scored at the same pairs draw the same ones.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from bench.compare.slices import decibels
from bench.records import Record, Run, shown_label

Array = np.ndarray
DRAWS = 2000


@dataclass(frozen=True)
class Cell:
    """The differences (n,) of slices, second − first, of a material and seed; `pairs` names which pairs they are of."""

    material: str
    seed: int
    pairs: str
    differences: Array


@dataclass(frozen=True)
class Interval:
    """A mean difference with its 95 % interval, and the numbers of materials, seeds and slices behind it."""

    mean: float
    low: float
    high: float
    materials: int
    seeds: int
    slices: int

    @property
    def decided(self) -> bool:
        """Whether the whole interval lies on one side of zero."""
        return self.low > 0 or self.high < 0


def codecs(run: Run, first: str, second: str, materials: Sequence[str] = ()) -> Interval | None:
    """The mean difference in dB per slice between the codecs of a run that tables call `second` and `first`.

    Covers all materials and seeds that have both, or only `materials`; None if there is nothing to compare.
    """
    jobs = {(job["material"], job["seed"], shown_label(job)): job for job in run.jobs if job["status"] == "ok"}
    found = []
    for material, seed, label in jobs:
        other = jobs.get((material, seed, second))
        if label == first and other and (not materials or material in materials):
            found += cells(run, [jobs[material, seed, first]], run, [other])
    return interval(found)


def cells(base: Run, before: Iterable[Record], new: Run, after: Iterable[Record]) -> list[Cell]:
    """The cells of the jobs of two runs, seed by seed, without slices that are exact in either."""
    theirs = {job["seed"]: job for job in after}
    found = []
    for job in before:
        other = theirs.get(job["seed"])
        if other is None or job["score_key"]["btf"] != other["score_key"]["btf"]:
            continue
        ours, others = decibels(base.folder, job), decibels(new.folder, other)
        if ours is None or others is None or len(ours) != len(others):
            continue
        both = np.isfinite(ours) & np.isfinite(others)
        if both.any():
            found.append(Cell(job["material"], job["seed"], job["score_key"]["btf"], others[both] - ours[both]))
    return found


def interval(found: Sequence[Cell], draws: int = DRAWS) -> Interval | None:
    """The mean over materials of the mean over seeds of the mean over slices, with its bootstrap; None of no cells."""
    by_material: dict[str, list[Cell]] = {}
    for cell in found:
        by_material.setdefault(cell.material, []).append(cell)
    if not by_material:
        return None
    rng = np.random.default_rng(0)
    drawn = np.stack([_of_material(each, draws, rng) for each in by_material.values()])
    count = len(drawn)
    if count > 1:
        chosen, order = rng.integers(0, count, (count, draws)), rng.integers(0, draws, (count, draws))
        drawn = drawn[chosen, order]
    low, high = np.percentile(drawn.mean(0), [2.5, 97.5])
    return Interval(
        float(np.mean([_mean(each) for each in by_material.values()])),
        float(low),
        float(high),
        count,
        max(map(len, by_material.values())),
        sum(len(cell.differences) for cell in found),
    )


def _mean(found: Sequence[Cell]) -> float:
    return float(np.mean([cell.differences.mean() for cell in found]))


def _of_material(found: Sequence[Cell], draws: int, rng: np.random.Generator) -> Array:
    """Means (draws,) over the drawn seeds and pairs of one material."""
    weights: dict[tuple[str, int], Array] = {}
    means = np.empty((len(found), draws))
    for row, cell in zip(means, found, strict=True):
        count = len(cell.differences)
        key = (cell.pairs, count)
        if key not in weights:
            weights[key] = rng.multinomial(count, np.full(count, 1 / count), draws) / count
        row[:] = weights[key] @ cell.differences
    chosen = rng.integers(0, len(found), (len(found), draws))
    drawn: Array = means[chosen, np.arange(draws)].mean(0)
    return drawn
