"""Writes one CSV row per job with every number in full precision, for other programs."""

import csv
import io
import re
from collections.abc import Iterable, Sequence
from typing import Any

from bench.records import Run, flattened
from reports.numbers import NONE
from reports.rows import materials
from reports.table import Table

_NUMBER = re.compile(r"[−+-]?\d[\d,]*(\.\d+)?")


def results_csv(run: Run) -> str:
    """One row a job. Names of columns are the paths of the record's fields: `bytes/total`, `scores/heldout/…/pooled`.

    There are also `metric_version/NAME` and `timing/…`; `not_comparable` says why a row must not be compared. Nothing
    is rounded. An empty field has no finite value or was not measured: `…/exact` counts slices without error.
    """
    places: dict[str, int] = {}  # the place of each column, in the order of appearance
    rows = []
    for row in (row for material in materials(run) for row in material.rows):
        cells: list[Any] = [None] * len(places)
        fields = [*flattened(row.job, row.timing), ("not_comparable", row.obstacle or None)]
        fields += [("timing/not_comparable", row.timing_obstacle or None)] if row.timing else []
        for name, value in fields:
            place = places.setdefault(name, len(places))
            cells += [None] * (place + 1 - len(cells))
            cells[place] = value
        rows.append(cells)
    return as_csv([list(places) or ["job"], *(cells + [None] * (len(places) - len(cells)) for cells in rows)])


def table_csv(tables: Sequence[Table]) -> str:
    """The cells of tables as they are shown, numbers without separators; a line of headers wherever they change."""
    lines: list[Sequence[str | None]] = []
    header: list[str] = []
    for table in tables:
        first, material = (["material"], [table.material]) if table.material else ([], [])
        if header != (header := [*first, *(" ".join(words).strip() for words in table.headers)]):
            lines.append(header)
        lines += [[*material, *map(_plain, row)] for row in table.rows]
    return as_csv(lines)


def _plain(cell: str) -> str | None:
    """A cell as programs read it: 42584 for 42,584, -1.5 for −1.5, and nothing without a number."""
    if cell == NONE:
        return None
    return cell.replace(",", "").replace("−", "-") if _NUMBER.fullmatch(cell) else cell


def as_csv(rows: Iterable[Sequence[Any]]) -> str:
    """Rows of cells, the headers first, as CSV; None is an empty field."""
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows(rows)
    return out.getvalue()
