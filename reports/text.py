"""Tables as plain text and as GitHub Markdown."""

import re
import textwrap
import unicodedata
from collections.abc import Iterator, Sequence

from tabulate import tabulate

from reports.table import BOLD, UNDERLINED, Table

WIDTH = 120
_MARKS = {BOLD: "**{}**", UNDERLINED: "<ins>{}</ins>", "": "{}"}


def plain(tables: Sequence[Table]) -> str:
    """Tables for a terminal, as wide as their columns make them."""
    return "\n\n".join(map(_plain, tables))


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
    return textwrap.fill(note, WIDTH, subsequent_indent="  ")


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
    return re.sub(r"[\\`*|<\[#~]|(?<!\w)_|_(?!\w)", r"\\\g<0>", " ".join(text.split()))
