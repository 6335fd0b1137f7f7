"""One self-contained HTML page: every table and every figure of a run."""

import base64
from collections.abc import Sequence
from html import escape

from tabulate import tabulate

from bench.records import Run
from reports.figures import Figure
from reports.marks import legend
from reports.notes import run_notes
from reports.rows import materials
from reports.table import BOLD, UNDERLINED, Table

_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; margin: 2rem auto; max-width: 92rem; padding: 0 1rem; color: #1a1a1a;
  background: #fff; color-scheme: light dark }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: 13px }
th, td { padding: .25rem .6rem; border-bottom: 1px solid #ddd; white-space: nowrap }
th { text-align: left; vertical-align: bottom; border-bottom-color: #888 }
th small { font-weight: normal; color: #555 }
.words td { white-space: normal }
.scroll { overflow-x: auto }
.notes { color: #444; font-size: 13px; margin: .4rem 0 }
h2 { margin-top: 2.5rem; border-bottom: 2px solid #1a1a1a }
img { max-width: 100%; display: block; margin: 1rem 0; background: #fff }
th:first-child, td:first-child { position: sticky; left: 0; background: inherit }
tr { background: #fff }
@media (prefers-color-scheme: dark) {
  body, tr { background: #16181c; color: #e4e4e4 }
  th, td { border-bottom-color: #3a3d44 }
  th small, .notes { color: #a8abb2 }
  h2 { border-bottom-color: #e4e4e4 }
}
"""


def page(run: Run, tables: Sequence[Table], figures: Sequence[Figure]) -> str:
    """The page of a run. Nothing in it points outside it."""
    suite = run.starts[-1].get("suite", "") if run.starts else ""
    title = f"neubtf-bench {suite}".strip()
    body = [f"<h1>{escape(title)}</h1>", *(_note(note) for note in run_notes(run))]
    if not any(table.kind == "main" for table in tables):
        body.append("<p><strong>Nothing was measured in this run.</strong></p>")
    body += [_table(table) for table in tables if table.kind == "summary"]
    for material in materials(run):
        body.append(f"<h2>{escape(material.name)}</h2>")
        if material.first is None:
            body.append("<p>Nothing was measured; the reasons are at the end.</p>")
        body += [_table(table) for table in tables if table.material == material.name]
        body += [_image(figure) for figure in figures if figure.material == material.name]
    body += [_table(table) for table in tables if not table.material and table.kind != "summary"]
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<title>{escape(title)}</title>\n'
        f"<style>{_STYLE}</style>\n</head>\n<body>\n" + "\n".join(body) + "\n</body>\n</html>\n"
    )


def _table(table: Table) -> str:
    headers = [escape(name) + (f"<br><small>{escape(unit)}</small>" if unit else "") for name, unit in table.headers]
    align = ["left" if i < table.words else "right" for i in range(len(headers))]
    rows = [[_marked(cell, table.marks.get((i, j))) for j, cell in enumerate(row)] for i, row in enumerate(table.rows)]
    kind = "words" if table.words > 1 else "scroll"
    notes = "\n".join(map(_note, [*table.notes, *legend(table)]))
    text = tabulate(rows, headers, "unsafehtml", colalign=align, disable_numparse=True)
    return f'<h3>{escape(table.title)}</h3>\n<div class="{kind}">{text}</div>\n{notes}'


def _marked(cell: str, mark: str | None) -> str:
    return {BOLD: "<b>{}</b>", UNDERLINED: "<u>{}</u>"}.get(mark or "", "{}").format(escape(cell))


def _note(note: str) -> str:
    return f'<p class="notes">{escape(note)}</p>'


def _image(figure: Figure) -> str:
    data = base64.b64encode(figure.png).decode()
    return f'<h3>{escape(figure.title)}</h3>\n<img alt="{escape(figure.title)}" src="data:image/png;base64,{data}">'
