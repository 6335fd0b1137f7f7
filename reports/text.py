"""Tables as plain text, GitHub Markdown and LaTeX."""

import re
import textwrap
import unicodedata
from collections.abc import Iterator, Sequence
from dataclasses import replace

from tabulate import tabulate

from bench.records import Run
from reports import columns
from reports.notes import run_notes
from reports.rows import Material, materials
from reports.stress import summary
from reports.table import Table
from reports.tables import main_table, rate_tables, scene_table, unfinished_table

WIDTH = 120


def terminal(run: Run) -> str:
    """What a terminal of 120 columns shows of a run: the main tables in short, where the error lies, what failed."""
    tables = []
    for material in materials(run):
        tables += [main_table(material, columns.SHORT), _detail(material), scene_table(material)]
    shown = [table for table in (*tables, *rate_tables(run), unfinished_table(run)) if table]
    main = [table.notes for table in shown if table.kind == "main"]
    shared = [note for note in main[0] if all(note in notes for notes in main)] if main else []
    shown = [replace(table, notes=[note for note in table.notes if note not in shared]) for table in shown]
    nothing = [] if main else ["Nothing was measured in this run."]
    notes = [note for note in (*shared, summary(run), *run_notes(run)) if note]
    return "\n\n".join([*nothing, *map(_plain, shown), "\n".join(map(_wrapped, notes))]).rstrip()


def scored(run: Run) -> str:
    """The same of files that were scored outside a run, which nobody fitted or timed."""
    tables = []
    for material in materials(run):
        tables += [main_table(material, columns.SCORED), _detail(material), scene_table(material)]
    return "\n\n".join(_plain(table) for table in tables if table)


def _detail(material: Material) -> Table | None:
    """One table in place of three: bands of directions and footprints."""
    if material.first is None:
        return None
    job = material.first
    chosen = [columns.PER_SLICE, *columns.bands(job)[1:], columns.RELATIVE_ERROR, *columns.footprints(job)[1:]]
    table = main_table(material, chosen)
    note = "dB: display PSNR, by direction (so many slices) and by footprint. RMSE: of radiance, against its mean."
    return table and replace(table, kind="detail", title=f"{material.name}: where the error lies", notes=[note])


def plain(tables: Sequence[Table]) -> str:
    """Tables for a terminal, as wide as their columns make them."""
    return "\n\n".join(map(_plain, tables))


def _plain(table: Table) -> str:
    heads = [_split(*header) for header in table.headers]
    height = max(map(len, heads))
    lines = list(zip(*(head + [""] * (height - len(head)) for head in heads), strict=True))
    body = [line for row in table.rows for line in _folded(row, table)]
    widths = [max(map(_width, column)) for column in zip(*lines, *body, strict=True)]
    rule = ["-" * width for width in widths]
    text = [_line(cells, widths, table.words) for cells in (*lines, rule, *body)]
    return "\n".join([table.title, "", *text, *map(_wrapped, table.notes)])


def _line(cells: Sequence[str], widths: list[int], words: int) -> str:
    gaps = [" " * (width - _width(cell)) for cell, width in zip(cells, widths, strict=True)]
    padded = [cell + gap if i < words else gap + cell for i, (cell, gap) in enumerate(zip(cells, gaps, strict=True))]
    return "  ".join(padded).rstrip()


def _width(text: str) -> int:
    """How many columns of a terminal a text takes: wide characters take two, accents that combine none."""
    wide = sum(unicodedata.east_asian_width(character) in "WF" for character in text)
    return len(text) + wide - sum(bool(unicodedata.combining(character)) for character in text)


def _split(name: str, unit: str) -> list[str]:
    """A header on two or three lines: words first where the name is long, the unit last."""
    return [*textwrap.wrap(name, 9, break_long_words=False), *textwrap.wrap(unit, 8)]


def _folded(row: list[str], table: Table) -> Iterator[tuple[str, ...]]:
    """The lines of one row: long words are folded."""
    widths = (20, 24, 13, 57)[: table.words] if table.words > 1 else (table.fold,)
    folded = [textwrap.wrap(cell, width) or [""] for cell, width in zip(row, widths, strict=False)]
    cells = [*folded, *([cell] for cell in row[table.words :])]
    for i in range(max(map(len, cells))):
        yield tuple(lines[i] if i < len(lines) else "" for lines in cells)


def _wrapped(note: str) -> str:
    return textwrap.fill(note, WIDTH, subsequent_indent="  ")


def markdown(tables: Sequence[Table]) -> str:
    """Tables as GitHub Markdown, each under a heading."""
    return "\n\n".join(map(_markdown, tables)) + "\n"


def _markdown(table: Table) -> str:
    headers = [_escaped(f"{name} {unit}") for name, unit in table.headers]
    rows = [[_escaped(cell) for cell in row] for row in table.rows]
    text = tabulate(rows, headers, "pipe", colalign=_alignment(table), disable_numparse=True)
    return "\n\n".join([f"### {_escaped(table.title)}", text, *map(_escaped, table.notes)])


def _escaped(text: str) -> str:
    """Text that Markdown shows as it stands."""
    return re.sub(r"[\\`*|<\[#~]|(?<!\w)_|_(?!\w)", r"\\\g<0>", " ".join(text.split()))


def _alignment(table: Table) -> list[str]:
    return ["left" if i < table.words else "right" for i in range(len(table.headers))]
