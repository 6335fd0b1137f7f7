"""Mean ranks of codecs over materials, with the critical difference of Nemenyi's test.

Source: Demšar, "Statistical comparisons of classifiers over multiple data sets", JMLR 7 (2006): over N materials and k
codecs, two mean ranks that differ by less than q · sqrt(k (k + 1) / 6 N) are not told apart, where q is the quantile of
the studentised range of k groups divided by sqrt(2).
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

ALPHA = 0.05


class Ranks(NamedTuple):
    """The mean rank by codec, 1 for the best, the best first, and the critical difference of any two."""

    mean: dict[str, float]
    critical: float


def ranks(scores: Mapping[str, Sequence[float]]) -> Ranks | None:
    """The mean ranks of codecs by their scores on the same materials, more is better; ties share their places.

    None for fewer than two codecs or three materials, which tell nothing apart.
    """
    from scipy.stats import rankdata, studentized_range  # slow to import

    table = np.array(list(scores.values()))
    codecs, materials = table.shape if table.ndim == 2 else (0, 0)
    if codecs < 2 or materials < 3:
        return None
    mean = dict(zip(scores, rankdata(-table, axis=0).mean(1).tolist(), strict=True))
    quantile = studentized_range.ppf(1 - ALPHA, codecs, np.inf) / math.sqrt(2)
    critical = float(quantile) * math.sqrt(codecs * (codecs + 1) / (6 * materials))
    return Ranks(dict(sorted(mean.items(), key=lambda each: each[1])), critical)
