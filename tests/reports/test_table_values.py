"""`reports.table_values`: a table as a frame of numbers."""

from pathlib import Path

import pytest

import reports
from bench.inputs.errors import InputError
from bench.records import load_run
from reports.front import front_table
from reports.numbers import significant
from reports.tables import all_tables

RESULTS = Path(__file__).parents[2] / "docs" / "results"
BUDGETS, QUICK = RESULTS / "budgets.jsonl", RESULTS / "quick.jsonl"


def test_the_front_table_is_a_frame_of_floats_that_read_as_its_cells() -> None:
    frame = reports.table_values("front", BUDGETS)
    (table,) = front_table(load_run(str(BUDGETS)))
    assert [*frame.columns] == [name for name, _ in table.headers]
    assert set(frame.dtypes.drop("codec").map(str)) == {"float64"}
    place = [*frame.columns].index("time")
    for cells, number in zip(table.rows, frame["time"], strict=True):
        assert cells[place] == ("—" if number != number else significant(number))
    assert frame.attrs["units"]["lead"] == "dB"
    assert frame.attrs["directions"]["time"] == "lower"
    assert frame.attrs["notes"]


@pytest.mark.parametrize("kind", ["summary", "main", "slices", "angular", "radiance", "footprints"])
def test_a_table_of_every_kind_of_values_is_a_frame_of_floats_that_read_as_its_cells(kind: str) -> None:
    frame = reports.table_values(kind, QUICK)
    tables = all_tables(load_run(str(QUICK)), kind=kind)
    assert set(frame.dtypes.drop("codec").map(str)) == {"float64"}
    assert [len(table.rows) for table in tables] == [len(table.values) for table in tables]
    assert len(frame) == sum(len(table.rows) for table in tables)
    assert frame.attrs["titles"] == [table.title for table in tables]
    assert len(frame.attrs["notes"]) == len(set(frame.attrs["notes"]))
    for table in tables:
        numbers = table.values.iloc[:, 1:].to_numpy()
        for cells, row in zip(table.rows, numbers, strict=True):
            for cell, number in zip(cells[1:], row, strict=True):
                assert (cell in ("—", "n/a", "n/c")) == (number != number)
    assert not {unit for unit in frame.attrs["units"].values() if "±" in unit}


def test_the_summary_as_a_frame_has_means_ranks_and_differences() -> None:
    frame = reports.table_values("summary", QUICK).set_index("codec")
    assert (frame["mean rank"] >= 1).all()
    assert frame["PSNR"].idxmax() == frame["mean rank"].idxmin()
    assert frame["against"].isna().sum() == 1
    assert frame.attrs["units"]["PSNR"] == "dB"
    assert frame.attrs["directions"] | {"mean rank": "lower", "total": "lower"} == frame.attrs["directions"]


def test_the_papers_table_as_a_frame_has_print_ours_and_their_differences() -> None:
    frame = reports.table_values("paper", RESULTS / "paper-nearest.jsonl").set_index("metric")
    assert set(frame.dtypes.map(str)) == {"float64"}
    assert frame.columns.to_list() == ["fabric01", "fabric03", "ceramic", "embroidery"]
    assert frame.loc["PSNR ↑, print"].to_list() == [26.58, 27.73, 29.19, 28.79]
    for metric, arrow in (("PSNR", "↑"), ("SSIM", "↑"), ("FLIP", "↓")):
        difference = frame.loc[f"{metric} {arrow}, ours"] - frame.loc[f"{metric} {arrow}, print"]
        assert difference.equals(frame.loc[f"{metric}, ours − print"])


def test_a_kind_that_has_no_numbers_is_refused() -> None:
    with pytest.raises(InputError, match="front"):
        reports.table_values("stress", BUDGETS)


def test_without_a_run_there_is_no_table():
    with pytest.raises(InputError, match="no run is given"):
        reports.table_values("summary", [])
