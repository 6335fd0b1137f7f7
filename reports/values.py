"""Writes tables of values as cells: numbers stay numbers until here.

A table of values is a frame with a row for each row of the table. Beside it stand its columns as specifications: where
the values come from, how they are written, and which end is the better one. Marks such as “≥” come from boolean
columns of the frame.
"""

from collections.abc import Callable, Hashable, Mapping, Sequence
from math import inf, isnan, nan
from typing import Any, NamedTuple

import pandas as pd

from reports.numbers import EXACT, NONE, as_read, fixed, signed, significant
from reports.table import BOLD, FEW, STALE, STALE_NOTE, UNDERLINED, Spread, Table

Row = Mapping[Hashable, Any]  # a row of the frame by column
_ENDS = {"↑": "higher", "↓": "lower"}  # the better end of a column, by its arrow
WHY = "{}, why not"  # the column that says in words why another has no number, or ""


class Column(NamedTuple):
    """A column of a table: its two lines of header, and how it is written from a column of a frame.

    Values are words, or numbers: an infinite one reads “exact”. NaN, where there is none, reads as the words in the
    column `WHY` of the field, or as a dash.
    """

    name: str
    unit: str  # with an arrow to the better end, if one is; "" without a unit
    field: str  # the column of the frame
    digits: int = 1  # decimals; −n: n significant digits
    signed: bool = False
    better: str = ""  # "↑" or "↓" where the unit has no arrow but the best is marked all the same
    ranked: bool = True  # whether the best and the second best are marked
    before: tuple[str, str] = ("", "")  # a mark before the number, and the boolean column that says where it stands
    after: tuple[str, str] = ("", "")  # the same, of a mark after it
    write: Callable[[Row], str] | None = None  # the whole cell of a row, where it is not just a number
    beside: str = ""  # the column of a second number in the cell, such as a deviation
    pair: str = " ± {}"  # how it stands there
    beside_digits: int | None = None  # as `digits`; None: those of the first number
    unranked: str = ""  # the boolean column that says which rows get no mark, although they have a number

    @property
    def arrow(self) -> str:
        """The arrow to the better end; "" if no end is better."""
        last = self.better or self.unit[-1:]
        return last if last in _ENDS else ""

    def cell(self, row: Row) -> str:
        """The cell of a row."""
        if self.write:
            return self.write(row)
        value = row[self.field]
        if isinstance(value, str):
            return value
        if pd.isna(value):
            return row.get(WHY.format(self.field)) or NONE
        if value == inf:
            return EXACT
        before = self.before[0] if self.before[1] and row[self.before[1]] else ""
        after = self.after[0] if self.after[1] and row[self.after[1]] else ""
        beside = ""
        if self.beside and not pd.isna(row[self.beside]):
            digits = self.digits if self.beside_digits is None else self.beside_digits
            beside = self.pair.format(self._number(row[self.beside], digits))
        return before + self._number(value, self.digits) + beside + after

    def _number(self, value: float, digits: int) -> str:
        """A finite number with `digits`, as the field of this name has them, and a sign if the column is `signed`."""
        if digits < 0:
            return significant(value, -digits)
        return signed(value, digits) if self.signed else fixed(value, digits)


def written(
    kind: str,
    title: str,
    values: pd.DataFrame,
    columns: Sequence[Column],
    notes: Sequence[str],
    words: int = 1,
    material: str = "",
) -> Table:
    """The table of cells, for the fields of `Table`, with its best and second best values marked.

    A column `stale` of `values` says which rows the installed version of their codec cannot make again: they are marked
    in their column "codec", or else in the first.
    """
    fields = [column.field for column in columns]
    place_of_codec = fields.index("codec") if "codec" in fields else 0
    rows = []
    for row in values.to_dict("records"):
        cells = [column.cell(row) for column in columns]
        if row.get("stale"):
            cells[place_of_codec] += STALE
        rows.append(cells)
    headers = [(column.name, column.unit) for column in columns]
    all_notes = [*notes, STALE_NOTE] if "stale" in values and values["stale"].any() else [*notes]
    marks = {}
    for number, column in enumerate(columns):
        for row_number, mark in _marked(values, column).items():
            marks[row_number, number] = mark
    by_header = _values_by_header(values, columns, words)
    return Table(kind, title, headers, rows, all_notes, words, material, marks=marks, values=by_header)


def _values_by_header(values: pd.DataFrame, columns: Sequence[Column], word_columns: int) -> pd.DataFrame:
    """The values of a table by the headers of its columns; `attrs` has their units and better ends.

    A column with any number has floats: NaN where a word, such as “n/c”, or nothing stands in place of one.
    """
    headers = [str(column.name) for column in columns]
    shown_values = []
    names = []
    units = {}
    directions = {}
    for place, column in enumerate(columns):  # by place, because two columns may have one field
        as_stored = values[column.field].reset_index(drop=True)
        numbers = pd.to_numeric(as_stored, errors="coerce").astype(float)
        is_words = place < word_columns or (numbers.isna().all() and not as_stored.isna().all())
        shown_values.append(as_stored if is_words else numbers)
        unit = (column.unit.unit if isinstance(column.unit, Spread) else column.unit).rstrip(" ↑↓")
        name = headers[place]
        if headers.count(name) > 1:  # what stands below tells them apart
            name = f"{name} {unit}".strip()
        names.append(name)
        if unit:
            units[name] = unit
        if column.arrow:
            directions[name] = _ENDS[column.arrow]
    named = pd.concat(shown_values, axis=1)
    named.columns = pd.Index(names, dtype=object)  # strings of pandas cannot hold every name
    named.attrs = {"units": units, "directions": directions}
    return named


def _marked(values: pd.DataFrame, column: Column) -> dict[int, str]:
    """The marks of the best and the second best of a column, by the number of their rows.

    Values that read the same are equally good. There is no mark without two different ones, for those that more than
    `FEW` rows share, nor for a second best of zero, unless it is a difference.
    """
    if not column.ranked or not column.arrow:
        return {}

    def as_ranked(value: Any, is_unranked: bool) -> float:
        """A value of the column as it reads; NaN if it gets no mark."""
        if is_unranked or isinstance(value, str):
            return nan
        if value == inf and column.arrow == "↓" and not column.write:  # it reads “exact”, the best by any measure
            return -inf
        return as_read(value, column.digits)

    unranked = values[column.unranked] if column.unranked else [False] * len(values)
    read = list(map(as_ranked, values[column.field], unranked))
    best_first = sorted({value for value in read if not isnan(value)}, reverse=column.arrow == "↑")
    if len(best_first) < 2:
        return {}
    marks = {}
    for value, mark in zip(best_first, (BOLD, UNDERLINED), strict=False):
        rows = [row for row, value_of_row in enumerate(read) if value_of_row == value]
        if len(rows) <= FEW and (mark == BOLD or value or column.signed):
            marks.update(dict.fromkeys(rows, mark))
    return marks
