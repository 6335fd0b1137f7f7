"""One table as text in cells."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

BOLD, UNDERLINED = "bold", "underlined"  # marks of a cell, if a format can show them


@dataclass(frozen=True)
class Table:
    """Cells as text. A header is a name and, below it, a unit with an arrow to the better end; "" without a unit."""

    kind: str
    title: str
    headers: list[tuple[str, str]]
    rows: list[list[str]]
    notes: list[str] = field(default_factory=list)
    words: int = 1  # the number of columns with words, from the left
    material: str = ""  # the material, if the table is of one
    fold: int = 22  # the width at which a terminal folds the first column, if only that holds words
    marks: dict[tuple[int, int], str] = field(default_factory=dict)  # by row and column: `BOLD` or `UNDERLINED`

    def of_columns(self, kept: Sequence[int]) -> "Table":
        """The table with these columns alone, in this order."""
        marks = {(row, kept.index(i)): mark for (row, i), mark in self.marks.items() if i in kept}
        rows = [[row[i] for i in kept] for row in self.rows]
        return replace(self, headers=[self.headers[i] for i in kept], rows=rows, marks=marks)
