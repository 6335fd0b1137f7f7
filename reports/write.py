"""Writes the report of a run: tables, figures, and one page that holds both."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
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
    return _ReportFolder(folder, load_run(folder)).write(vector)


@dataclass
class _ReportFolder:
    """The folder of a run, with the files that its report has so far."""

    folder: Path
    run: Run
    files: list[Path] = field(default_factory=list)

    def write(self, vector: bool) -> Report:
        """Write everything, and remove what only an earlier report had."""
        tables = all_tables(self.run)
        narrow = [table for table in tables if table.kind != "main"]
        narrow += all_tables(self.run, narrow=True, kind="main")
        self.write_tables(tables, narrow)
        drawn = self.write_figures(VECTOR if vector else _formats_there(self.folder / "figures"))
        self.remove_old()
        page = self.folder / "report.html"
        with replacing(page) as partial, open(partial, "w", encoding="utf-8", newline="\n") as file:
            file.writelines(Page(self.run, narrow, drawn).pieces())
        return Report(terminal(self.run), [*self.files, page])

    def write_figures(self, formats: Sequence[str]) -> list[Figure]:
        """Write every figure as PNG and in vector formats; returns them without their drawings, which take memory."""
        drawn = []
        for draw in figures.ALL.values():
            for figure in draw(self.run):
                self.files += _write_figure(figure, self.folder / "figures", formats)
                drawn.append(replace(figure, drawing=None))
        return drawn

    def write_tables(self, tables: Sequence[Table], narrow: Sequence[Table]) -> None:
        """Write all numbers as CSV, and each kind of table as Markdown and, `narrow`, as LaTeX."""
        folder = self.folder / "tables"
        self.files.append(put(folder / "results.csv", results_csv(self.run).encode()))
        choices = trade.choices_csv(self.folder)
        if choices:
            self.files.append(put(folder / "trade.csv", choices.encode()))
        for kind in KINDS:
            for suffix, text, candidates in ((".md", markdown, tables), (".tex", latex, narrow)):
                chosen = [table for table in candidates if table.kind == kind]
                if chosen:
                    self.files.append(put(folder / f"{kind}{suffix}", text(chosen).encode()))

    def remove_old(self) -> None:
        """Remove tables and figures of an earlier report that this one does not have; files of other names stay."""
        patterns = ["tables/trade.csv"]
        for kind in KINDS:
            patterns += [f"tables/{kind}.md", f"tables/{kind}.tex"]
        for name in _figure_names():
            patterns += [f"figures/{name}.{end}" for end in ("png", *VECTOR)]
        there: set[Path] = set()
        for pattern in patterns:
            there.update(self.folder.glob(pattern))
        for path in there - set(self.files):
            path.unlink()


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
    """The vector formats in which an earlier report drew figures. They are drawn again, because a report removes the
    figures of an earlier one that it does not write anew."""
    there = {path.suffix for name in _figure_names() for path in folder.glob(f"{name}.*")}
    return [end for end in VECTOR if f".{end}" in there]


def _figure_names() -> list[str]:
    """The patterns of the names of figures, without their ends: a kind, and a kind with a material."""
    names = []
    for kind in figures.ALL:
        names += [kind, f"{kind}-*"]
    return names


def _write_figure(figure: Figure, folder: Path, formats: Sequence[str]) -> list[Path]:
    """Write a figure as PNG and in vector formats, “svg” or “pdf”; returns the files."""
    path = folder / figure.name
    files = [put(path, figure.png)]
    for end in formats:
        files.append(put(path.with_suffix(f".{end}"), figure.vector(end)))
    return files


def put(path: Path, content: bytes) -> Path:
    """Write a file completely or not at all."""
    with replacing(path) as partial:
        partial.write_bytes(content)
    return path
