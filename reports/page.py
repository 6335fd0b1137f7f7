"""One self-contained HTML page: every table and figure of a run, its slices, and its materials live.

Nothing in it points outside it, and nothing of the data is executed: data are JSON in elements that no browser runs,
all text is escaped, and a content security policy allows the page's own scripts alone, by their hashes.
"""

import io
import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from html import escape
from importlib.resources import files
from typing import Any

from PIL import Image

from bench.records import ARTEFACT, RESULTS, Run, field_names, grouped, kept
from reports import series
from reports.atlas import MAGMA, Atlases, webp
from reports.figures import Figure
from reports.live import Live, live, pack
from reports.notes import missing_note, run_notes
from reports.numbers import EXACT, fixed, integer
from reports.ranking import ranked
from reports.rows import CodecRows, MaterialRows, Row, materials
from reports.scene_models import scene_gains
from reports.scene_pictures import scene_strips
from reports.shaders.writer import WIDTH
from reports.styles import is_own
from reports.table import Table
from reports.text import contents, details, note, table_html
from reports.viewer.page import as_json, fragment, head

INTERACTIVE = {"rate", "speed", "fits", "footprints", "contact", "latents"}  # drawn by the page itself, or too large
STRIPS = 2  # materials that open the page with a picture
RECORDS_BUDGET = 6_000_000  # characters of JSON; deflated, a quarter of it
FIRST = ("budgets", "when", "summary")  # kinds of tables that open the page
OPEN = {*FIRST, "scene", "main", "unfinished"}  # kinds of tables that are not folded away
GAPS = {
    "speed": "The plot of speed and accuracy is omitted: no codec was timed here under the common conditions.",
    "fits": "The plot of quality over seconds is omitted: no codec here is fitted in steps and recorded a curve.",
    "footprints": "The plot of level of detail is omitted: no codec was measured at several footprints.",
    "slices": "The distribution of slices is omitted: the run's arrays are missing, or no slice has an error.",
    "rate": "The plot of rate and distortion is omitted: no codec has an error here.",
}
HEADER = """<header><h1>{title}</h1>
<button type="button" id="theme" aria-label="switch between dark and light">Theme</button></header>
<main>
"""


def document(
    title: str, body: Iterable[str], codecs: series.Series, plots: Sequence[series.Plot], data: Sequence[str] = ()
) -> Iterator[str]:
    """A page in pieces: its body, then `data`, elements that the body may add to, then the plots that it names."""
    viewer, folder = fragment(), files("reports") / "web"
    styles = [(folder / "report.css").read_text("utf-8"), viewer.css]
    scripts = [viewer.script, *((folder / f"{name}.js").read_text("utf-8") for name in _SCRIPTS)]
    yield head(title, styles, scripts, "img-src data:; ") + HEADER.format(title=escape(title))
    yield from (f"{part}\n" for part in body)
    yield "</main>\n"
    rounded = json.loads(json.dumps(plots), parse_float=lambda text: float(f"{float(text):.5g}"))
    yield from data
    yield _data("data", as_json({"codecs": codecs, "plots": rounded, "width": WIDTH, "magma": MAGMA.tolist()}))
    yield from (f"<script>{script}</script>\n" for script in scripts)
    yield "</body>\n</html>\n"


class Page:
    """Sections in order, and the data that they refer to by id. `share` of the budgets of pictures is its own."""

    def __init__(self, run: Run, tables: Sequence[Table], figures: Sequence[Figure], share: float = 1):
        self.run, self.tables, self.figures = run, tables, figures
        self.rest = [table for table in tables if not table.material and table.kind not in FIRST]
        self.materials = materials(run)
        self.records = PageRecords(run, self.materials)
        self.plots = series.plots_of(run)
        atlases = Atlases(run, self.materials, share)
        self.slices = [atlases.slices_of(material) for material in self.materials]
        self.measured = [material for material in self.materials if material.first]
        # Whose plots open the page: the means, "", or where there are none the first material.
        over_all = any(not plot["material"] for plot in self.plots)
        self.opening = self.measured[0].name if self.measured and not over_all else ""
        self.live = live(run, self.materials, share)
        self.viewer = fragment()  # its models are unpacked when somebody wants to see them
        self.data: list[str] = []

    def pieces(self) -> Iterator[str]:
        """The page in pieces, since its whole text would take several times its size in memory."""
        suite = self.run.starts[-1].get("suite", "") if self.run.starts else ""
        title = f"neubtf-bench {suite}".strip()
        return document(title, self.body(), series.codecs(self.run), self.plots, self.data)

    def body(self) -> Iterator[str]:
        """All that stands in `main`; when it is done, `data` holds all that it refers to."""
        yield from self._body()
        self.data.append(_data("records-data", pack(self.records.records), "text/plain"))

    def _body(self) -> Iterator[str]:
        if not any(table.kind == "main" for table in self.tables):
            yield "<p><strong>Nothing was measured in this run.</strong> The reasons are at the end.</p>"
        yield from self._first()
        yield '<h2 id="summary">Summary</h2>'
        summary = [table for kind in FIRST for table in self.tables if table.kind == kind]
        yield from (self._table(self._narrowed(table)) for table in summary)
        if not summary:
            yield note("The summary is omitted: fewer than two codecs of this run have numbers.")
        yield from (details(figure.title, image(figure)) for figure in self.figures if not figure.material)
        for number, material in enumerate(self.materials):
            yield from self._material(number, material)
        if self.rest:
            yield '<h2 id="more">More</h2>'
            yield from map(self._table, self.rest)
        yield from self.records.html()
        yield from map(note, run_notes(self.run))
        yield f'<template id="viewer">{self.viewer.html}</template>'

    def _first(self) -> Iterator[str]:
        """The first screen: what was measured on what, in a sentence, in pictures and in a plot."""
        if self.measured:
            yield f'<p class="lead">{escape(_sentence(self.measured))}</p>'
        links = [("#summary", "Summary"), *((f"#m{i}", each.name) for i, each in enumerate(self.materials))]
        links += [("#more", "More")] if self.rest else []
        yield contents([*links, ("#records", "Records and provenance")])
        yield CODECS
        strips = "".join(self._strip(self.materials.index(material)) for material in self.measured[:STRIPS])
        yield (
            f'<div class="plots" data-plots="{escape(self.opening)}" data-kinds="rate speed">'
            f'<div class="strips">{strips}</div></div>'
        )

    def _strip(self, number: int) -> str:
        """The truth of a material, and what the run's three best codecs and the reader's own best make of it."""
        material = self.materials[number]
        shown = {row.label: row for row in material.shown}
        known = {codec["label"] for codec in self.slices[number]["codecs"]}
        best: dict[str, Row] = {}  # by codec: at the best of its settings
        for label in (label for label in self._ranking(material) if label in known):
            best.setdefault(str(shown[label].job.get("codec")), shown[label])
        if not best:
            return ""
        pictures = [("", f"{material.name}, truth")]
        rows = list(best.values())
        for row in [*rows[:3], *[row for row in rows[3:] if is_own(row.label)][:1]]:
            psnr = EXACT if row.psnr is None else f"{fixed(row.psnr, 1)} dB"
            pictures.append((row.label, f"{row.label}: {psnr}, {integer(row.job['bytes']['total'])} bytes"))
        figures = "".join(
            f'<figure><canvas data-codec="{escape(label)}"></canvas><figcaption>{escape(words)}</figcaption></figure>'
            for label, words in pictures
        )
        return f'<div class="strip" data-strip="slices{number}">{figures}</div>'

    def _ranking(self, material: MaterialRows) -> list[str]:
        """The labels of the codecs that a strip shows, the best first: of the run, so that all strips show the same."""
        return [each.label for each in ranked(self.run)]

    def _narrowed(self, table: Table) -> Table:
        """The summary, its decibels first, where a narrow window shows them, without what the page says elsewhere."""
        if table.kind != "summary":
            return table
        names = [name for name, _ in table.headers]
        psnr, count = names.index("PSNR"), names.index("materials")
        late = [count] if len({row[count] for row in table.rows}) > 1 else []
        rest = [i for i in range(1, len(names)) if i not in (psnr, count)]
        notes = [each for each in table.notes if each != missing_note(self.run)]
        return replace(table.of_columns([0, psnr, *rest, *late]), notes=notes)

    def _material(self, number: int, material: MaterialRows) -> Iterator[str]:
        yield f'<h2 id="m{number}">{escape(material.name)}</h2>'
        if material.first is None:
            yield "<p>Nothing was measured; the reasons are at the end.</p>"
            return
        drawn = {plot["kind"] for plot in self.plots if plot["material"] == material.name}
        tables = [table for table in self.tables if table.material == material.name]
        yield from self._scene(material, [table for table in tables if table.kind == "scene"])
        kinds = ("" if material.name == self.opening else "rate speed ") + "cost fits footprints slices"
        yield f'<div class="plots" data-plots="{escape(material.name)}" data-kinds="{kinds}"></div>'
        yield from (note(why) for kind, why in GAPS.items() if kind not in drawn)
        yield from self._slices(number, material)
        yield from self._live(number, self.live[material.name])
        others = [table for table in tables if table.kind != "scene"]
        yield from (self._table(table) for table in sorted(others, key=lambda table: table.kind not in OPEN))
        figures = [f for f in self.figures if f.material == material.name and f.kind not in INTERACTIVE]
        yield from (details(figure.title, image(figure)) for figure in figures)

    def _scene(self, material: MaterialRows, tables: Sequence[Table]) -> Iterator[str]:
        """What a run for a scene is read for: the gain of its models of the scene, pictures of it, and its table."""
        if not tables:
            return
        gains = list(scene_gains(material))
        yield f"<h3>In the scene {escape(material.measured[0].job['scene']['name'])}</h3>"
        yield from (f'<p class="lead">{escape(each)}</p>' for each in gains)
        strips = list(scene_strips(self.run, material))
        yield from strips
        if strips:
            yield note("Frames of the scene, small and in 8 bit; their PSNR is that of the whole frames.")
        else:
            yield note("There are no pictures of the scene: the run's frames are not beside its records.")
        for table in tables:
            yield self._table(replace(table, notes=[each for each in table.notes if each not in gains]))

    def _slices(self, number: int, material: MaterialRows) -> Iterator[str]:
        yield "<h3>Slices</h3>"
        slices = self.slices[number]
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
            self.data += [_data(*each, "text/plain") for each in zip(names, material.models.values(), strict=True)]
            megabytes = sum(map(len, material.models.values())) / 1e6
            yield (
                f'<div data-live="{" ".join(names)}"><button type="button">Start: {len(names)} '
                f'material{"s" * (len(names) > 1)}, {megabytes:.1f} MB</button><div class="place"></div></div>'
            )
        reasons = grouped(material.missing, lambda label: material.missing[label])
        yield from (note(f"Not live: {', '.join(labels)}: {why}.") for why, labels in reasons.items())

    def _table(self, table: Table) -> str:
        text = table_html(table, self.records.place)
        return text if table.kind in OPEN else details(table.title, text)


_SCRIPTS = ("core", "tables", "plots", "slices", "live")
CODECS = (
    '<details id="codecs" aria-label="Codecs shown in plots"><summary>Codecs in all plots</summary>'
    '<button type="button" value="all">all</button><button type="button" value="none">none</button>'
    '<div class="boxes"></div></details>'
)


def _sentence(measured: Sequence[MaterialRows]) -> str:
    """What was measured on what."""
    shown = [row.job for material in measured for row in material.shown]
    codecs, settings = ({str(job.get(name)) for job in shown} for name in ("codec", "label"))
    counted = f"{len(codecs)} codec{'s' * (len(codecs) > 1)}"
    counted += f" at {len(settings)} settings" if len(settings) > len(codecs) else ""
    names = [material.name for material in measured]
    listed = ", ".join(names[:6]) + (f" and {len(names) - 6} more" if len(names) > 6 else "")
    splits = {material.split for material in measured}
    size = f" ({splits.pop()})" if len(splits) == 1 else ""
    return f"{counted} on {listed}{size}: each was decoded from its file and compared with the {measured[0].deciding}."


def _data(name: str, text: str, kind: str = "application/json") -> str:
    return f'<script type="{kind}" id="{name}">{text}</script>\n'


def image(figure: Figure) -> str:
    """A figure as WebP: half as large as its PNG, without loss but where it shows slices or texels."""
    lossy = figure.kind == "abrdf"
    how = {"quality": 90, "method": 4} if lossy else {"lossless": True, "quality": 30, "method": 1}
    with Image.open(io.BytesIO(figure.png)) as picture:
        data = webp(picture.convert("RGB"), **how)
    return f'<img class="figure" alt="{escape(figure.title)}" src="{data}">'


class PageRecords:
    """The records of a run, by material and codec, each with its timing, until the budget is spent."""

    def __init__(self, run: Run, materials: Sequence[MaterialRows]):
        self.run = run
        self.records: list[Any] = list(run.starts[-1:])  # in the order of their elements
        self.places: dict[tuple[str, str], str] = {}
        self.names: list[tuple[str, str, str]] = []  # id, title, the fit in words
        self.left_out = 0
        paths = set(field_names(ARTEFACT)) - {"file"}  # of this machine, where several runs are read together
        left = RECORDS_BUDGET
        for m, material in enumerate(materials):
            for c, codec in enumerate(material.codecs):
                jobs = [{name: value for name, value in row.job.items() if name not in paths} for row in codec.rows]
                times = [{"timing": kept(row.timing, RESULTS)} if row.timing else {} for row in codec.rows]
                record = [{"job": job} | time for job, time in zip(jobs, times, strict=True)]
                left -= len(json.dumps(record))
                if left < 0:
                    self.left_out += 1
                    continue
                self.places[material.name, codec.label] = f"#r{m}-{c}"
                self.names.append((f"r{m}-{c}", f"{material.name}, {codec.label}", _fit_in_words(codec)))
                self.records.append(record)

    def place(self, material: str, label: str) -> str:
        """A link to a record's element, without a material to the codec's first one; "" where there is none."""
        if material:
            return self.places.get((material, label), "")
        return next((place for (_, other), place in self.places.items() if other == label), "")

    def html(self) -> Iterator[str]:
        """An element for each record, filled when it is opened."""
        yield '<h2 id="records">Records and provenance</h2>'
        yield note("The records behind each row, as in records.jsonl, without the raw timing samples.")
        start = [("provenance", "the run: machine, packages, revision, suite", "")] if self.run.starts else []
        for number, (place, title, remark) in enumerate([*start, *self.names]):
            more = f' <small class="notes">{escape(remark)}</small>' if remark else ""
            head = f'<details id="{place}" data-record="{number}"><summary>{escape(title)}{more}</summary>'
            yield f"{head}<pre></pre></details>"
        if self.left_out:
            more = f"{self.left_out} more rows have their records only in records.jsonl"
            yield note(f"{more}: this page has no room for them.")


def _fit_in_words(codec: CodecRows) -> str:
    """Seeds, revision and file of a codec's fits, or the status of a failed one."""
    job = codec.rows[0].job
    if job["status"] != "ok":
        return str(job["status"])
    fitted, digest = job.get("fitted") or {}, str(job["score_key"].get("sha256", ""))[:12]
    seeds = f"{len(codec.rows)} seeds" if len(codec.rows) > 1 else ""
    revision = f"fitted by {fitted['git']}" if fitted.get("git") else ""
    return ", ".join(filter(None, [seeds, revision, f"file {digest}"]))
