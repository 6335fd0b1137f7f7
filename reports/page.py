"""One self-contained HTML page: every table and figure of a run, its slices, and its materials live.

Nothing in it points outside it, and nothing of the data is executed: data are JSON in elements that no browser runs,
all text is escaped, and a content security policy allows the page's own scripts alone, by their hashes.
"""

import base64
import io
import json
from collections.abc import Iterator, Sequence
from html import escape
from importlib.resources import files

from PIL import Image

from bench.records import Run
from reports import series
from reports.atlas import Atlases
from reports.figures import Figure
from reports.html_tables import details, note, table_html
from reports.live import Live, live
from reports.notes import run_notes
from reports.page_records import PageRecords
from reports.rows import MaterialRows, materials
from reports.shaders.tables import WIDTH
from reports.table import Table
from reports.viewer.page import as_json, fragment, hash_source

INTERACTIVE = {"rate", "speed", "fits", "footprints"}  # figures that the page draws itself
FIRST = ("budgets", "when", "summary")  # kinds of tables that open the page
OPEN = {*FIRST, "main", "unfinished"}  # kinds of tables that are not folded away
GAPS = {
    "speed": "The plot of speed and accuracy is omitted: no codec was timed here under the common conditions.",
    "fits": "The plot of quality over seconds is omitted: no codec here is fitted in steps and recorded a curve.",
    "footprints": "The plot of level of detail is omitted: no codec was measured at several footprints.",
    "slices": "The distribution of slices is omitted: the run's arrays are missing, or no slice has an error.",
    "rate": "The plot of rate and distortion is omitted: no codec has an error here.",
}
HEAD = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src {style_hashes}; \
script-src {script_hashes}; base-uri 'none'; form-action 'none'">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
{styles}
</head>
<body>
<header><h1>{title}</h1>
<button type="button" id="theme" aria-label="switch between dark and light">Theme</button></header>
<main>
"""


def page(run: Run, tables: Sequence[Table], figures: Sequence[Figure]) -> Iterator[str]:
    """The page of a run, in pieces, because its whole text would take several times its size in memory."""
    return _Page(run, tables, figures).pieces()


class _Page:
    """Sections in order, and the data that they refer to by id."""

    def __init__(self, run: Run, tables: Sequence[Table], figures: Sequence[Figure]):
        self.run, self.tables, self.figures = run, tables, figures
        self.materials = materials(run)
        self.records = PageRecords(run, self.materials)
        self.plots = series.plots_of(run)
        self.atlases = Atlases(run, self.materials)
        self.live = live(run, self.materials)
        self.viewer = fragment([])  # its models are unpacked when the reader opens them
        self.data: list[str] = []

    def pieces(self) -> Iterator[str]:
        suite = self.run.starts[-1].get("suite", "") if self.run.starts else ""
        styles = [_asset("report.css"), self.viewer.css]
        scripts = [self.viewer.script, *(_asset(f"{name}.js") for name in _SCRIPTS)]
        yield HEAD.format(
            title=escape(f"neubtf-bench {suite}".strip()),
            style_hashes=" ".join(map(hash_source, styles)),
            script_hashes=" ".join(map(hash_source, scripts)),
            styles="\n".join(f"<style>{style}</style>" for style in styles),
        )
        yield from (f"{part}\n" for part in self._body())
        yield "</main>\n"
        plots = json.loads(json.dumps(self.plots), parse_float=lambda text: float(f"{float(text):.5g}"))
        plain = {"codecs": series.codecs(self.run), "plots": plots, "width": WIDTH}
        yield from self.data
        yield _data("data", as_json(plain))
        yield _packed("records-data", self.records.packed())
        yield from (f"<script>{script}</script>\n" for script in scripts)
        yield "</body>\n</html>\n"

    def _body(self) -> Iterator[str]:
        yield from map(note, run_notes(self.run))
        if not any(table.kind == "main" for table in self.tables):
            yield "<p><strong>Nothing was measured in this run.</strong> The reasons are at the end.</p>"
        yield self._contents()
        yield _CODECS
        yield '<h2 id="summary">Summary</h2>'
        summary = [table for kind in FIRST for table in self.tables if table.kind == kind]
        yield from (self._table(table) for table in summary)
        if not summary:
            yield note("The summary is omitted: fewer than two codecs of this run have numbers.")
        yield '<div class="plots" data-plots=""></div>'
        yield from (details(figure.title, _image(figure)) for figure in self.figures if not figure.material)
        for number, material in enumerate(self.materials):
            yield from self._material(number, material)
        rest = [table for table in self.tables if not table.material and table.kind not in FIRST]
        if rest:
            yield '<h2 id="more">More</h2>'
            yield from (self._table(table) for table in rest)
        yield from self.records.html()
        yield f'<template id="viewer">{self.viewer.html}</template>'

    def _contents(self) -> str:
        links = [("summary", "Summary"), *((f"m{i}", each.name) for i, each in enumerate(self.materials))]
        links += [("more", "More")] if any(not t.material and t.kind not in FIRST for t in self.tables) else []
        links += [("records", "Records and provenance")]
        items = "".join(f'<li><a href="#{escape(to)}">{escape(name)}</a></li>' for to, name in links)
        return f'<nav aria-label="Contents"><ul>{items}</ul></nav>'

    def _material(self, number: int, material: MaterialRows) -> Iterator[str]:
        yield f'<h2 id="m{number}">{escape(material.name)}</h2>'
        if material.first is None:
            yield "<p>Nothing was measured; the reasons are at the end.</p>"
            return
        drawn = {plot["kind"] for plot in self.plots if plot["material"] == material.name}
        yield f'<div class="plots" data-plots="{escape(material.name)}"></div>'
        yield from (note(why) for kind, why in GAPS.items() if kind not in drawn)
        yield from self._slices(number, material)
        yield from self._live(number, self.live[material.name])
        tables = [table for table in self.tables if table.material == material.name]
        yield from (self._table(table) for table in sorted(tables, key=lambda table: table.kind not in OPEN))
        figures = [f for f in self.figures if f.material == material.name and f.kind not in INTERACTIVE]
        yield from (details(figure.title, _image(figure)) for figure in figures)

    def _slices(self, number: int, material: MaterialRows) -> Iterator[str]:
        yield "<h3>Slices</h3>"
        slices = self.atlases.slices_of(material)
        if not slices["codecs"]:
            yield note("There is nothing to show here: the run's pictures are not beside its records.")
            return
        self.data.append(_data(f"slices{number}", as_json(slices)))
        yield f'<div data-slices="slices{number}"></div>'
        if slices["left_out"]:
            yield note("Codecs without pictures of these pairs: " + ", ".join(slices["left_out"]) + ".")
        if slices["quality"] is not None:
            yield note(f"Pictures are WebP of quality {slices['quality']}, so that the page stays small.")

    def _live(self, number: int, material: Live) -> Iterator[str]:
        yield "<h3>Live material</h3>"
        if material.models:
            names = [f"live{number}-{i}" for i in range(len(material.models))]
            self.data += [_packed(name, text) for name, text in zip(names, material.models.values(), strict=True)]
            megabytes = sum(map(len, material.models.values())) / 1e6
            yield (
                f'<div data-live="{" ".join(names)}"><button type="button">Start: {len(names)} '
                f'material{"s" * (len(names) > 1)}, {megabytes:.1f} MB</button><div class="place"></div></div>'
            )
        reasons: dict[str, list[str]] = {}
        for label, why in material.missing.items():
            reasons.setdefault(why, []).append(label)
        yield from (note(f"Not live: {', '.join(labels)}: {why}.") for why, labels in reasons.items())

    def _table(self, table: Table) -> str:
        text = table_html(table, self.records.place)
        return text if table.kind in OPEN else details(table.title, text)


_SCRIPTS = ("core", "tables", "plots", "slices", "live")
_CODECS = (
    '<fieldset id="codecs" aria-label="Codecs shown in plots"><span>Codecs in all plots</span>'
    '<button type="button" value="all">all</button><button type="button" value="none">none</button>'
    '<div class="boxes"></div></fieldset>'
)


def _asset(name: str) -> str:
    return (files("reports") / "web" / name).read_text("utf-8")


def _data(name: str, json: str) -> str:
    return f'<script type="application/json" id="{name}">{json}</script>\n'


def _packed(name: str, text: str) -> str:
    return f'<script type="text/plain" id="{name}">{text}</script>\n'


def _image(figure: Figure) -> str:
    """A figure as WebP: half as large as its PNG; lossless unless it shows slices or texels."""
    lossy = {"contact": 90, "abrdf": 90, "latents": 70}.get(figure.kind)
    how = {"quality": lossy, "method": 0} if lossy else {"lossless": True, "quality": 30, "method": 1}
    out = io.BytesIO()
    with Image.open(io.BytesIO(figure.png)) as picture:
        picture.convert("RGB").save(out, "webp", **how)
    data = base64.b64encode(out.getvalue()).decode()
    return f'<img class="figure" alt="{escape(figure.title)}" src="data:image/webp;base64,{data}">'
