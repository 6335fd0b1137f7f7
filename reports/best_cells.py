"""Marks cells of a table: the best of each column bold, the second underlined."""

import re
from collections import Counter
from collections.abc import Sequence

from reports.table import BOLD, UNDERLINED, Table

Scores = Sequence[Sequence[float | None]]
FEW = 3
LEGEND = "Bold: the best of a column. Underlined: the second best."


def best_cells(rows: Sequence[Sequence[str]], scores: Scores) -> dict[tuple[int, int], str]:
    """The marks of cells by row and column, from a score of each cell (more is better); None gets no mark.

    Cells with equal numbers as shown, whatever deviation follows, are equally good. A column has no mark if all its
    cells are equal or only one has a score. A value shared by more than `FEW` rows is not marked, nor a second of zero.
    """
    marks: dict[tuple[int, int], str] = {}
    for column in range(len(scores[0]) if scores else 0):
        raced = [(row[column], re.split(r" [±(]", rows[i][column])[0], i) for i, row in enumerate(scores)]
        order = sorted(((score, text, i) for score, text, i in raced if score is not None), key=lambda item: -item[0])
        texts = list(dict.fromkeys(text for _, text, _ in order))
        if len(texts) > 1:
            look = {texts[0]: BOLD} | ({} if re.fullmatch("[0.]+", texts[1]) else {texts[1]: UNDERLINED})
            shared = Counter(text for _, text, _ in order)
            marks |= {(i, column): look[text] for _, text, i in order if text in look and shared[text] <= FEW}
    return marks


def legend(table: Table) -> list[str]:
    """The legend of a table's marks, if it has any."""
    return [LEGEND] if table.marks else []
