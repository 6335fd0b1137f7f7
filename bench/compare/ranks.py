"""Ranks codecs over several materials: mean quality, mean rank, materials won, Nemenyi's test.

Source: Demšar, "Statistical comparisons of classifiers over multiple data sets", JMLR 7 (2006): over N materials and k
codecs, two mean ranks that differ by less than q · sqrt(k (k + 1) / 6 N) are not told apart, where q is the quantile of
the studentised range of k groups divided by sqrt(2).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import fmean
from typing import NamedTuple

import numpy as np

from bench.metrics import stats_of
from bench.records import PSNR, Job

ALPHA = 0.05
SAME_DB = 0.005  # tables do not show a smaller difference, so such codecs share a rank
Jobs = Mapping[str, Mapping[str, Sequence[Job]]]  # the jobs of each material and label, one a seed


class Ranks(NamedTuple):
    """The mean rank by codec, 1 for the best, the best first, and the critical difference of any two."""

    mean: dict[str, float]
    critical: float


def ranks(scores: Mapping[str, Sequence[float]]) -> Ranks | None:
    """The mean ranks of codecs by their scores, a list for each codec over the same materials; more is better.

    Ties share their places. None for fewer than two codecs or three materials, which tell nothing apart.
    """
    from scipy.stats import rankdata, studentized_range  # slow to import

    table = np.array(list(scores.values()))
    if table.ndim != 2:  # there are no scores at all
        return None
    codecs, materials = table.shape
    if codecs < 2 or materials < 3:
        return None
    places = rankdata(-table, axis=0)  # (codecs, materials), 1 for the largest score on a material
    mean = dict(zip(scores, places.mean(1).tolist(), strict=True))
    quantile = studentized_range.ppf(1 - ALPHA, codecs, np.inf) / math.sqrt(2)
    critical = float(quantile) * math.sqrt(codecs * (codecs + 1) / (6 * materials))
    best_first = dict(sorted(mean.items(), key=lambda item: item[1]))
    return Ranks(best_first, critical)


@dataclass(frozen=True)
class Standing:
    """One codec over its materials; `rank` and `wins` are None unless it was measured on all materials."""

    label: str
    materials: int
    psnr: float  # dB; mean over slices, then over seeds, then over materials
    rank: float | None = None  # mean over materials, 1 for the best
    wins: int | None = None  # materials on which none is better


def standings(cells: Jobs) -> list[Standing]:
    """Every codec by rank, then PSNR; one that was not measured on all materials has no rank, and comes last."""
    on_each = [_qualities(codecs) for codecs in cells.values()]  # of each material: PSNR by label
    values: dict[str, list[float]] = {}  # by label, one a material
    for qualities in on_each:
        for label, value in qualities.items():
            values.setdefault(label, []).append(value)
    # Those measured on all materials: a rank among fewer materials would not be comparable.
    ranked = [label for label in values if len(values[label]) == len(on_each)]
    places: dict[str, list[float]] = {label: [] for label in ranked}
    wins = dict.fromkeys(ranked, 0)
    for qualities in on_each:
        qualities_of_ranked = {label: qualities[label] for label in ranked}
        for label, place in _places(qualities_of_ranked).items():
            places[label].append(place)
        best = max(qualities_of_ranked.values(), default=0.0)
        for label, quality in qualities_of_ranked.items():
            if quality + SAME_DB >= best:
                wins[label] += 1
    every = []
    for label, of_label in values.items():
        standing = Standing(label, len(of_label), fmean(of_label))
        if label in places:
            standing = replace(standing, rank=fmean(places[label]), wins=wins[label])
        every.append(standing)
    return sorted(every, key=lambda each: (each.rank is None, each.rank, -each.psnr))


def _qualities(codecs: Mapping[str, Sequence[Job]]) -> dict[str, float]:
    """The mean over seeds of the mean PSNR of slices by label; absent where none was measured."""
    qualities = {}
    for label, jobs in codecs.items():
        means = [stats_of(job, PSNR).get("mean") for job in jobs]
        measured = [mean for mean in means if mean is not None]
        if measured:
            qualities[label] = fmean(measured)
    return qualities


def _places(quality: dict[str, float]) -> dict[str, float]:
    """The place of each label on one material, 1 for the best, by its PSNR in dB; codecs within `SAME_DB` of one share
    the mean of their places."""
    rank = {}
    for label, value in quality.items():
        better = sum(other > value + SAME_DB for other in quality.values())
        # Itself is one of them; the difference of two infinite numbers is none, hence `==`.
        alike = sum(other == value or abs(other - value) <= SAME_DB for other in quality.values())
        rank[label] = better + (alike + 1) / 2  # the mean of the places better + 1 to better + alike
    return rank
