"""Writes the report of a run: tables, figures, and one page that holds both.

Each file is written completely or not at all. A *vector* format is SVG or PDF. A *narrow* list of tables has each main
table as two, for LaTeX and the page.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from bench.files import atomic
from bench.records import Run, kind_of, load_run
from reports import KINDS, Report, figures, raw
from reports.figures.canvas import Figure
from reports.figures.history import history_figures
from reports.html import TEMPLATES
from reports.page import Page
from reports.table import Table
from reports.tables import all_tables
from reports.terminal import terminal
from reports.text import latex, markdown

if TYPE_CHECKING:
    import pandas as pd

VECTOR = ("svg", "pdf")  # endings of files


def write(folder: Path, vector: bool = False) -> Report:
    """Write the report of a run into its folder, as `reports.write_report` says."""
    return _ReportFolder(folder, load_run(folder)).write(vector)


@dataclass
class _ReportFolder:
    """The folder of a run, with the files that its report has so far."""

    folder: Path
    run: Run
    files: list[Path] = field(default_factory=list)

    def write(self, vector: bool) -> Report:
        """Write everything, and remove what only an earlier report had. With `vector` figures also have the formats
        `VECTOR`."""
        tables = all_tables(self.run, whole=True)
        narrow_tables = [table for table in tables if table.kind != "main"]
        narrow_tables += all_tables(self.run, narrow=True, kind="main")
        self.write_tables(tables, narrow_tables)
        formats = VECTOR if vector else _formats_there(self.run, self.folder / "figures")
        page_figures = self.write_figures(formats)
        self.remove_old()
        page = self.folder / "report.html"
        with atomic.replacing(page) as partial, open(partial, "w", encoding="utf-8", newline="\n") as file:
            file.writelines(Page(self.run, narrow_tables, page_figures).pieces())
        return Report(terminal(self.run), [*self.files, page])

    def write_figures(self, formats: Sequence[str]) -> list[Figure]:
        """Write every figure as PNG and in these vector formats; adds the files to `files`. Returns the figures without
        their drawings, which take memory."""
        without_drawings = []
        for draw in figures.ALL.values():
            for figure in draw(self.run):
                self.files += _write_figure(figure, self.folder / "figures", formats)
                without_drawings.append(replace(figure, drawing=None))
        return without_drawings

    def write_tables(self, tables: Sequence[Table], narrow: Sequence[Table]) -> None:
        """Write all numbers as CSV, and each kind of table as Markdown and, `narrow`, as LaTeX.

        Adds the files to `files`. A kind without a table has no file.
        """
        folder = self.folder / "tables"
        self.files.append(put(folder / "results.csv", raw(self.run).encode()))
        if self.run.choices:
            self.files.append(put(folder / "trade.csv", raw(self.run, "trade").encode()))
        for kind in KINDS:
            for suffix, as_text, candidates in ((".md", markdown, tables), (".tex", latex, narrow)):
                tables_of_kind = [table for table in candidates if table.kind == kind]
                if tables_of_kind:
                    self.files.append(put(folder / f"{kind}{suffix}", as_text(tables_of_kind).encode()))

    def remove_old(self) -> None:
        """Remove tables and figures of an earlier report that are not in `files`; files of other names stay."""
        patterns = ["tables/trade.csv"]
        for kind in KINDS:
            patterns += [f"tables/{kind}.md", f"tables/{kind}.tex"]
        for name in _figure_names(self.run):
            patterns += [f"figures/{name}.{end}" for end in ("png", *VECTOR)]
        report_files: set[Path] = set()  # of this report and of earlier ones
        for pattern in patterns:
            report_files.update(self.folder.glob(pattern))
        for path in report_files - set(self.files):
            path.unlink()


def write_history(frame: "pd.DataFrame", folder: Path) -> list[Path]:
    """Write the figures and the page of a history into a folder, as `reports.write_history` says."""
    files: list[Path] = []
    inline_figures = []  # of each figure: the name of its material, and its SVG
    for figure in history_figures(frame):
        written = _write_figure(figure, folder, VECTOR)
        files += written
        (svg,) = [path.read_text(encoding="utf-8") for path in written if path.suffix == ".svg"]
        without_declaration = "<svg" + svg.partition("<svg")[2]  # HTML allows no XML declaration inside
        inline_figures.append((figure.material, without_declaration))
    page = TEMPLATES.get_template("history.html").render(figures=inline_figures)
    return [*files, put(folder / "history.html", page.encode())]


def _formats_there(run: Run, folder: Path) -> list[str]:
    """The vector formats in which an earlier report drew figures. They are drawn again, because a report removes the
    figures of an earlier one that it does not write anew."""
    suffixes: set[str] = set()
    for name in _figure_names(run):
        suffixes.update(path.suffix for path in folder.glob(f"{name}.*"))
    return [end for end in VECTOR if f".{end}" in suffixes]


def _figure_names(run: Run) -> list[str]:
    """The names that figures of a report may have, without their ends: a kind, or a kind with a material or a kind of
    surface. Other files in the folder are a user's own."""
    shown = dict.fromkeys(["", *(job["material"] for job in run.jobs), *map(kind_of, run.jobs)])
    return [Path(Figure(each, kind, "", b"").name).stem for kind in figures.ALL for each in shown]


def _write_figure(figure: Figure, folder: Path, formats: Sequence[str]) -> list[Path]:
    """Write a figure as PNG and in vector formats, “svg” or “pdf”; returns the files."""
    path = folder / figure.name
    files = [put(path, figure.png)]
    for end in formats:
        files.append(put(path.with_suffix(f".{end}"), figure.vector(end)))
    return files


def put(path: Path, content: bytes) -> Path:
    """Write a file completely or not at all; returns its path."""
    atomic.write(path, content)
    return path
