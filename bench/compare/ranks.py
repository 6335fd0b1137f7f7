"""Ranks codecs over several materials: mean ranks, with Nemenyi's test."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from bench.compare.statistics import critical_difference, mean_ranks


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
