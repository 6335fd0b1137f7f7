"""Writes the report of a run: tables, figures, and one page that holds both."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path

from bench.files.atomic import replacing
from bench.records import Run, load_run
from reports import KINDS, Report, figures, trade
from reports.figures.canvas import Figure
from reports.figures.history import history_figures
from reports.html import TEMPLATES
from reports.page import Page
from reports.table import Table
from reports.tables import all_tables
from reports.terminal import terminal
from reports.text import latex, markdown, results_csv

VECTOR = ("svg", "pdf")


def write(folder: Path, vector: bool = False) -> Report:
    """See `reports.write_report`."""
    run = load_run(folder)
    drawn, pictures = [], []
    formats = VECTOR if vector else _formats_there(folder / "figures")
    for figure in (figure for draw in figures.ALL.values() for figure in draw(run)):
        pictures += _write_figure(figure, folder / "figures", formats)
        drawn.append(replace(figure, drawing=None))  # the drawing takes memory
    tables = all_tables(run)
    narrow = [*(table for table in tables if table.kind != "main"), *all_tables(run, narrow=True, kind="main")]
    files = [*_write_tables(run, folder / "tables", tables, narrow), *pictures]
    _remove_old(folder, files)
    files.append(folder / "report.html")
    with replacing(files[-1]) as partial, open(partial, "w", encoding="utf-8", newline="\n") as file:
        file.writelines(Page(run, narrow, drawn).pieces())
    return Report(terminal(run), files)


def write_history(runs: Sequence[Run], folder: Path) -> list[Path]:
    """See `reports.write_history`."""
    files, drawn = [], []
    for figure in history_figures(runs):
        files += _write_figure(figure, folder, VECTOR)
        inline = "<svg" + figure.vector("svg").decode().partition("<svg")[2]  # without its XML declaration
        drawn.append((figure.material, inline))
    page = TEMPLATES.get_template("history.html").render(figures=drawn)
    return [*files, put(folder / "history.html", page.encode())]


def _formats_there(folder: Path) -> list[str]:
    """The vector formats in which an earlier report drew figures: a report draws them again, since it removes what is
    of an earlier one."""
    names = [f"{kind}{more}" for kind in figures.ALL for more in ("", "-*")]
    return [end for end in VECTOR if any(any(folder.glob(f"{name}.{end}")) for name in names)]


def _write_figure(figure: Figure, folder: Path, formats: Sequence[str]) -> list[Path]:
    path = folder / figure.name
    return [put(path, figure.png), *(put(path.with_suffix(f".{end}"), figure.vector(end)) for end in formats)]


def _write_tables(run: Run, folder: Path, tables: Sequence[Table], narrow: Sequence[Table]) -> list[Path]:
    files = [put(folder / "results.csv", results_csv(run).encode())]
    if choices := trade.choices_csv(run.folder):
        files.append(put(folder / "trade.csv", choices.encode()))
    for kind in KINDS:
        for suffix, text, candidates in ((".md", markdown, tables), (".tex", latex, narrow)):
            if chosen := [table for table in candidates if table.kind == kind]:
                files.append(put(folder / f"{kind}{suffix}", text(chosen).encode()))
    return files


def _remove_old(folder: Path, files: Sequence[Path]) -> None:
    """Remove the tables and figures of an earlier report that this one does not have; files of other names stay."""
    names = ["tables/trade.csv", *(f"tables/{kind}.{suffix}" for kind in KINDS for suffix in ("md", "tex"))]
    names += [f"figures/{kind}{more}.{end}" for kind in figures.ALL for more in ("", "-*") for end in ("png", *VECTOR)]
    for path in set(chain.from_iterable(map(folder.glob, names))) - set(files):
        path.unlink()


def put(path: Path, content: bytes) -> Path:
    """Write a file completely or not at all."""
    with replacing(path) as partial:
        partial.write_bytes(content)
    return path
