"""Ranks codecs over several materials: mean quality, mean rank, materials won, Nemenyi's test."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import fmean
from typing import NamedTuple

import numpy as np

from bench.compare.statistics import critical_difference, mean_ranks
from bench.metrics import mean_over
from bench.records import PSNR, Job

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
    table = np.array(list(scores.values()))
    if table.ndim != 2:  # there are no scores at all
        return None
    codecs, materials = table.shape
    if codecs < 2 or materials < 3:
        return None
    mean = dict(zip(scores, mean_ranks(table).tolist(), strict=True))
    best_first = dict(sorted(mean.items(), key=lambda item: item[1]))
    return Ranks(best_first, critical_difference(codecs, materials))


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
    psnr_of: dict[str, list[float]] = {}  # by label, one a material
    for codecs in cells.values():
        for label, psnr in _psnr_by_label(codecs).items():
            psnr_of.setdefault(label, []).append(psnr)
    # Those measured on all materials: a rank among fewer materials would not be comparable.
    ranked = [label for label in psnr_of if len(psnr_of[label]) == len(cells)]
    standing_of = {label: Standing(label, len(values), fmean(values)) for label, values in psnr_of.items()}
    if ranked:
        table = np.array([psnr_of[label] for label in ranked])  # (codecs, materials)
        wins = (table + SAME_DB >= table.max(0)).sum(1)
        for label, rank, won in zip(ranked, mean_ranks(table, SAME_DB).tolist(), wins.tolist(), strict=True):
            standing_of[label] = replace(standing_of[label], rank=rank, wins=won)
    return sorted(standing_of.values(), key=lambda standing: (standing.rank is None, standing.rank, -standing.psnr))


def _psnr_by_label(codecs: Mapping[str, Sequence[Job]]) -> dict[str, float]:
    """The mean over seeds of the mean PSNR of slices by label; absent where none was measured."""
    means = {label: mean_over(jobs, PSNR) for label, jobs in codecs.items()}
    return {label: mean for label, mean in means.items() if mean is not None}
