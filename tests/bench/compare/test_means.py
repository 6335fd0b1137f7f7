import math
import random
from statistics import fmean, stdev

import pytest

from bench.compare.comparison import _merged
from bench.compare.quantities import DECIBELS, Quantity
from bench.compare.verdicts import Chance, Change, Verdict

QUANTITY = Quantity("PSNR", "dB", "higher", 2, lambda job: None, DECIBELS, "psnr_display")
MANY = (0.06, 0.18, 0.3, 0.3, 0.25, 0.02, 0.13, 0.13, 0.35, 0.03)  # dB, about those of the rows of `ci` with seeds


def change(rng, deviation):
    base, new = ([rng.gauss(30, deviation) for _ in range(count)] for count in (9, 3))
    chance = Chance(stdev(base) * math.sqrt(1 / 9 + 1 / 3), 8)
    return Change(QUANTITY, fmean(base), fmean(new), Verdict.SAME, chance=chance)


@pytest.mark.parametrize("deviations", [(0.3, 0.35), MANY], ids=["two", "many"])
def test_the_mean_of_rows_scatters_as_it_says(deviations):
    """A plain sum of variances would be too small by a fifth and more: chance decides which rows weigh most."""
    rng = random.Random(0)
    merged = [_merged([change(rng, each) for each in deviations], every=True) for _ in range(2000)]
    variance = fmean(each.difference**2 for each in merged)
    assert fmean(each.chance.error**2 for each in merged) == pytest.approx(variance, rel=0.1)
