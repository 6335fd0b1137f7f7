import math
import random
import re
from statistics import fmean, stdev

import pytest

from bench.compare.comparison import Comparison, _mean_change, compare
from bench.compare.quantities import DECIBELS, Quantity
from bench.compare.rows import ComparedRow
from bench.compare.verdicts import Chance, Change, Verdict
from bench.inputs.errors import NO, NOTHING

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
    merged = [_mean_change([change(rng, each) for each in deviations], every=True) for _ in range(2000)]
    variance = fmean(each.difference**2 for each in merged)
    assert fmean(each.chance.error**2 for each in merged) == pytest.approx(variance, rel=0.1)


def test_a_mean_row_shows_plain_means_and_judges_the_weighted_change():
    """Weights change with the scatter of the other run: a mean that they decide would move without a new number."""
    calm, wild = (Chance(error, 8) for error in (0.01, 1.0))
    changes = [
        Change(QUANTITY, 32.08, 32.07, Verdict.SAME, chance=calm),
        Change(QUANTITY, 18.68, 17.68, Verdict.SAME, chance=wild),
    ]
    merged = _mean_change(changes, every=False)
    assert (merged.base, merged.new) == pytest.approx((25.38, 24.875))
    assert -0.05 < merged.difference < -0.01
    assert merged.loss == -merged.difference


def test_the_last_line_agrees_with_the_exit_code():
    def row(verdict, label="pca", **more):
        change = Change(QUANTITY, 30.0, 29.0, verdict)
        return ComparedRow("satin", label, label, verdict, deciding=[change], **more)

    def counts(comparison):
        return re.findall(r"(\d+) (\w+)", comparison.summary)

    rows = [row(Verdict.SAME)] * 4
    worse = Comparison(rows, [], [row(Verdict.WORSE), row(Verdict.SAME)])
    same = [("4", "rows"), ("4", "same")]
    assert (worse.exit_code, counts(worse)) == (NO, [*same, ("1", "worse"), ("1", "same")])
    assert counts(Comparison(rows, [], [row(Verdict.SAME)])) == same
    gone = ComparedRow("satin", "vq", "vq", Verdict.GONE, allowed=True)
    assert counts(Comparison([*rows, gone], [])) == [("5", "rows"), ("1", "gone"), ("4", "same"), ("1", "of")]
    new = Comparison([ComparedRow("satin", "vq", "vq", Verdict.NEW)], [])
    assert (new.exit_code, counts(new)) == (NOTHING, [("1", "rows"), ("1", "new")])


def test_rows_of_one_seed_allow_their_mean_as_much_as_themselves(make):
    def run(name, psnr):
        return make.run(name, *(make.job("vq", material, psnr=psnr) for material in ("satin", "wool")), seeds=(0,))

    base = run("base", 30.0)
    for lost, verdict in ((0.1, "same"), (0.3, "WORSE")):
        comparison = compare(base, run(f"new {lost}", 30.0 - lost))
        assert {row.verdict for row in (*comparison.rows, *comparison.means)} == {verdict}
