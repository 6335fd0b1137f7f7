"""Writes the report of a run: tables, figures, and one page that holds both."""

from collections.abc import Sequence
from dataclasses import replace
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
    drawn: list[Figure] = []
    pictures: list[Path] = []
    formats = VECTOR if vector else _formats_there(folder / "figures")
    for draw in figures.ALL.values():
        for figure in draw(run):
            pictures += _write_figure(figure, folder / "figures", formats)
            drawn.append(replace(figure, drawing=None))  # the drawing takes memory
    tables = all_tables(run)
    narrow = [table for table in tables if table.kind != "main"]
    narrow += all_tables(run, narrow=True, kind="main")
    files = [*_write_tables(run, folder / "tables", tables, narrow), *pictures]
    _remove_old(folder, files)
    page = folder / "report.html"
    with replacing(page) as partial, open(partial, "w", encoding="utf-8", newline="\n") as file:
        file.writelines(Page(run, narrow, drawn).pieces())
    return Report(terminal(run), [*files, page])


def write_history(runs: Sequence[Run], folder: Path) -> list[Path]:
    """See `reports.write_history`."""
    files: list[Path] = []
    drawn = []
    for figure in history_figures(runs):
        files += _write_figure(figure, folder, VECTOR)
        inline = "<svg" + figure.vector("svg").decode().partition("<svg")[2]  # without its XML declaration
        drawn.append((figure.material, inline))
    page = TEMPLATES.get_template("history.html").render(figures=drawn)
    return [*files, put(folder / "history.html", page.encode())]


def _formats_there(folder: Path) -> list[str]:
    """The vector formats in which an earlier report drew figures: a report draws them again, since it removes what is
    of an earlier one."""
    there = {path.suffix for name in _figure_names() for path in folder.glob(f"{name}.*")}
    return [end for end in VECTOR if f".{end}" in there]


def _figure_names() -> list[str]:
    """The patterns of the names of figures, without their ends: a kind, and a kind with a material."""
    names = []
    for kind in figures.ALL:
        names += [kind, f"{kind}-*"]
    return names


def _write_figure(figure: Figure, folder: Path, formats: Sequence[str]) -> list[Path]:
    path = folder / figure.name
    files = [put(path, figure.png)]
    for end in formats:
        files.append(put(path.with_suffix(f".{end}"), figure.vector(end)))
    return files


def _write_tables(run: Run, folder: Path, tables: Sequence[Table], narrow: Sequence[Table]) -> list[Path]:
    files = [put(folder / "results.csv", results_csv(run).encode())]
    choices = trade.choices_csv(run.folder)
    if choices:
        files.append(put(folder / "trade.csv", choices.encode()))
    for kind in KINDS:
        for suffix, text, candidates in ((".md", markdown, tables), (".tex", latex, narrow)):
            chosen = [table for table in candidates if table.kind == kind]
            if chosen:
                files.append(put(folder / f"{kind}{suffix}", text(chosen).encode()))
    return files


def _remove_old(folder: Path, files: Sequence[Path]) -> None:
    """Remove the tables and figures of an earlier report that this one does not have; files of other names stay."""
    patterns = ["tables/trade.csv"]
    for kind in KINDS:
        patterns += [f"tables/{kind}.md", f"tables/{kind}.tex"]
    for name in _figure_names():
        patterns += [f"figures/{name}.{end}" for end in ("png", *VECTOR)]
    there: set[Path] = set()
    for pattern in patterns:
        there.update(folder.glob(pattern))
    for path in there - set(files):
        path.unlink()


def put(path: Path, content: bytes) -> Path:
    """Write a file completely or not at all."""
    with replacing(path) as partial:
        partial.write_bytes(content)
    return path
