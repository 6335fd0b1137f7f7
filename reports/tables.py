"""Chooses the tables of a run, by kind. Other modules make them, and write them in a format.

The *kind* of a table is one of `reports.KINDS`; for each there is a *maker*, a function that makes the tables of a run:
`_OF_KIND` has those that need nothing else, and `all_tables` adds the others.
"""

from collections.abc import Callable, Iterable, Mapping
from itertools import chain
from typing import cast

from bench.compare.choosing import has_validation
from bench.records import Run
from reports import BY_BUDGET, BY_MATERIAL, KINDS, by_material, front
from reports.fits import fit_tables
from reports.notes import not_run
from reports.paper import ablation_table, paper_tables
from reports.parameters import TimedJob, parameters_table
from reports.rows import MaterialRows, materials
from reports.stress import stress_tables
from reports.summary import summary_table
from reports.table import Table
from reports.times import times_tables, variant_tables
from reports.trade import trade_tables

# A function that makes the tables of a kind, from a run and its rows by material; None is no table.
Maker = Callable[[Run, list[MaterialRows]], Iterable[Table | None]]


def all_tables(
    run: Run,
    narrow: bool = False,
    kind: str | None = None,
    against: str = "",
    whole: bool = False,
    absent: Mapping[str, str] | None = None,
) -> list[Table]:
    """Every table that has a row, or those of one `kind`, in the order of `KINDS` and then by material.

    With `narrow`, a main table is two: quality, and size and time. The summary sets codecs `against` a row, a label; ""
    is the one that `reports.ranking` picks. With `whole`, the table `paper` has every fit and `trade` every choice. For
    `absent` see `reports.paper.paper_tables`. `InputError` for a row to set against that the run lacks, and for a
    finished job that lacks a field that tables show.
    """
    rows = [] if kind in BY_BUDGET else materials(run)  # which those do not need, and which takes long
    makers = dict(_OF_KIND)
    makers["summary"] = lambda run, rows: [summary_table(run, rows, against=against)]
    makers["paper"] = lambda run, rows: paper_tables(run, rows, absent, whole)
    makers["trade"] = lambda run, rows: [*trade_tables(run, rows, whole), *variant_tables(run, "trade")]
    if narrow:
        makers["main"] = lambda run, rows: [*_by_material("quality")(run, rows), *_by_material("cost")(run, rows)]
    tables: list[Table] = []
    for name in KINDS:
        if kind in (None, name):
            tables += [table for table in makers[name](run, rows) if table]
    return tables


def unfinished_table(run: Run, materials: Iterable[MaterialRows]) -> Table | None:
    """Jobs without numbers and the reasons, including planned jobs that were not run; None if all have numbers."""
    rows = []
    for row in chain.from_iterable(material.rows for material in materials):
        status = row.job["status"]
        if status != "ok":
            status_in_words = "not available" if status == "unavailable" else status
            why = " ".join(str(row.job.get("error", "")).split())  # on one line
            rows.append([row.job["material"], row.name, status_in_words, why])
    for material, label, seeds in not_run(run):
        seeds_in_words = f"seed{'s' if len(seeds) > 1 else ''} {', '.join(map(str, seeds))}"
        rows.append([material, label, "not run", seeds_in_words])
    if not rows:
        return None
    headers = [("material", ""), ("codec", ""), ("state", ""), ("why", "")]
    return Table("unfinished", "Jobs without a result", headers, rows, words=4)


def _by_budget(kind: str) -> Maker:
    """A maker of the tables of a kind in `BY_BUDGET`. It makes none if no job was scored at validation pairs, by which
    these tables choose settings."""
    return lambda run, _: front.TABLES[kind](run) if any(map(has_validation, run.jobs)) else []


def _by_material(kind: str) -> Maker:
    """A maker of a table for each material that was measured; see `reports.by_material.tables`."""
    return lambda _, rows: by_material.tables(rows, kind)


_OF_KIND: dict[str, Maker] = {
    **{kind: _by_budget(kind) for kind in BY_BUDGET},
    **{kind: _by_material(kind) for kind in BY_MATERIAL},
    "fits": lambda run, _: fit_tables(run),
    "times": lambda run, _: times_tables(run),
    "parameters": lambda run, _: [parameters_table([cast(TimedJob, job) for job in run.jobs])],
    "ablation": lambda run, _: [ablation_table(run)],
    "stress": lambda run, _: stress_tables(run),
    "unfinished": lambda run, rows: [unfinished_table(run, rows)],
}
