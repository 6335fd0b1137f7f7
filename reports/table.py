"""One table as text in cells, the best of each column bold, the second underlined.

A *mark* makes a cell bold or underlined. A *note* is a text below a table. A table's *words* are its first columns,
such as that of the codec; the others have *numbers*.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import TYPE_CHECKING

from reports.numbers import NONE

if TYPE_CHECKING:
    import pandas as pd

BOLD, UNDERLINED = "bold", "underlined"  # the marks of cells; plain text shows `DOT` for the first
FEW = 3  # rows that may share a mark: a value that more rows have is no distinction
STALE = " †"  # after a codec whose records are of an older version than the installed one
STALE_NOTE = "†: stale, of an earlier version: the installed one cannot make these numbers again."
DOT = "•"  # before the best of a column in plain text, which has no bold
LEGEND = "Bold: the best of a column. Underlined: the second best."
TERMS = {  # of headers, explained above the tables that have them
    "mean rank": "the place by PSNR among the codecs, mean over materials",
    "won": "so many materials on which no codec has a better PSNR",
    "PSNR": "mean over slices",
    "worst tenth": "mean of the worst tenth of the slices",
    "PSNR pooled": "of the squared error of all slices together",
    "bits per": "8 × bytes of the whole file / texels",
    "× floor": "a multiple of the least time that a query can take, that of one bilinear fetch of a colour",
}
# Of a note: its text, and a function that says of the name of a column whether the text is about it.
Part = tuple[str, Callable[[str], bool]]


class Apart(str):
    """A note that a page shows elsewhere than below its table."""


class Note(str):
    """A note as text, which also knows its parts, each about some columns.

    `of` leaves out the parts about columns that a table does not have. Elsewhere it is as any `str`.
    """

    parts: tuple[Part, ...]
    around: tuple[str, str, str]  # before, between and after the parts

    def __new__(cls, *parts: Part, around: tuple[str, str, str] = ("", " ", "")) -> "Note":
        """The note of these parts, which are joined by `around`; empty, and so false, without any part."""
        whole = ""
        if parts:
            before, between, after = around
            whole = before + between.join(text for text, _ in parts) + after
        note = super().__new__(cls, whole)
        note.parts = parts
        note.around = around
        return note

    def of(self, names: Sequence[str]) -> "Note":
        """The note without the parts that are about none of the columns of these names."""
        parts = [(text, is_about) for text, is_about in self.parts if any(map(is_about, names))]
        return Note(*parts, around=self.around)


class OfData(str):
    """A name or a unit in a header that names a codec or a material, for which a reader may have another name."""


class Spread(str):
    """The unit of a column that shows deviations, “dB ↑ ± seeds”: the `unit` of its numbers, and what is `over`."""

    unit: str
    over: str

    def __new__(cls, unit: str, over: str) -> "Spread":
        """The unit “dB ↑” with what its deviation is over, “± seeds”."""
        spread = super().__new__(cls, f"{unit} {over}".strip())
        spread.unit = unit
        spread.over = over
        return spread


@dataclass(frozen=True)
class Table:
    """Cells as text. A header is a name and, below it, a unit with an arrow to the better end; "" without a unit."""

    kind: str  # one of `reports.KINDS`, or a name of its own, such as "detail"
    title: str
    headers: list[tuple[str, str]]
    rows: list[list[str]]  # a cell for each header
    notes: list[str] = field(default_factory=list)
    words: int = 1  # the number of columns with words, from the left
    material: str = ""  # the material, if the table is of one
    fold: int = 22  # the width at which a terminal folds the first column, if only that holds words
    marks: dict[tuple[int, int], str] = field(default_factory=dict)  # by row and column: `BOLD` or `UNDERLINED`
    values: "pd.DataFrame | None" = None  # the numbers of which the cells were written, of a table that has them

    @property
    def footnotes(self) -> list[str]:
        """The notes, and the legend of the marks, if it has any."""
        return [*self.notes, LEGEND] if self.marks else self.notes

    @property
    def terms(self) -> list[tuple[str, str]]:
        """The terms of `TERMS` that its headers have as a name or a unit, each with its explanation."""
        words = {word.rstrip(" ↑↓") for word in chain.from_iterable(self.headers)}  # names and units, without arrows
        return [(term, explanation) for term, explanation in TERMS.items() if term in words]

    def without_apart(self) -> "Table":
        """The table without the notes that a page shows elsewhere."""
        return replace(self, notes=[note for note in self.notes if not isinstance(note, Apart)])

    def with_short_labels(self) -> "Table":
        """The table without the settings that every label of its column "codec" has; a note says them once.

        A table with a single label stays as it is: all its settings would be left out.
        """
        names = [name for name, _ in self.headers[: self.words]]
        if "codec" not in names:
            return self
        column = names.index("codec")
        labels = list(dict.fromkeys(row[column] for row in self.rows))
        if len(labels) < 2:
            return self
        common = [word for word in labels[0].split() if "=" in word]  # settings of the first label, as "bits=8"
        for label in labels[1:]:
            common = [word for word in common if word in label.split()]
        if not common:
            return self
        short = {label: " ".join(word for word in label.split() if word not in common) for label in labels}
        rows = [[*row[:column], short[row[column]], *row[column + 1 :]] for row in self.rows]
        # Notes name a stale label without its mark.
        in_notes = {label.removesuffix(STALE): cut.removesuffix(STALE) for label, cut in short.items()}
        longest_first = sorted(in_notes, key=len, reverse=True)  # a label may begin with another one
        notes = []
        for note in self.notes:
            text = str(note)
            for label in longest_first:
                text = text.replace(label, in_notes[label])
            notes.append(text)
        return replace(self, rows=rows, notes=[*notes, f"In every row: {' '.join(common)}."])

    def of_columns(self, kept: Sequence[int]) -> "Table":
        """The table with only the columns at these places, in this order, and the notes about them.

        Rows in which these columns of numbers have only dashes, or nothing, are left out. `kept` has the columns of
        words before those of numbers.
        """
        number_columns = [column for column in kept if column >= self.words]
        rows: list[list[str]] = []
        new_places: dict[int, int] = {}  # of the kept rows, by their old places
        for old_place, row in enumerate(self.rows):
            if any(row[column] not in (NONE, "") for column in number_columns):
                new_places[old_place] = len(rows)
                rows.append([row[column] for column in kept])
        marks = {}
        for (old_place, column), mark in self.marks.items():
            if column in kept:  # a marked cell has a number, so its row is kept as well
                marks[new_places[old_place], kept.index(column)] = mark
        headers = [self.headers[column] for column in kept]
        names = [name for name, _ in headers[self.words :]]  # of the kept columns of numbers, which notes are about
        notes = []
        for note in self.notes:
            note_on_kept = note.of(names) if isinstance(note, Note) else note
            if note_on_kept:
                notes.append(note_on_kept)
        return replace(self, headers=headers, rows=rows, notes=notes, marks=marks)
