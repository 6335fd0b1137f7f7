"""One table as text in cells."""

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Table:
    """Cells as text. A header is a name and, below it, a unit with an arrow to the better end; "" where none is."""

    kind: str
    title: str
    headers: list[tuple[str, str]]
    rows: list[list[str]]
    notes: list[str] = field(default_factory=list)
    words: int = 1  # how many columns, from the left, hold words
    material: str = ""  # where the table is of one
    fold: int = 22  # the width at which a terminal folds the first column, where that alone holds words
