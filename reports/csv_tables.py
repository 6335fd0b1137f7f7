"""Writes one CSV row per job with every number in full precision, for other programs."""

import csv
import io
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from bench.records import Run, flattened
from reports.numbers import NONE
from reports.rows import materials
from reports.table import Table

_NUMBER = re.compile(r"[−+-]?\d[\d,]*(\.\d+)?")


def results_csv(run: Run) -> str:
    """One row a job, nothing rounded; a column is the path of a record's field: `scores/heldout/…/pooled`.

    There are also `metric_version/NAME` and `timing/…`; `not_comparable` says why a row must not be compared. An empty
    field has no finite value or was not measured: `…/exact` counts slices without error.
    """
    jobs = []
    for row in (row for material in materials(run) for row in material.rows):
        fields = dict(flattened(row.job, row.timing)) | {"not_comparable": row.obstacle or None}
        jobs.append(fields | ({"timing/not_comparable": row.timing_obstacle or None} if row.timing else {}))
    return fields_csv(jobs) if jobs else "job\n"


def fields_csv(records: Sequence[Mapping[str, Any]]) -> str:
    """A row a record, a column for each name of a field, in the order of appearance."""
    names = list(dict.fromkeys(name for fields in records for name in fields))
    return _csv([names, *([fields.get(name) for name in names] for fields in records)])


def table_csv(tables: Sequence[Table]) -> str:
    """The cells of tables as they are shown, numbers without separators; a line of headers wherever they change."""
    lines: list[Sequence[str | None]] = []
    header: list[str] = []
    for table in tables:
        first, material = (["material"], [table.material]) if table.material else ([], [])
        if header != (header := [*first, *(" ".join(words).strip() for words in table.headers)]):
            lines.append(header)
        lines += [[*material, *map(_plain, row)] for row in table.rows]
    return _csv(lines)


def _plain(cell: str) -> str | None:
    """A cell as programs read it: 42584 for 42,584, -1.5 for −1.5, and nothing without a number."""
    if cell == NONE:
        return None
    return cell.replace(",", "").replace("−", "-") if _NUMBER.fullmatch(cell) else cell


def _csv(rows: Iterable[Sequence[Any]]) -> str:
    """Rows of cells, the headers first, as CSV; None is an empty field."""
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows(rows)
    return out.getvalue()
