"""A run for a terminal of 120 columns: short main tables, errors by direction and footprint, and failed jobs."""

from dataclasses import replace

from bench.records import Run
from reports import columns
from reports.notes import run_notes
from reports.rows import MaterialRows, materials
from reports.stress import summary
from reports.summary import summary_table
from reports.table import Table
from reports.tables import all_tables, main_table, scene_table, unfinished_table
from reports.text import plain, wrapped


def terminal(run: Run) -> str:
    """The tables and notes of a run for a terminal of 120 columns: budgets, the summary without intervals, three tables
    for each material, and jobs without a result."""
    run_materials = materials(run)
    tables: list[Table | None] = [*all_tables(run, kind="budgets")]
    if len(run_materials) > 1:
        tables.append(summary_table(run, intervals=False))
    for material in run_materials:
        tables += [main_table(material, columns.short(material)), _detail(material), scene_table(material)]
    tables.append(unfinished_table(run))
    made_tables = [table for table in tables if table]
    blocks = []
    if not any(table.kind == "main" for table in made_tables):
        blocks.append("Nothing was measured in this run.")
    if made_tables:
        blocks.append(plain(made_tables))
    notes = [note for note in (summary(run), *run_notes(run)) if note]
    blocks.append("\n".join(map(wrapped, notes)))
    return "\n\n".join(blocks).rstrip()


def scored(run: Run) -> str:
    """The tables, for a terminal, of files that were scored outside a run, without fit or times."""
    tables = []
    for material in materials(run):
        tables += [main_table(material, columns.scored(material)), _detail(material), scene_table(material)]
    return plain([table for table in tables if table])


def _detail(material: MaterialRows) -> Table | None:
    """One table of PSNR by direction and by footprint, and of the error of radiance; None if nothing was measured."""
    if material.first is None:
        return None
    job = material.first
    # Without the first band, all pairs that decide, and the first footprint, one texel: `PER_SLICE` shows these.
    bands = columns.bands(job)[1:]
    footprints = columns.footprints(job)[1:]
    chosen = columns.means([columns.PER_SLICE, *bands, columns.RELATIVE_ERROR, *footprints])
    table = main_table(material, chosen)
    note = "dB: display PSNR by direction (and number of slices) and by footprint. RMSE: of radiance, over its mean."
    if table is None:
        return None
    return replace(table, kind="detail", title=f"{material.name}: where the error lies", notes=[note])
