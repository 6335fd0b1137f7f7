"""Every number of every job as one CSV row, in full precision: for those who make their own tables."""

import csv
import io
import json
from collections.abc import Iterator, Sequence
from typing import Any

from bench.records import Record, Run
from reports.rows import Row, materials
from reports.table import Table

_ELSEWHERE = {"kind", "fit_key", "score_key", "provenance", "traceback", "metrics", "settings", "shape"}
_RAW_TIMING = {"kind", "job", "run", "samples_ns", "floor_ratios"}


def csv_text(run: Run) -> str:
    """One row a job. Names of columns are the paths of the record's fields: `bytes/total`, `scores/heldout/…/pooled`.

    `metric_version/NAME` and `timing/…` stand beside them; `not_comparable` says why a row must not be compared.
    Nothing is rounded. An empty field has no finite value, or none at all: `…/exact` counts slices without error.
    """
    rows = [dict(_fields(row)) for material in materials(run) for row in material.rows]
    columns = list(dict.fromkeys(name for row in rows for name in row)) or ["job"]
    out = io.StringIO()
    writer = csv.DictWriter(out, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return out.getvalue()


def table_csv(tables: Sequence[Table]) -> str:
    """The cells of tables as they are shown, each with a line of headers."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    for table in tables:
        writer.writerows([[" ".join(words).strip() for words in table.headers], *table.rows])
    return out.getvalue()


def _fields(row: Row) -> Iterator[tuple[str, Any]]:
    job = row.job
    first = ("material", "label", "job", "status", "codec", "seed")
    yield from ((name, job.get(name)) for name in first)
    yield "not_comparable", row.obstacle or None
    yield "settings", json.dumps(job["settings"], sort_keys=True) if "settings" in job else None
    yield from zip(("height", "width"), job.get("shape", ()), strict=False)
    yield from _flat("", {name: value for name, value in job.items() if name not in {*first, *_ELSEWHERE}})
    yield from _flat("metric_version/", job.get("score_key", {}).get("metrics", {}))
    yield from ((name, job.get("score_key", {}).get(name)) for name in ("btf", "exposure", "sha256"))
    if row.timing:
        yield from _flat("timing/", {k: v for k, v in row.timing.items() if k not in _RAW_TIMING})
        yield "timing/not_comparable", row.timing_obstacle or None


def _flat(prefix: str, values: Record) -> Iterator[tuple[str, Any]]:
    for name, value in values.items():
        if isinstance(value, dict):
            yield from _flat(f"{prefix}{name}/", value)
        elif isinstance(value, list):
            yield from ((f"{prefix}{name}/{i}", item) for i, item in enumerate(value))
        else:
            yield prefix + name, value
