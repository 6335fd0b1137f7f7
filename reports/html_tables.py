"""A table as HTML, its rows linked to their records."""

from collections.abc import Callable, Iterable
from html import escape

from reports.table import BOLD, UNDERLINED, Table

TERMS = {  # of headers, explained above the tables that have them
    "mean rank": "the place by PSNR among the codecs, mean over materials",
    "won": "so many materials on which no codec has a better PSNR",
    "PSNR": "mean over slices",
    "worst tenth": "mean of the worst tenth of the slices",
    "PSNR pooled": "of the squared error of all slices together",
    "bits per": "8 × bytes of the whole file / texels",
    "× floor": "a multiple of the least time that a query can take, that of one bilinear fetch of a colour",
}
_MARKS = {BOLD: "<b>{}</b>", UNDERLINED: "<u>{}</u>", "": "{}"}
Place = Callable[[str, str], str]  # what a first cell links to, by material and cell, or ""


def table_html(table: Table, place: Place) -> str:
    """Title, cells and notes. A row links to the place of its first cell, where that has one."""
    looks = [' class="word"' if i < table.words else "" for i in range(len(table.headers))]
    heads = "".join(
        f'<th scope="col"{look}>{escape(name) or "&nbsp;"}<small>{escape(unit)}</small></th>'
        for (name, unit), look in zip(table.headers, looks, strict=True)
    )
    lines = []
    for i, row in enumerate(table.rows):
        cells = [_MARKS[table.marks.get((i, j), "")].format(escape(cell)) for j, cell in enumerate(row)]
        if target := place(table.material, row[0]):
            cells[0] = f'<a href="{escape(target)}">{cells[0]}</a>'
        tags = (f"<td{look}>{cell}</td>" for cell, look in zip(cells, looks, strict=True))
        lines.append(f"<tr>{''.join(tags)}</tr>")
    rows = "\n".join(lines)
    title, words = escape(table.title), {word.rstrip(" ↑↓") for header in table.headers for word in header}
    terms = "; ".join(f"<b>{escape(term)}</b>: {escape(says)}" for term, says in TERMS.items() if term in words)
    notes = "\n".join(map(note, table.footnotes))
    return (
        f"<h3>{title}</h3>\n"
        + (f'<p class="notes">{terms}.</p>\n' if terms else "")
        + f'<div class="scroll"><table aria-label="{title}"><thead><tr>{heads}</tr></thead>\n'
        f"<tbody>{rows}</tbody></table></div>\n{notes}"
    )


def note(text: str) -> str:
    """A footnote."""
    return f'<p class="notes">{escape(text)}</p>'


def contents(links: Iterable[tuple[str, str]]) -> str:
    """Links, each a place and its name, at the head of a page."""
    items = "".join(f"<li>{anchors([link])}</li>" for link in links)
    return f'<nav aria-label="Contents"><ul>{items}</ul></nav>'


def anchors(links: Iterable[tuple[str, str]]) -> str:
    """Links in a sentence."""
    return ", ".join(f'<a href="{escape(to)}">{escape(name)}</a>' for to, name in links)


def details(title: str, inside: str) -> str:
    """Content that is folded away under its title."""
    return f'<details class="block"><summary>{escape(title)}</summary>\n{inside}</details>'
