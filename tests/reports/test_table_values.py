"""`reports.table_values`: a table as a frame of numbers."""

from pathlib import Path

import pytest

import reports
from bench.inputs.errors import InputError
from bench.records import load_run
from reports.front import front_table

BUDGETS = Path(__file__).parents[2] / "docs" / "results" / "budgets.jsonl"


def test_the_front_table_is_a_frame_of_floats_that_read_as_its_cells() -> None:
    frame = reports.table_values("front", BUDGETS)
    (table,) = front_table(load_run(str(BUDGETS)))
    assert [*frame.columns] == [name for name, _ in table.headers]
    assert set(frame.dtypes.drop("codec").map(str)) == {"float64"}
    for cells, numbers in zip(table.rows, frame["pooled"], strict=True):
        cell = cells[[*frame.columns].index("pooled")]
        assert cell == ("—" if numbers != numbers else f"{numbers:.1f}")
    assert frame.attrs["units"]["pooled"] == "dB"
    assert frame.attrs["directions"]["time"] == "lower"
    assert frame.attrs["notes"]


def test_a_kind_that_has_no_numbers_is_refused() -> None:
    with pytest.raises(InputError, match="front"):
        reports.table_values("main", BUDGETS)
