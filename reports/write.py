"""Writes the report of a run: tables, figures, and one page that holds both."""

from collections.abc import Sequence
from html import escape
from pathlib import Path

from bench.atomic import replacing
from bench.records import Run, load_run
from reports import KINDS, Report, figures, trade
from reports.csv_tables import results_csv
from reports.figures.history import history_figures
from reports.latex import latex
from reports.page import page
from reports.table import Table
from reports.tables import all_tables
from reports.terminal import terminal
from reports.text import markdown


def write(folder: Path) -> Report:
    """See `reports.write_report`."""
    run = load_run(folder)
    drawn = [figure for draw in figures.ALL.values() for figure in draw(run)]
    tables = all_tables(run)
    narrow = [*(table for table in tables if table.kind != "main"), *all_tables(run, narrow=True, kind="main")]
    files = _write_tables(run, folder / "tables", tables, narrow)
    for figure in drawn:
        path = folder / "figures" / figure.name
        files.append(put(path, figure.png))
        if figure.svg:
            files.append(put(path.with_suffix(".svg"), figure.svg))
    _remove_old_figures(folder / "figures", files)
    files.append(folder / "report.html")
    with replacing(files[-1]) as partial, open(partial, "w", encoding="utf-8", newline="\n") as file:
        file.writelines(page(run, narrow, drawn))
    return Report(terminal(run), files)


def write_history(runs: Sequence[Run], folder: Path) -> list[Path]:
    """See `reports.write_history`."""
    files, pieces = [], []
    for figure in history_figures(runs):
        path = folder / figure.name
        files += [put(path, figure.png), put(path.with_suffix(".svg"), figure.svg)]
        inline = "<svg" + figure.svg.decode().partition("<svg")[2]  # without its XML declaration
        pieces.append(f"<h2>{escape(figure.material)}</h2>\n{inline}")
    page = _HISTORY.format("\n".join(pieces))
    return [*files, put(folder / "history.html", page.encode())]


_HISTORY = """<!doctype html>
<html lang="en"><meta charset="utf-8"><title>From revision to revision</title>
<body style="font-family: sans-serif; max-width: 60em; margin: auto">
<h1>Quality, bytes and time from revision to revision</h1>
<p>Means over seeds. Times are multiples of the floor, timed in the same run. A codec without any error has no PSNR.</p>
{}
</body></html>
"""


def _write_tables(run: Run, folder: Path, tables: Sequence[Table], narrow: Sequence[Table]) -> list[Path]:
    files = [put(folder / "results.csv", results_csv(run).encode())]
    if choices := trade.choices_csv(run.folder):
        files.append(put(folder / "trade.csv", choices.encode()))
    else:  # of an earlier report, and no longer true: so below
        (folder / "trade.csv").unlink(missing_ok=True)
    writers = {".md": (markdown, tables), ".tex": (latex, narrow)}
    for kind in KINDS:
        for suffix, (text, candidates) in writers.items():
            chosen = [table for table in candidates if table.kind == kind]
            if chosen:
                files.append(put(folder / f"{kind}{suffix}", text(chosen).encode()))
            else:
                (folder / f"{kind}{suffix}").unlink(missing_ok=True)
    return files


def _remove_old_figures(folder: Path, files: Sequence[Path]) -> None:
    """Remove the figures of an earlier report that this one does not draw; files of other names stay."""
    for kind in figures.ALL:
        old = {
            path
            for suffix in ("png", "svg")
            for name in (kind, f"{kind}-*")
            for path in folder.glob(f"{name}.{suffix}")
        }
        for path in old - set(files):
            path.unlink()


def put(path: Path, content: bytes) -> Path:
    """Write a file whole or not at all."""
    with replacing(path) as partial:
        partial.write_bytes(content)
    return path
