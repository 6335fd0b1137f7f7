"""The pages of a board: the front, one for each material and one for each codec."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape

from bench.compare.choosing.budgets import ENOUGH, budgets
from bench.compare.choosing.curves import hulls, readings
from bench.compare.paired import AGAINST
from bench.records import Run, by_kind, kind_of, kind_order, pictures_are_free
from reports import series
from reports.board import tables
from reports.board.sources import STATES, Codec, Publication, by_material, joined, page_name
from reports.budgets import in_words
from reports.figures.contact import strip
from reports.figures.fronts import fronts
from reports.figures.significance import critical_differences
from reports.fits import curves_by_material
from reports.live import Live, by_psnr
from reports.page import CODECS, Page, document, image
from reports.rows import MaterialRows
from reports.table import Table
from reports.tables import all_tables
from reports.text import anchors, contents, details, note, table_html

FRONT = "index.html"
PAGES = 2.2  # budgets of pictures of a run's page, some 20 MB each, for all pages of materials together
_KINDS = "rate speed cost"  # of plots over all materials
_FITS = "as published and ours"  # the name of a codec's plots of fits
_INTRO = (
    "Neural codecs of bidirectional texture functions, behind one interface: bytes of written files, quality at "
    "directions that no fit has seen, time per sample, seconds of fits. Every number is of what was decoded from a "
    "file. Budgets come first: at so many bytes, each codec by the settings that validation pairs choose."
)
_NO_PICTURES = "No pictures: this page was made without the files of the run."
_NOT_FREE = (
    "No pictures: the licence of this measured material is not known to permit them. Plots and tables are whole."
)
_HAND_IN = """<h2 id="hand-in">Hand in results</h2>
<p>Measure your codec, pack records and files, and send the archive with the text that <code>submit</code> prints.
<code>verify</code> decodes every file of it anew and scores it here: its rows are then “verified”.</p>
<pre>neubtf-bench run budgets --codec mine --out runs/mine
neubtf-bench submit runs/mine --codec mine -o mine.zip</pre>"""
_Piece = tuple[str, Iterator[str]]  # the name of a page and its text


class Board:
    """All pages of some sources; what installed codecs say of themselves stands on theirs."""

    def __init__(self, sources: Sequence[Publication], codecs: Mapping[str, Codec]):
        filled = (source for source in sources if source.materials)
        self.sources = sorted(filled, key=lambda s: (not s.has_budgets, kind_order(_kind(s).partition(",")[0])))
        self.known = codecs
        jobs = (job for source in self.sources for job in source.run.jobs)
        self.pictured = {job["material"] for job in jobs if "pictures" in job or "drawing" in job}
        rows = [row for source in self.sources for material in source.materials for row in material.rows]
        self.codecs = sorted({*codecs, *map(tables.codec_of, rows)})
        self.places = {name: tables.places(name, self.sources) for name in self.codecs}
        self.plots = {source.name: list(_plots(source)) for source in self.sources}

    def pages(self) -> Iterator[_Piece]:
        """Every page, the front first."""
        own = [source for source in self.sources if not source.claimed]
        yield FRONT, self._document("neubtf-bench: results", self._front_body(own), own)
        for name, sources in by_material(self.sources):
            page = MaterialPage(name, sources, self)
            text = document(name, page.body(), series.codecs(page.run), page.plots, page.data)
            yield page_name("material", name), text
        for name in self.codecs:
            mine = [s for s in self.sources if any(tables.codec_of(r) == name for m in s.materials for r in m.rows)]
            fits = [plot for source in mine for plot in _fits(name, source)]
            yield page_name("codec", name), self._document(name, self._codec_body(name, mine), mine, fits)

    def _document(
        self, title: str, body: Iterable[str], sources: Sequence[Publication], more: Sequence[series.Plot] = ()
    ) -> Iterator[str]:
        plots = [*(plot for source in sources for plot in self.plots[source.name]), *more]
        labels = {each["label"] for plot in plots for each in plot["series"]}
        names = [(source, material.name) for source in sources for material in source.materials]
        every = series.codecs(joined([(f"{source.name}/{name}", source, name) for source, name in names]))
        return document(title, body, [look for look in every if look["label"] in labels], plots)

    def _front_body(self, sources: Sequence[Publication]) -> Iterator[str]:
        yield f"<p>{_INTRO}</p>"
        links = [("materials", "Materials"), ("codecs-list", "Codecs"), ("hand-in", "Hand in results")]
        links = [(page_name("s", source.name), source.name) for source in sources] + links
        yield contents((f"#{place}", name) for place, name in links)
        yield CODECS
        for source in sources:
            kind = _kind(source)
            yield f'<h2 id="{page_name("s", source.name)}">{kind[:1].upper()}{kind[1:]}: {escape(source.name)}</h2>'
            yield note(next((material.split for material in source.materials if material.measured), ""))
            if source.has_budgets:
                yield from _first(source.run)
                for kind_of_table in ("front", "budgets", "curves"):
                    for table in all_tables(source.run, kind=kind_of_table):
                        yield table_html(table, self._to_codec)
                yield from (details(each.title, image(each)) for each in critical_differences(source.run))
            yield _plots_of(source)
            for table in all_tables(source.run, kind="when" if source.has_budgets else "summary"):
                yield details(table.title, table_html(table, self._to_codec))
        known = by_material(self.sources)
        rows = [[name, _kind(its[0], name), ", ".join(source.title for source in its)] for name, its in known]
        materials = Table("list", "Materials", [("material", ""), ("truth", ""), ("results", "")], rows, words=3)
        yield f'<div id="materials">{table_html(materials, _to_material)}</div>'
        rows = []
        for name, found in self.places.items():
            won = f"{sum(place.gap >= 0 for place in found)} of {len(found)}" if found else "no result"
            rows.append([name, self.known[name].about if name in self.known else "not installed here", won])
        headers, notes = [("codec", ""), ("about", ""), ("best of", "")], ["Best of: the comparisons on its page."]
        codecs = Table("list", "Codecs", headers, rows, notes, words=2)
        yield f'<div id="codecs-list">{table_html(codecs, self._to_codec)}</div>'
        yield _HAND_IN
        yield note(STATES)

    def _to_codec(self, _: str, label: str) -> str:
        name = label.replace(",", " ").split(maxsplit=1)[0] if label.strip() else ""
        return page_name("codec", name) if name in self.places else ""

    def _codec_body(self, name: str, sources: Sequence[Publication]) -> Iterator[str]:
        yield contents([(FRONT, "All results")])
        yield from _about(self.known.get(name))
        standing = tables.standing(name, self.places[name])
        yield table_html(standing, _to_material) if standing else note("Nothing to compare was measured of it.")
        yield CODECS
        yield f'<div class="plots" data-plots="{_FITS}" data-kinds="fits"></div>'
        for source in sources:
            yield f"<h2>{escape(source.title)}</h2>"
            yield _plots_of(source)
        if every := tables.all_rows(name, sources):
            yield table_html(every, _to_material)


class MaterialPage(Page):
    """The rows of one material, a section for each source, as the page of a run has one for each material."""

    def __init__(self, name: str, sources: Sequence[Publication], board: Board):
        self.name, self.sources = name, {source.title: source for source in sources}
        self.board = board
        run = joined([(source.title, source, name) for source in sources])
        rows = ((source, each) for source in self.sources.values() for each in source.materials if each.name == name)
        self.origins = [tables.origins(source, material, source.title) for source, material in rows]
        shown = [table for table in all_tables(run, narrow=True) if table.material]
        super().__init__(run, shown, [], min(1, PAGES / max(1, len(board.pictured))))
        self.plots, self.opening = [plot for plot in self.plots if plot["material"]], ""

    def _body(self) -> Iterator[str]:
        labels = dict.fromkeys(tables.codec_of(row) for material in self.materials for row in material.rows)
        yield contents([(FRONT, "All results"), *((f"#m{i}", each.name) for i, each in enumerate(self.materials))])
        codecs = anchors((page_name("codec", name), name) for name in sorted(labels))
        yield f"<p>The truth is {_kind(next(iter(self.sources.values())), self.name)}. Codecs here: {codecs}</p>"
        strips = filter(None, map(self._strip, range(len(self.materials))))
        yield f'<div class="strips">{next(strips, "")}</div>'
        yield CODECS
        for number, material in enumerate(self.materials):
            yield from self._material(number, material)
            table = self.origins[number]
            yield details(table.title, table_html(table, self.board._to_codec))
        yield from self.records.html()
        yield f'<template id="viewer">{self.viewer.html}</template>'

    def _ranking(self, material: MaterialRows) -> list[str]:
        return [row.label for row in sorted(material.shown, key=by_psnr, reverse=True)]

    def _slices(self, number: int, material: MaterialRows) -> Iterator[str]:
        if any("pictures" in row.job for row in material.shown):
            yield from super()._slices(number, material)
        else:
            free = material.first is None or pictures_are_free(material.first)
            yield note(_NO_PICTURES if free else _NOT_FREE)

    def _live(self, number: int, material: Live) -> Iterator[str]:
        if material.models:
            yield from super()._live(number, Live(material.models, {}))


def _to_material(_: str, name: str) -> str:
    return page_name("material", name)


def _about(codec: Codec | None) -> Iterator[str]:
    """What an installed codec is, what to cite, and its recipes."""
    if codec is None:
        yield "<p>This codec is not installed where the pages were made: its records alone speak of it.</p>"
        return
    yield f"<p>{escape(codec.about)}</p>"
    links = [(link, name) for link, name in ((codec.paper, "Paper"), (codec.code, "Code")) if link]
    yield f"<p>{' · '.join([escape(codec.origin), *filter(None, [anchors(links)])])}</p>"
    if codec.bibtex:
        yield f"<pre>{escape(codec.bibtex)}</pre>"
    if codec.settings:
        published = any(setting[3] for setting in codec.settings)
        headers = [("setting", ""), ("meaning", ""), ("ours", ""), *([("as published", "")] if published else [])]
        rows = [list(setting[: len(headers)]) for setting in codec.settings]
        title = "Both recipes: the defaults of every setting" if published else "The default of every setting"
        yield details(title, table_html(Table("recipes", title, headers, rows, words=2), lambda *_: ""))


def _plots(source: Publication) -> Iterator[series.Plot]:
    """The plots over all materials of a source, or those of its only one, under the name of the source."""
    every = series.plots_of(source.run)
    over = [plot for plot in every if not plot["material"]] or every
    yield from (plot | {"material": source.name} for plot in over if plot["kind"] in _KINDS.split())


def _fits(name: str, source: Publication) -> Iterator[series.Plot]:
    """Curves of a codec's fits over steps and over seconds, for each material where its published recipe has one."""
    for material, curves in curves_by_material(source.run).items():
        mine = [fit for fit in curves if fit.label.split()[0] == name]
        if not any("recipe=paper" in fit.label for fit in mine):
            continue
        for place, unit in enumerate(("steps", "seconds")):
            points = {fit.label: [[at[place], at[2]] for at in fit.points if at[place] > 0] for fit in mine}
            yield {
                "material": _FITS,
                "kind": "fits",
                "title": f"{material} of {source.title}: quality over {unit}",
                "x": {"label": f"{unit} of the fit", "log": True, "unit": unit[0] if place else "", "less": True},
                "y": {"label": f"{series.QUALITY} (training samples)"},
                "series": [{"label": label, "line": True, "points": line} for label, line in points.items()],
                "missing": [],
            }


def _first(run: Run) -> Iterator[str]:
    """A strip of one surface, if pictures are at hand, the fronts of each kind of surface, and who leads on it."""
    result, told = budgets(run), list[str]()
    points = hulls(result, result.surfaces)
    if figure := strip(run, ENOUGH):
        yield f'<div class="scroll">{image(figure)}</div>'
        yield note(f"{figure.title}. The slice is that of the best codec's median PSNR.")
    for kind, surfaces in by_kind(result.surfaces).items():
        means = readings(result, points, ENOUGH, surfaces)
        if len(means) > 1:
            best, *others = means
            other = AGAINST if AGAINST in others else others[0]
            lead = means[best].value - means[other].value
            told.append(f"{best} leads on {kind} surfaces, {lead:.1f} dB before {other}")
    if told:
        yield f"<p>At {in_words(ENOUGH)}, means of test PSNR: {'; '.join(told)}.</p>"
    for number, figure in enumerate(fronts(run)):
        drawn = f'<div class="scroll">{image(figure)}</div>'
        yield details(figure.title, drawn) if number else drawn


def _plots_of(source: Publication) -> str:
    return f'<div class="plots" data-plots="{escape(source.name)}" data-kinds="{_KINDS}"></div>'


def _kind(source: Publication, material: str = "") -> str:
    """The kinds of truth of a source or of one of its materials, in words."""
    jobs = (job for job in source.run.jobs if job["status"] == "ok" and material in ("", job["material"]))
    return ", ".join(sorted({kind_of(job) for job in jobs}, key=kind_order))
