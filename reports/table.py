"""One table as text in cells."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

BOLD, UNDERLINED = "bold", "underlined"  # marks of a cell, if a format can show them


class Note(str):
    """A note of parts, each about the columns whose names it accepts: the text of those about these columns."""

    parts: tuple["Part", ...]
    around: tuple[str, str, str]  # before, between and after the parts

    def __new__(cls, *parts: "Part", around: tuple[str, str, str] = ("", " ", "")) -> "Note":
        before, between, after = around
        note = super().__new__(cls, before + between.join(text for text, _ in parts) + after if parts else "")
        note.parts, note.around = parts, around
        return note

    def of(self, names: Sequence[str]) -> "Note":
        """The note without the parts that are about none of these columns."""
        return Note(*(part for part in self.parts if any(map(part[1], names))), around=self.around)


Part = tuple[str, Callable[[str], bool]]


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
        """The table with these columns alone, in this order, and the notes about them."""
        marks = {(row, kept.index(i)): mark for (row, i), mark in self.marks.items() if i in kept}
        rows = [[row[i] for i in kept] for row in self.rows]
        headers = [self.headers[i] for i in kept]
        names = [name for name, _ in headers[self.words :]]
        notes = [note.of(names) if isinstance(note, Note) else note for note in self.notes]
        return replace(self, headers=headers, rows=rows, notes=list(filter(None, notes)), marks=marks)
