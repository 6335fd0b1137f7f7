"""The rule of the summary, simulated: a short form of tools/intervals.py."""

import pytest
from intervals import Scatter, chances


@pytest.mark.parametrize(("codecs", "materials", "seeds"), [(20, 2, 1), (20, 3, 3), (20, 9, 1), (2, 3, 3), (2, 9, 1)])
def test_equal_codecs_are_told_apart_in_eight_of_a_hundred_tables_at_most(codecs, materials, seeds):
    wrong, _ = chances(Scatter(), codecs, materials, seeds, 2000 // codecs)
    assert wrong <= 0.08


def test_a_decibel_is_seen_where_all_materials_agree_on_it():
    _, seen = chances(Scatter(materials=[0.1], fits=0.1, slices=0.1), 2, 9, 1, 50)
    assert seen > 0.8
