"""Mean ranks by hand, and Nemenyi's critical difference against the numbers of Demšar's paper."""

import pytest

from bench.compare.ranks import ranks


def test_ranks_are_means_over_materials_and_ties_share_their_places():
    found = ranks({"a": (30.0, 20.0, 25.0), "b": (31.0, 20.0, 27.0), "c": (29.0, 21.0, 20.0)})
    assert list(found.mean) == ["b", "a", "c"]
    assert list(found.mean.values()) == pytest.approx([(1 + 2.5 + 1) / 3, (2 + 2.5 + 2) / 3, (3 + 1 + 3) / 3])


@pytest.mark.parametrize(("codecs", "materials", "quantile"), [(4, 14, 2.569), (5, 30, 2.728), (10, 14, 3.164)])
def test_the_critical_difference_is_that_of_the_paper_s_table(codecs, materials, quantile):
    """Table 5(a) of Demšar (2006) lists q; its example of four learners on fourteen data sets has 1.25."""
    found = ranks({str(i): [float(i)] * materials for i in range(codecs)})
    assert ranks({"a": (1.0, 2.0, 3.0)}) is ranks({"a": (1.0, 2.0), "b": (2.0, 1.0)}) is None  # too few of one
    assert found.critical == pytest.approx(quantile * (codecs * (codecs + 1) / (6 * materials)) ** 0.5, rel=2e-4)
