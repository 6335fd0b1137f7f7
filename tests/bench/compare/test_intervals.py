"""The rule of the summary, simulated: a short form of benchmarks/intervals.py."""

from pathlib import Path

import pytest
from intervals import Scatter, chances

RECORDS = Path(__file__).parents[3] / "docs" / "results" / "standard.jsonl"


@pytest.fixture(scope="module")
def scatter():
    return Scatter.of(RECORDS)


@pytest.mark.parametrize(("codecs", "materials", "seeds"), [(20, 2, 1), (20, 4, 3), (20, 9, 1), (2, 2, 3), (2, 9, 1)])
def test_equal_codecs_are_told_apart_in_eight_of_a_hundred_tables_at_most(scatter, codecs, materials, seeds):
    wrong, _ = chances(scatter, codecs, materials, seeds, 2000 // codecs)
    assert wrong <= 0.08


def test_a_decibel_is_seen_where_all_materials_agree_on_it():
    _, seen = chances(Scatter(materials=[0.1], fits=0.1, slices=0.1), 2, 9, 1, 50)
    assert seen > 0.4  # of the two codecs one is the better, so at most one of two rows
