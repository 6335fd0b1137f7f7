"""What codecs reach within a budget: read off curves, at their ends beyond them, or of the rung that is chosen."""

import pytest

from bench.compare.choosing.budgets import BYTES, EAGER, Budget, budgets
from bench.compare.choosing.curves import hulls
from bench.compare.choosing.within import fewest_bytes, mean_ranks, ranked, reached
from bench.records import FLIP, MOST_DB
from tests.bench.compare.choosing.test_budgets import job, run_of, timing
from tests.bench.compare.choosing.test_curves import at_bits

LADDER = [at_bits(f"a x={bits}", bits, score, score) for bits, score in ((8, 20.0), (16, 30.0), (48, 34.0))]


def result_of(folder, *records):
    result = budgets(run_of(folder, *records))
    return result, hulls(result, result.surfaces)


def test_a_size_is_read_off_the_curve_and_at_its_end_beyond_it(tmp_path):
    single = at_bits("b", 20, 31.0, 31.0)  # one rung is no curve
    result, points = result_of(tmp_path / "run", *LADDER, single)

    def at(bits):
        return {line: on["satin"] for line, on in reached(result, points, Budget(BYTES, bits), ["satin"]).items()}

    assert at(4) == {}
    value, bits = at(16 * 3**0.5)["a"]  # halfway from 16 to 48 bits, over their logarithm
    assert (value, bits) == (pytest.approx(32.0), pytest.approx(16 * 3**0.5))
    assert at(128) == {"a": (34.0, pytest.approx(48.0)), "b": (31.0, 20.0)}


def test_a_time_has_the_rung_that_validation_pairs_choose(tmp_path):
    times = [timing(each["job"], 2.0 + 3.0 * rung) for rung, each in enumerate(LADDER)]
    result, points = result_of(tmp_path / "run", *LADDER, *times)
    found = reached(result, points, Budget(EAGER, 8), ["satin"])
    assert found["a"]["satin"].value == 34.0
    assert ranked(result, points, Budget(EAGER, 4), ["satin"]) == {"a": 20.0}


def test_lines_are_ranked_by_their_means_the_least_flip_first(tmp_path):
    jobs = [at_bits(label, 16, 30.0, test) for label, test in (("a", 20.0), ("b", 30.0))]
    for each, flip in zip(jobs, (0.2, 0.1), strict=True):
        each["scores"]["heldout"]["metrics"][FLIP] = {"pooled": flip, "mean": flip}
    result, points = result_of(tmp_path / "run", *jobs)
    budget = Budget(BYTES, 16)
    assert list(ranked(result, points, budget, ["satin"])) == ["b", "a"]
    assert list(ranked(result, points, budget, ["satin"], FLIP)) == ["b", "a"]


def test_the_fewest_bytes_are_those_at_which_a_curve_is_within_half_a_decibel_of_the_best(tmp_path):
    result, points = result_of(tmp_path / "run", *LADDER)
    found = fewest_bytes(result, points)
    assert found == (Budget(BYTES, 64), {"a": 34.0})  # at 32 bits the curve has 32.5


def test_ranks_do_not_depend_on_where_rungs_stand(tmp_path):
    """At 32 bits b has a rung of 31.9 dB, and a has none; but the curve of a has 32.5 there."""
    jobs = []
    for material in ("satin", "rock", "wool"):
        for label, bits, score in (("a", 8, 20.0), ("a", 16, 30.0), ("a", 48, 34.0), ("b", 8, 19.0), ("b", 32, 31.9)):
            jobs.append(at_bits(f"{label} x={bits}", bits, score, score, material=material))
    result, points = result_of(tmp_path / "run", *jobs)
    assert mean_ranks(result, points).mean == {"a": 1.0, "b": 2.0}


def test_beyond_what_a_display_shows_codecs_share_their_rank(tmp_path):
    jobs = []
    for material in ("satin", "rock", "wool"):
        jobs.append(job("a", 10, MOST_DB, MOST_DB, material))
        jobs.append(job("b", 10, MOST_DB, MOST_DB, material))
    result, points = result_of(tmp_path / "run", *jobs)
    assert mean_ranks(result, points).mean == {"a": 1.5, "b": 1.5}
    assert ranked(result, points, Budget(BYTES, 4), ["satin"]) == {"a": MOST_DB, "b": MOST_DB}
