"""A run for a terminal of 120 columns: short main tables, errors by direction and footprint, and failed jobs.

A *main* table has quality, size and time of each codec on one material. A *band* is a group of pairs, such as grazing
views.
"""

from bench.records import Run
from reports import by_material
from reports.notes import run_notes
from reports.rows import materials
from reports.stress import summary
from reports.summary import summary_table
from reports.table import Table
from reports.tables import all_tables, unfinished_table
from reports.text import plain, wrapped


def terminal(run: Run) -> str:
    """The tables and notes of a run for a terminal of 120 columns: budgets, the summary without intervals, three tables
    for each material, jobs without a result, and the notes on the whole run."""
    run_materials = materials(run)
    tables: list[Table | None] = [*all_tables(run, kind="budgets")]
    if len(run_materials) > 1:  # means over one would repeat its main table
        tables.append(summary_table(run, run_materials, intervals=False, stale=False))
    for material in run_materials:
        for name in ("short", "detail", "scene"):
            tables += by_material.tables([material], name, stale=False)
    tables.append(unfinished_table(run, run_materials))
    made_tables = [table for table in tables if table]
    blocks = []
    if not any(table.kind == "main" for table in made_tables):  # there may still be jobs without a result
        blocks.append("Nothing was measured in this run.")
    if made_tables:
        blocks.append(plain(made_tables))
    notes = [note for note in (summary(run), *run_notes(run)) if note]
    blocks.append("\n".join(map(wrapped, notes)))
    return "\n\n".join(blocks).rstrip()


def scored(run: Run) -> str:
    """The tables, for a terminal, of codec files that were scored outside a run: their records have no fit and no
    times, so there are neither columns of these nor notes on a run."""
    tables: list[Table] = []
    for material in materials(run):
        for name in ("scored", "detail", "scene"):
            tables += by_material.tables([material], name, stale=False)
    return plain(tables)
