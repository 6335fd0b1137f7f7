"""Builds the tables of a run as cells of text: columns, rows and footnotes. Other modules format them.

A *job* is one codec with its settings on one material, fitted with one seed; its *label* is the codec with these
settings. A row of a table is a codec with its settings, over all seeds. A *slice* is one picture of a material: all
texels at one *pair* of view and light directions. A model *of a scene* was fitted to the pairs that one scene uses; its
*frames* are pictures of that scene. The *kind* of a table is one of `reports.KINDS`; for each, `_OF_KIND` has a
*maker*, a function that makes the tables of a run. A job is *stale* if the installed version of its codec cannot make
it again.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import cast

from bench.codecs.alike import stale
from bench.compare.choosing import has_validation
from bench.records import Run
from reports import BY_BUDGET, BY_MATERIAL, KINDS
from reports.fits import fit_tables
from reports.notes import not_run
from reports.parameters import TimedJob, parameters_table
from reports.rows import MaterialRows, materials
from reports.stress import stress_tables
from reports.table import STALE, Table, stale_note
from reports.times import times_tables, variant_tables
from reports.trade import trade_tables


def all_tables(
    run: Run,
    narrow: bool = False,
    kind: str | None = None,
    against: str = "",
    every_fit: bool = False,
    absent: Mapping[str, str] | None = None,
) -> list[Table]:
    """Every table that has a row, or those of one `kind`, in the order of `KINDS` and then by material.

    With `narrow`, a main table is two: quality, and size and time. The summary sets codecs `against` a row, a label; ""
    is the one that `reports.ranking` picks, and `InputError` is raised for one that the run lacks. For `every_fit` and
    `absent` see `reports.paper.paper_tables`.
    """
    rows = [] if kind in BY_BUDGET else materials(run)  # which those do not need, and which takes long
    makers = dict(_OF_KIND)
    makers["summary"] = _summary(against)
    makers["paper"] = _paper(every_fit, absent)
    if narrow:
        makers["main"] = lambda run, rows: [*_by_material("quality")(run, rows), *_by_material("cost")(run, rows)]
    tables: list[Table] = []
    for name in KINDS:
        if kind in (None, name):
            tables += [table for table in makers[name](run, rows) if table]
    return tables if kind in BY_BUDGET else list(_with_stale_rows_marked(run, tables))  # these mark their own


def _with_stale_rows_marked(run: Run, tables: Iterable[Table]) -> Iterator[Table]:
    """The tables, with a mark at each row whose numbers the installed version of its codec cannot make again.

    That is a row of a stale job, of a table that names its `jobs`; tables of values mark their own.
    """
    finished = {job["job"]: job for job in run.jobs if job["status"] == "ok"}
    reasons = {name: f"{finished[name]['codec']}: {why}" for name, why in stale([*finished.values()]).items()}
    for table in tables:
        found = [next((reasons[job] for job in jobs if job in reasons), "") for jobs in table.jobs]
        if not any(found):
            yield table
            continue
        names = [name for name, _ in table.headers]
        column = names.index("codec") if "codec" in names else 0
        rows = []
        for row, reason in zip(table.rows, found, strict=True):
            rows.append([*row[:column], row[column] + STALE * bool(reason), *row[column + 1 :]])
        yield replace(table, rows=rows, notes=[*table.notes, stale_note(dict.fromkeys(filter(None, found)))])


def unfinished_table(run: Run) -> Table | None:
    """Jobs without numbers and the reasons, including planned jobs that were not run; None if all have numbers."""
    rows = []
    for material_rows in materials(run):
        for row in material_rows.rows:
            status = row.job["status"]
            if status != "ok":
                status_in_words = "not available" if status == "unavailable" else status
                why = " ".join(str(row.job.get("error", "")).split())  # on one line
                rows.append([row.job["material"], row.name, status_in_words, why])
    for material, label, seeds in not_run(run):
        seeds_in_words = f"seed{'s' * (len(seeds) > 1)} {', '.join(map(str, seeds))}"
        rows.append([material, label, "not run", seeds_in_words])
    if not rows:
        return None
    headers = [("material", ""), ("codec", ""), ("state", ""), ("why", "")]
    return Table("unfinished", "Jobs without a result", headers, rows, words=4)


def _by_budget(kind: str) -> "Maker":
    """A maker of the tables of a kind in `BY_BUDGET`. It makes none if no job was scored at validation pairs, by which
    these tables choose settings."""

    def tables(run: Run, _: list[MaterialRows]) -> Iterable[Table]:
        if not any(map(has_validation, run.jobs)):
            return []
        from reports import front  # it loads pandas, which most tables do not need

        return front.TABLES[kind](run)

    return tables


def _by_material(kind: str) -> "Maker":
    """A maker of a table for each material that was measured; see `reports.by_material.tables`."""

    def tables(run: Run, rows: list[MaterialRows]) -> Iterable[Table]:
        from reports import by_material  # it loads pandas

        return by_material.tables(run, rows, kind)

    return tables


def _summary(against: str) -> "Maker":
    """A maker of the summary, which sets codecs `against` a row."""

    def tables(run: Run, _: list[MaterialRows]) -> Iterable[Table | None]:
        from reports.summary import summary_table  # it loads pandas

        return [summary_table(run, against=against)]

    return tables


def _paper(every_fit: bool, absent: Mapping[str, str] | None) -> "Maker":
    """A maker of the tables of the paper's quality; see `reports.paper.paper_tables`."""

    def tables(run: Run, _: list[MaterialRows]) -> Iterable[Table]:
        from reports.paper import paper_tables  # it loads pandas

        return paper_tables(run, absent, every_fit)

    return tables


def _ablation(run: Run, _: list[MaterialRows]) -> Iterable[Table | None]:
    """The table of the suite `ablation`."""
    from reports.paper import ablation_table  # it loads pandas

    return [ablation_table(run)]


# A function that makes the tables of a kind, from a run and its rows by material; None is no table.
Maker = Callable[[Run, list[MaterialRows]], Iterable[Table | None]]
_OF_KIND: dict[str, Maker] = {
    **{kind: _by_budget(kind) for kind in BY_BUDGET},
    **{kind: _by_material(kind) for kind in BY_MATERIAL},
    "fits": lambda run, _: fit_tables(run),
    "times": lambda run, _: times_tables(run),
    "trade": lambda run, _: [*trade_tables(run), *variant_tables(run, "trade")],
    "parameters": lambda run, _: [parameters_table([cast(TimedJob, job) for job in run.jobs])],
    "ablation": _ablation,
    "stress": lambda run, _: stress_tables(run),
    "unfinished": lambda run, _: [unfinished_table(run)],
}
