"""Tables of values become cells: numbers, marks of the best, dashes, and stale rows."""

from math import inf, nan

import pandas as pd

from reports.table import BOLD, STALE_NOTE, UNDERLINED
from reports.values import Column, written

CODEC = Column("codec", "", "codec")


def table_of(column, values, **more):
    frame = pd.DataFrame({"codec": [f"c{number}" for number in range(len(values))], column.field: values} | more)
    return written("made", "a title", frame, [CODEC, column], ["A note."])


def cells(table):
    return [row[1] for row in table.rows]


def marks(table):
    return {row: mark for (row, column), mark in table.marks.items() if column == 1}


def test_numbers_that_read_the_same_are_equally_good():
    table = table_of(Column("PSNR", "dB ↑", "psnr"), [30.04, 29.96, 28.0, 27.0])
    assert cells(table) == ["30.0", "30.0", "28.0", "27.0"]
    assert marks(table) == {0: BOLD, 1: BOLD, 2: UNDERLINED}


def test_the_least_is_the_best_where_the_arrow_points_down():
    table = table_of(Column("time", "× floor ↓", "time", -3), [1234.4, 1233.6, 9.876])
    assert cells(table) == ["1,234", "1,234", "9.88"]
    assert marks(table) == {0: UNDERLINED, 1: UNDERLINED, 2: BOLD}


def test_what_was_not_measured_is_a_dash_and_is_not_compared():
    table = table_of(Column("PSNR", "dB ↑", "psnr"), [nan, 30.0, 31.0])
    assert cells(table) == ["—", "30.0", "31.0"]
    assert marks(table) == {1: UNDERLINED, 2: BOLD}


def test_without_two_different_numbers_or_an_arrow_nothing_is_marked():
    assert not table_of(Column("PSNR", "dB ↑", "psnr"), [30.0, 30.0, nan]).marks
    assert not table_of(Column("validation", "dB", "psnr"), [30.0, 31.0]).marks


def test_an_infinite_number_is_compared():
    table = table_of(Column("rate", "↓", "rate", 0, write=lambda row: str(row["rate"])), [inf, -3.0])
    assert marks(table) == {0: UNDERLINED, 1: BOLD}


def test_marks_stand_where_their_columns_say():
    column = Column("lead", "dB ↑", "lead", signed=True, before=("≥", "bound"), after=("*", "apart"))
    table = table_of(column, [1.0, -2.0, nan], bound=[True, False, True], apart=[False, True, True])
    assert cells(table) == ["≥+1.0", "−2.0*", "—"]


def test_stale_rows_are_marked_and_a_note_says_so():
    table = table_of(Column("PSNR", "dB ↑", "psnr"), [30.0, 31.0], stale=[False, True])
    assert [row[0] for row in table.rows] == ["c0", "c1 †"]
    assert table.notes[-1] == STALE_NOTE
    assert not any("†" in note for note in table_of(Column("PSNR", "dB ↑", "psnr"), [30.0], stale=[False]).notes)
