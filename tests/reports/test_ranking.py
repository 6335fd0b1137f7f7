import pandas as pd

from reports.ranking import standings


def test_ranks_are_means_over_materials_and_what_reads_alike_shares_one():
    psnr = pd.DataFrame({"a": {"x": 31.0, "y": 31.001, "z": 20.0}, "b": {"x": 25.0, "y": 20.0, "z": 21.0}})
    table = standings(psnr)
    assert list(table.index) == ["x", "y", "z"]
    assert (list(table["rank"]), list(table["won"])) == ([1.25, 2.25, 2.5], [2, 1, 0])
    assert tuple(table.loc["x", ["psnr", "materials"]]) == (28.0, 2)


def test_each_of_several_that_none_is_better_than_has_won():
    table = standings(pd.DataFrame({"a": {"x": 30.0, "y": 30.001, "z": 30.002, "w": 29.0}}))
    assert table["rank"].to_dict() == {"x": 2.0, "y": 2.0, "z": 2.0, "w": 4.0}
    assert table["won"].to_dict() == {"x": 1, "y": 1, "z": 1, "w": 0}
