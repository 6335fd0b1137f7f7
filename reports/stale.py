"""Marks the rows of tables whose records are of an older version of a codec than the installed one."""

from collections.abc import Iterable, Iterator
from dataclasses import replace

from bench.codecs.alike import stale
from bench.records import Run
from reports.table import Table

MARK = " †"


def marked(run: Run, tables: Iterable[Table]) -> Iterator[Table]:
    """The tables, each row of a stale codec with a mark, and a note on it."""
    finished = [job for job in run.jobs if job["status"] == "ok"]
    reasons = {(job["material"], job["codec"]): why for job in finished if (why := stale(job))}
    for table in tables:
        mine = {codec: why for (material, codec), why in reasons.items() if table.material in ("", material)}
        old = {i: codec for i, row in enumerate(table.rows) if (codec := row[0].partition(" ")[0].rstrip(",")) in mine}
        rows = [[row[0] + MARK, *row[1:]] if i in old else row for i, row in enumerate(table.rows)]
        words = "; ".join(f"{codec}: {mine[codec]}" for codec in dict.fromkeys(old.values()))
        notes = [f"†: stale, its numbers cannot be made again by the installed version: {words}."] if old else []
        yield replace(table, rows=rows, notes=[*table.notes, *notes])
