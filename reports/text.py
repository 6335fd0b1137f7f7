r"""Tables as plain text, GitHub Markdown, CSV and LaTeX.

What is written may come from outside, such as a codec's name, so `visible` writes control characters out (`\x1b`), and
each format escapes its own special characters.

LaTeX needs `\usepackage{booktabs,graphicx}`. No table is wider than the text; those of more
than `ONE_COLUMN` columns stand over both columns of a document that has two.
"""

import csv
import io
import re
import textwrap
import unicodedata
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain, count, zip_longest

from tabulate import tabulate

from bench.inputs.errors import visible
from reports.numbers import NONE
from reports.table import BOLD, DOT, UNDERLINED, Table

WIDTH = 120  # of a terminal, in characters
NAME_WIDTH, UNIT_WIDTH = 9, 9  # of the lines of a header in plain text, in characters
# What Markdown puts around a marked cell.
_MARKS = {BOLD: "**{}**", UNDERLINED: "<ins>{}</ins>"}
# A number as tables show it: "−1,234.50".
_NUMBER = re.compile(r"[−+-]?\d[\d,]*(\.\d+)?")
# What the readers of a paper have not: a page of `docs`, a command, an option of one.
_OF_A_PROGRAM = re.compile(r"\bdocs/[\w/-]+\.md\b|`(neubtf-bench|run) [^`]*`|(?<![\w-])--[a-z]")
_IN_BRACKETS = re.compile(r" \([^()]*\)")
_SENTENCE_END = re.compile(r"(?<=[.]) ")
# The box of a table, scaled down to the width of the text, never up.
_FITTED = r"\ifdim\wd0>\linewidth\resizebox{\linewidth}{!}{\usebox0}\else\usebox0\fi"
ONE_COLUMN = 4  # columns of a table that stands in one column of a document
PACKAGES = r"% needs \usepackage{booktabs,graphicx}"
_LATEX_MARKS = {BOLD: r"\textbf{%s}", UNDERLINED: r"\underline{%s}"}
# Characters that LaTeX has in mathematics alone, and the others that it takes for commands or lacks. pdflatex knows of
# itself only letters with accents and common punctuation.
_MATH = {"<": "<", ">": ">", "|": "|", "−": "-", "±": r"\pm", "×": r"\times", "·": r"\cdot", "°": r"^\circ"}
_MATH |= {"≥": r"\geq", "≤": r"\leq", "≈": r"\approx", "≠": r"\neq", "∞": r"\infty", "√": r"\surd", "∝": r"\propto"}
_MATH |= {"↑": r"\uparrow", "↓": r"\downarrow", "→": r"\rightarrow", "←": r"\leftarrow"}
_MATH |= {"†": r"\dagger", "‡": r"\ddagger", "•": r"\bullet"}
_MATH |= {"¹": "^1", "²": "^2", "³": "^3", "⁻": "^-"} | {digit: f"^{i}" for i, digit in enumerate("⁴⁵⁶⁷⁸⁹", 4)}
_MATH |= {digit: f"_{i}" for i, digit in enumerate("₀₁₂₃₄₅₆₇₈₉")}
_GREEK = "alpha beta gamma delta varepsilon zeta eta theta iota kappa lambda mu nu xi pi rho sigma tau upsilon varphi"
_MATH |= {letter: rf"\{name}" for letter, name in zip("αβγδεζηθικλμνξπρστυφ", _GREEK.split(), strict=True)}
_MATH |= {"χ": r"\chi", "ψ": r"\psi", "ω": r"\omega", "ς": r"\varsigma", "Γ": r"\Gamma", "Δ": r"\Delta", "Θ": r"\Theta"}
_MATH |= {"Λ": r"\Lambda", "Ξ": r"\Xi", "Π": r"\Pi", "Σ": r"\Sigma", "Φ": r"\Phi", "Ψ": r"\Psi", "Ω": r"\Omega"}
_SPECIAL = {
    **{character: f"\\{character}" for character in "&%$#_{}"},
    **{character: rf"\ensuremath{{{math}}}" for character, math in _MATH.items()},
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "—": "---",
    "–": "--",
    "…": r"\ldots{}",
    "“": "``",
    "”": "''",
    "‘": "`",
    "’": "'",
}


def plain(tables: Sequence[Table]) -> str:
    """Tables for a terminal, as wide as their columns make them. A note that several tables have stands once, below
    the last of them."""
    blocks: list[str] = []  # the last table first, because only tables below one tell which of its notes come again
    notes_below: set[str] = set()  # the notes of the tables after this one
    for table in reversed(tables):
        printable = _printable(table.with_short_labels())
        notes = [note for note in printable.notes if note not in notes_below]
        notes_below.update(printable.notes)
        blocks.append(_plain(replace(printable, notes=notes)))
    return "\n\n".join(reversed(blocks))


def _printable(table: Table) -> Table:
    """The table as plain text shows it: no control characters, and a dot before the best of each column."""
    rows = [[visible(cell) for cell in cells] for cells in table.rows]
    for (row, column), mark in table.marks.items():
        if mark == BOLD:
            rows[row][column] = DOT + rows[row][column]
    headers = [(visible(name), visible(unit)) for name, unit in table.headers]
    notes = [visible(note) for note in table.notes]
    if BOLD in table.marks.values():
        notes.append(f"{DOT}: the best of a column.")
    return replace(table, title=visible(table.title), headers=headers, rows=rows, notes=notes)


def _plain(table: Table) -> str:
    """One table for a terminal: title, headers, cells and notes; words are aligned left, and numbers right."""
    body: list[tuple[str, ...]] = []  # the lines of the rows, each with the text of every column
    for row in table.rows:
        body += _folded(row, table)
    lines_of_headers: list[list[str]] = []  # of each column: its name, then its unit, both folded between words
    for place, (name, unit) in enumerate(table.headers):
        widest_cell = max((_width(cells[place]) for cells in body), default=0)
        lines_of_name = textwrap.wrap(name, max(NAME_WIDTH, widest_cell), break_long_words=False)
        lines_of_unit = textwrap.wrap(unit, max(UNIT_WIDTH, widest_cell), break_long_words=False)
        lines_of_headers.append([*lines_of_name, *lines_of_unit])
    top = list(zip_longest(*lines_of_headers, fillvalue=""))  # the lines of the headers, as those of `body`
    widths = [max(map(_width, column)) for column in zip(*top, *body, strict=True)]
    rule = ["-" * width for width in widths]
    lines = []
    for cells in (*top, rule, *body):
        padded = []
        for place, (cell, width) in enumerate(zip(cells, widths, strict=True)):
            gap = " " * (width - _width(cell))
            padded.append(cell + gap if place < table.words else gap + cell)
        lines.append("  ".join(padded).rstrip())
    return "\n".join([table.title, "", *lines, *map(wrapped, table.notes)])


def _width(text: str) -> int:
    """The columns that a text takes in a terminal: wide characters take two, combining accents none.

    As `rich.cells.cell_len`, without the import, which commands that draw nothing would wait for.
    """
    wide = sum(unicodedata.east_asian_width(character) in "WF" for character in text)  # “wide” or “full width”
    combining = sum(bool(unicodedata.combining(character)) for character in text)
    return len(text) + wide - combining


def _folded(row: list[str], table: Table) -> Iterator[tuple[str, ...]]:
    """The lines of one row: the words at its left are folded, and its numbers stand on the first line.

    A line has the text of every column, "" where that of a column ended on a line before.
    """
    # In characters, of the columns of words; with the gaps between them, all four fill a terminal.
    widths = (20, 24, 13, 57)[: table.words] if table.words > 1 else (table.fold,)
    lines_of_columns: list[list[str]] = []  # an empty cell has one line, too
    for cell, width in zip(row, widths, strict=False):  # the row goes on with its numbers
        lines_of_columns.append(textwrap.wrap(cell, width) or [""])
    lines_of_columns += [[number] for number in row[table.words :]]
    yield from zip_longest(*lines_of_columns, fillvalue="")


def wrapped(text: str, break_on_hyphens: bool = True) -> str:
    """A text folded to the width of a terminal, without control characters; its further lines are indented."""
    return textwrap.fill(visible(text), WIDTH, subsequent_indent="  ", break_on_hyphens=break_on_hyphens)


def markdown(tables: Sequence[Table]) -> str:
    """Tables as GitHub Markdown, each under a heading."""
    blocks: list[str] = []
    for table in map(Table.with_short_labels, tables):
        blocks += [f"### {escaped(table.title)}", grid(table), *map(escaped, table.footnotes)]
    return "\n\n".join(blocks) + "\n"


def grid(table: Table) -> str:
    """The cells of a table as GitHub Markdown, without title and notes."""
    headers = [escaped(f"{name} {unit}") for name, unit in table.headers]
    rows = [[escaped(cell) for cell in cells] for cells in table.rows]
    for (row, column), mark in table.marks.items():
        rows[row][column] = _MARKS[mark].format(rows[row][column])
    # Cells are text already: `tabulate` must not read numbers in them and write these anew.
    alignment = ["left"] * table.words + ["right"] * (len(table.headers) - table.words)
    return tabulate(rows, headers, "pipe", colalign=alignment, disable_numparse=True)


def escaped(text: str) -> str:
    """Text escaped for Markdown, on one line, because a line break would end a cell or a heading."""
    line = " ".join(visible(text).split())
    # A "_" between letters or digits stays as it is, because Markdown takes it for no mark.
    return re.sub(r"[\\`*|<\[#~]|(?<!\w)_|_(?!\w)", r"\\\g<0>", line)


def table_csv(tables: Sequence[Table]) -> str:
    """The cells of tables as they are shown, numbers without separators; a line of headers wherever they change.

    Tables of one material begin with a column of its name, because tables of several materials stand in one file.
    """
    lines: list[Sequence[str | None]] = []
    headers: list[str] = []
    for table in tables:
        headers_before = headers
        headers = [f"{name} {unit}".strip() for name, unit in table.headers]
        if table.material:
            headers.insert(0, "material")
        if headers != headers_before:
            lines.append(headers)
        for row in table.rows:
            line = [_for_programs(cell) for cell in row]
            if table.material:
                line.insert(0, table.material)
            lines.append(line)
    return _csv(lines)


def _for_programs(cell: str) -> str | None:
    """A cell as programs read it: 42584 for 42,584, -1.5 for −1.5, None for a dash, and any other text as it is."""
    if cell == NONE:
        return None
    if _NUMBER.fullmatch(cell):
        return cell.replace(",", "").replace("−", "-")
    return cell


def _csv(rows: Iterable[Sequence[str | None]]) -> str:
    """Rows of cells, the headers first, as CSV; None is an empty field."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    for row in rows:
        writer.writerow([cell if cell is None else visible(cell) for cell in row])
    return out.getvalue()


def latex(tables: Sequence[Table]) -> str:
    """Tables to be `\\input`, each a `table` or a `table*` with its notes below it and a label.

    The label is `tab:summary` for the only table of a kind, if it is not of one material, and else as `label` says.
    """
    if not tables:
        return ""
    kinds = [table.kind for table in tables]
    labels: list[str] = []
    for table in tables:
        is_only_one = kinds.count(table.kind) == 1 and not table.material
        labels.append(_free_label(f"tab:{table.kind}" if is_only_one else label(table), labels))
    texts = map(_latex, map(Table.with_short_labels, tables), labels)
    return "\n".join([PACKAGES, *texts])


def _free_label(wanted: str, labels: Sequence[str]) -> str:
    """The wanted label; with a number, from 2, if `labels` has it: materials `a_b` and `a-b` give the same label."""
    numbered = (f"{wanted}-{number}" for number in count(2))
    return next(candidate for candidate in chain([wanted], numbered) if candidate not in labels)


def latex_escaped(text: str) -> str:
    """Text escaped for LaTeX, on one line."""
    # θ_o and θ_i are one symbol each: a mark, which no visible text has, keeps their parts from being escaped.
    marked = " ".join(visible(text).split()).replace("θ_o", "\0o").replace("θ_i", "\0i")
    commands = "".join(_SPECIAL.get(character, character) for character in marked)
    source = commands.replace("\0o", r"\ensuremath{\theta_o}").replace("\0i", r"\ensuremath{\theta_i}")
    # `\\` or `\midrule` before a cell would take a "[" or "*" as its own argument; an empty group parts them.
    return f"{{}}{source}" if source.startswith(("[", "*")) else source


def _latex(table: Table, label: str) -> str:
    """One table as a `table`, or a `table*` over two columns. In a table of words alone the last column is folded.

    The table is set into a box first, so that `_FITTED` can measure its width.
    """
    # The alignment of each column, l(eft), r(ight) or p(aragraph), which is folded.
    align = "l" * table.words + "r" * (len(table.headers) - table.words)
    if table.words == len(table.headers):
        align = align[:-1] + r"p{0.5\textwidth}"
    # The lines of headers; without any unit there is only one.
    heads = []
    names, units = zip(*table.headers, strict=True)
    for words in (names, units):
        if any(words):
            heads.append(_latex_line([latex_escaped(word) for word in words]))
    # The lines of cells, and around them the table and its notes.
    cells = [[latex_escaped(cell) for cell in line] for line in table.rows]
    for (row, column), mark in table.marks.items():
        cells[row][column] = _LATEX_MARKS[mark] % cells[row][column]
    rows = [_latex_line(line) for line in cells]
    environment = "table" if len(table.headers) <= ONE_COLUMN else "table*"
    lines = [
        rf"\begin{{{environment}}}",
        r"\centering",
        rf"\caption{{{latex_escaped(table.title)}}}",
        rf"\label{{{label}}}",
    ]
    lines += [r"\footnotesize", r"\setlength{\tabcolsep}{3pt}", r"\sbox0{%", rf"\begin{{tabular}}{{@{{}}{align}@{{}}}}"]
    lines += [r"\toprule", *heads, r"\midrule", *rows]
    lines += [r"\bottomrule", r"\end{tabular}}%", _FITTED]
    notes = " ".join(latex_escaped(note) for note in map(_for_a_paper, table.footnotes) if note)
    if notes:
        lines += [r"\par\smallskip\begin{minipage}{\linewidth}\raggedright\scriptsize", notes, r"\end{minipage}"]
    return "\n".join([*lines, rf"\end{{{environment}}}", ""])


def _for_a_paper(note: str) -> str:
    """A note without the brackets and sentences that name a page of `docs`, a command or an option of one: the readers
    of a paper have none of these."""
    without_brackets = _IN_BRACKETS.sub(lambda match: "" if _OF_A_PROGRAM.search(match[0]) else match[0], note)
    sentences = _SENTENCE_END.split(without_brackets)
    return " ".join(sentence for sentence in sentences if not _OF_A_PROGRAM.search(sentence))


def _latex_line(cells: Sequence[str]) -> str:
    """A line of a `tabular`, of cells that are escaped already."""
    return " & ".join(cells) + r" \\"


def label(table: Table) -> str:
    """The label of a table for `\\ref`, such as `tab:main-satin`: its kind and its title up to the first bracket, in
    lower-case letters, digits and hyphens."""
    title = table.title.partition(" (")[0]
    # A letter with an accent becomes two characters, of which the second, the accent, is left out.
    characters = unicodedata.normalize("NFKD", title)
    without_accents = "".join(character for character in characters if not unicodedata.combining(character))
    words = re.findall("[A-Za-z0-9]+", without_accents)
    return "-".join([f"tab:{table.kind}", *words]).lower()
