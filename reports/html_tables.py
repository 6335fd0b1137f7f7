"""A table as HTML, its rows linked to their records."""

from collections.abc import Callable
from html import escape

from reports.best_cells import legend
from reports.table import BOLD, UNDERLINED, Table

Place = Callable[[str, str], str]  # of a record, by material and label: the id of its element, or ""


def table_html(table: Table, place: Place) -> str:
    """Title, cells and notes. A row whose first cell names a codec of a record links to it."""
    heads = "".join(
        f'<th scope="col"{_word(i, table)}>{escape(name) or "&nbsp;"}<small>{escape(unit)}</small></th>'
        for i, (name, unit) in enumerate(table.headers)
    )
    rows = "\n".join(
        "<tr>" + "".join(_cell(table, i, j, cell, place) for j, cell in enumerate(row)) + "</tr>"
        for i, row in enumerate(table.rows)
    )
    title = escape(table.title)
    notes = "\n".join(map(note, [*table.notes, *legend(table)]))
    return (
        f'<h3>{title}</h3>\n<div class="scroll"><table aria-label="{title}"><thead><tr>{heads}</tr></thead>\n'
        f"<tbody>{rows}</tbody></table></div>\n{notes}"
    )


def note(text: str) -> str:
    """A footnote."""
    return f'<p class="notes">{escape(text)}</p>'


def details(title: str, inside: str) -> str:
    """Content that is folded away under its title."""
    return f'<details class="block"><summary>{escape(title)}</summary>\n{inside}</details>'


def _word(column: int, table: Table) -> str:
    return ' class="word"' if column < table.words else ""


def _cell(table: Table, row: int, column: int, cell: str, place: Place) -> str:
    mark = {BOLD: "<b>{}</b>", UNDERLINED: "<u>{}</u>"}.get(table.marks.get((row, column), ""), "{}")
    text = mark.format(escape(cell))
    if column == 0 and (target := place(table.material, cell)):
        text = f'<a href="#{target}">{text}</a>'
    return f"<td{_word(column, table)}>{text}</td>"
