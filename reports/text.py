r"""Tables as plain text, GitHub Markdown, CSV and LaTeX, and jobs as CSV in full precision, for other programs.

LaTeX needs `\usepackage{booktabs,graphicx}`; no table is wider than the text, in one column or over both of two.
"""

import csv
import io
import re
import textwrap
import unicodedata
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import count
from typing import Any

from tabulate import tabulate

from bench.inputs.errors import visible
from bench.records import Run, flattened
from reports.numbers import NONE
from reports.rows import materials
from reports.table import BOLD, DOT, UNDERLINED, Table

WIDTH = 120
_MARKS = {BOLD: "**{}**", UNDERLINED: "<ins>{}</ins>", "": "{}"}
_NUMBER = re.compile(r"[−+-]?\d[\d,]*(\.\d+)?")
_FORMULA = re.compile(r"\s*[=+@-]\S")
_READ_NUMBER = re.compile(r"[+-]?\d[\d.]*([eE][+-]?\d+)?( .*)?")  # as CSV has it; a deviation or an interval may follow
PACKAGES = r"% needs \usepackage{booktabs,graphicx}"
_LATEX_MARKS = {BOLD: r"\textbf{%s}", UNDERLINED: r"\underline{%s}", "": "%s"}
_MATH = {"<": "<", ">": ">", "|": "|", "−": "-", "±": r"\pm", "×": r"\times", "θ": r"\theta", "φ": r"\varphi"}
_MATH |= {"°": r"^\circ", "↑": r"\uparrow", "↓": r"\downarrow"}
_SPECIAL = {
    **{character: f"\\{character}" for character in "&%$#_{}"},
    **{character: rf"\ensuremath{{{math}}}" for character, math in _MATH.items()},
    **{"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"},
    **{"—": "---", "…": r"\ldots{}", "“": "``", "”": "''"},
}


def plain(tables: Sequence[Table]) -> str:
    """Tables for a terminal, as wide as their columns make them; a note of several stands below the last of them."""
    tables = [_shown(table) for table in tables]
    after = [{note for each in tables[i + 1 :] for note in each.notes} for i in range(len(tables))]
    once = [[note for note in table.notes if note not in late] for table, late in zip(tables, after, strict=True)]
    return "\n\n".join(_plain(replace(table, notes=notes)) for table, notes in zip(tables, once, strict=True))


def _shown(table: Table) -> Table:
    """The table as plain text shows it: no control characters, and a dot before the best of each column."""
    rows = [
        [(DOT if table.marks.get((i, j)) == BOLD else "") + visible(cell) for j, cell in enumerate(row)]
        for i, row in enumerate(table.rows)
    ]
    headers = [(visible(name), visible(unit)) for name, unit in table.headers]
    notes = [*table.notes, *([f"{DOT}: the best of a column."] if BOLD in table.marks.values() else [])]
    return replace(table, title=visible(table.title), headers=headers, rows=rows, notes=list(map(visible, notes)))


def _plain(table: Table) -> str:
    # Words first, on lines of their own if the name is long, the unit last.
    heads = [[*textwrap.wrap(name, 9, break_long_words=False), *textwrap.wrap(unit, 8)] for name, unit in table.headers]
    height = max(map(len, heads))
    lines = list(zip(*(head + [""] * (height - len(head)) for head in heads), strict=True))
    body = [line for row in table.rows for line in _folded(row, table)]
    widths = [max(map(_width, column)) for column in zip(*lines, *body, strict=True)]
    rule = ["-" * width for width in widths]
    text = []
    for cells in (*lines, rule, *body):
        gaps = [" " * (width - _width(cell)) for cell, width in zip(cells, widths, strict=True)]
        padded = [a + b if i < table.words else b + a for i, (a, b) in enumerate(zip(cells, gaps, strict=True))]
        text.append("  ".join(padded).rstrip())
    return "\n".join([table.title, "", *text, *map(wrapped, table.notes)])


def _width(text: str) -> int:
    """The columns that a text takes in a terminal: wide characters take two, combining accents none."""
    wide = sum(unicodedata.east_asian_width(character) in "WF" for character in text)
    return len(text) + wide - sum(bool(unicodedata.combining(character)) for character in text)


def _folded(row: list[str], table: Table) -> Iterator[tuple[str, ...]]:
    """The lines of one row: long words are folded."""
    widths = (20, 24, 13, 57)[: table.words] if table.words > 1 else (table.fold,)
    folded = [textwrap.wrap(cell, width) or [""] for cell, width in zip(row, widths, strict=False)]
    cells = [*folded, *([cell] for cell in row[table.words :])]
    for i in range(max(map(len, cells))):
        yield tuple(lines[i] if i < len(lines) else "" for lines in cells)


def wrapped(note: str) -> str:
    """A note folded to the width of a terminal."""
    return textwrap.fill(visible(note), WIDTH, subsequent_indent="  ")


def markdown(tables: Sequence[Table]) -> str:
    """Tables as GitHub Markdown, each under a heading."""
    blocks: list[str] = []
    for table in tables:
        blocks += [f"### {escaped(table.title)}", grid(table), *map(escaped, table.footnotes)]
    return "\n\n".join(blocks) + "\n"


def grid(table: Table) -> str:
    """The cells of a table as GitHub Markdown, without title and notes."""
    headers = [escaped(f"{name} {unit}") for name, unit in table.headers]
    rows = [
        [_MARKS[table.marks.get((i, j), "")].format(escaped(cell)) for j, cell in enumerate(row)]
        for i, row in enumerate(table.rows)
    ]
    alignment = ["left" if i < table.words else "right" for i in range(len(table.headers))]
    return tabulate(rows, headers, "pipe", colalign=alignment, disable_numparse=True)


def escaped(text: str) -> str:
    """Text escaped for Markdown, on one line."""
    return re.sub(r"[\\`*|<\[#~]|(?<!\w)_|_(?!\w)", r"\\\g<0>", " ".join(visible(text).split()))


def results_csv(run: Run) -> str:
    """One row a job, nothing rounded; a column is the path of a record's field: `scores/heldout/…/pooled`.

    There are also `metric_version/NAME` and `timing/…`; `not_comparable` says why a row must not be compared. An empty
    field has no finite value or was not measured: `…/exact` counts slices without error.
    """
    jobs = []
    for row in (row for material in materials(run) for row in material.rows):
        fields = dict(flattened(row.job, row.timing)) | {"not_comparable": row.obstacle or None}
        jobs.append(fields | ({"timing/not_comparable": row.timing_obstacle or None} if row.timing else {}))
    return fields_csv(jobs) if jobs else "job\n"


def fields_csv(records: Sequence[Mapping[str, Any]]) -> str:
    """A row a record, a column for each name of a field, in the order of appearance."""
    names = list(dict.fromkeys(name for fields in records for name in fields))
    return _csv([names, *([fields.get(name) for name in names] for fields in records)])


def table_csv(tables: Sequence[Table]) -> str:
    """The cells of tables as they are shown, numbers without separators; a line of headers wherever they change."""
    lines: list[Sequence[str | None]] = []
    header: list[str] = []
    for table in tables:
        first, material = (["material"], [table.material]) if table.material else ([], [])
        if header != (header := [*first, *(" ".join(words).strip() for words in table.headers)]):
            lines.append(header)
        lines += [[*material, *map(_as_read, row)] for row in table.rows]
    return _csv(lines)


def _as_read(cell: str) -> str | None:
    """A cell as programs read it: 42584 for 42,584, -1.5 for −1.5, and nothing without a number."""
    if cell == NONE:
        return None
    return cell.replace(",", "").replace("−", "-") if _NUMBER.fullmatch(cell) else cell


def _csv(rows: Iterable[Sequence[Any]]) -> str:
    """Rows of cells, the headers first, as CSV; None is an empty field."""
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows([*map(_inert, row)] for row in rows)
    return out.getvalue()


def _inert(cell: Any) -> Any:
    """A cell that no program takes for a command: without control characters, an apostrophe before a formula's text.

    A number may begin with a sign, and "—" and words like "-" alone are no formula.
    """
    if not isinstance(cell, str):
        return cell
    cell = visible(cell)
    return f"'{cell}" if _FORMULA.match(cell) and not _READ_NUMBER.fullmatch(cell) else cell


def latex(tables: Sequence[Table]) -> str:
    """Tables to be `\\input`, each a `table*` with its notes below it and a label: `tab:summary`, or see `label`."""
    kinds, written = [table.kind for table in tables], []
    labels: set[str] = set()
    for table in tables:
        alone = kinds.count(table.kind) == 1 and not table.material
        called = f"tab:{table.kind}" if alone else label(table)
        if called in labels:  # such as those of materials `a_b` and `a-b`
            called = next(name for number in count(2) if (name := f"{called}-{number}") not in labels)
        labels.add(called)
        written.append(_latex(table, called))
    return "\n".join([PACKAGES, *written]) if tables else ""


def latex_escaped(text: str) -> str:
    """Text escaped for LaTeX."""
    text = " ".join(visible(text).split()).replace("θ_o", "\0o").replace("θ_i", "\0i")
    text = "".join(_SPECIAL.get(character, character) for character in text)
    text = text.replace("\0o", r"\ensuremath{\theta_o}").replace("\0i", r"\ensuremath{\theta_i}")
    return f"{{}}{text}" if text.startswith(("[", "*")) else text  # `\\` and `\midrule` before it would take them


def _latex(table: Table, called: str) -> str:
    align = "".join("l" if i < table.words else "r" for i in range(len(table.headers)))
    if table.words == len(table.headers):
        align = align[:-1] + r"p{0.5\textwidth}"
    names_and_units = zip(*table.headers, strict=True)
    heads = [" & ".join(map(latex_escaped, line)) + r" \\" for line in names_and_units if any(line)]
    rows = []
    for i, row in enumerate(table.rows):
        cells = (_LATEX_MARKS[table.marks.get((i, j), "")] % latex_escaped(cell) for j, cell in enumerate(row))
        rows.append(" & ".join(cells) + r" \\")
    lines = [r"\begin{table*}", r"\centering", rf"\caption{{{latex_escaped(table.title)}}}", rf"\label{{{called}}}"]
    lines += [r"\footnotesize", r"\setlength{\tabcolsep}{3pt}", r"\sbox0{%", rf"\begin{{tabular}}{{@{{}}{align}@{{}}}}"]
    lines += [r"\toprule", *heads, r"\midrule", *rows]
    lines += [r"\bottomrule", r"\end{tabular}}%", _FITTED]
    if notes := " ".join(map(latex_escaped, table.footnotes)):
        lines += [r"\par\smallskip\begin{minipage}{\linewidth}\raggedright\scriptsize", notes, r"\end{minipage}"]
    return "\n".join([*lines, r"\end{table*}", ""])


# Scaled down to the width of the text, never up.
_FITTED = r"\ifdim\wd0>\linewidth\resizebox{\linewidth}{!}{\usebox0}\else\usebox0\fi"


def label(table: Table) -> str:
    """The label of a table for `\\ref`, `tab:main-satin`: letters, digits and hyphens of its kind and title."""
    words = re.findall("[A-Za-z0-9]+", unicodedata.normalize("NFKD", table.title.partition(" (")[0]))
    return "-".join([f"tab:{table.kind}", *words]).lower()
