"""The pages of a board: the front, one for each material and one for each codec."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

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
from reports.page import Page, Picture, document
from reports.rows import MaterialRows
from reports.table import Table
from reports.tables import all_tables

FRONT = "index.html"
PAGES = 2.2  # all pages of materials together may have so many times the pictures of a run's page, which take 20 MB
_KINDS = "rate speed cost"  # of plots over all materials
_FITS = "as published and ours"  # the name of a codec's plots of fits
_NO_PICTURES = "No pictures: this page was made without the files of the run."
_NOT_FREE = (
    "No pictures: the licence of this measured material is not known to permit them. Plots and tables are whole."
)
_Piece = tuple[str, Iterator[str]]  # the name of a page and its text


class Board:
    """All pages of some sources; what installed codecs say of themselves stands on theirs."""

    def __init__(self, sources: Sequence[Publication], codecs: Mapping[str, Codec]):
        self.sources = sorted((source for source in sources if source.materials), key=_place)
        self.known = codecs
        self.pictured: set[str] = set()  # the materials with pictures
        names = set(codecs)
        for source in self.sources:
            names |= _codecs(source)
            self.pictured |= {job["material"] for job in source.run.jobs if "pictures" in job or "drawing" in job}
        self.codecs = sorted(names)
        self.places = {name: tables.places(name, self.sources) for name in self.codecs}
        self.plots = {source.name: list(_plots(source)) for source in self.sources}

    def pages(self) -> Iterator[_Piece]:
        """Every page, the front first."""
        yield FRONT, self._front([source for source in self.sources if not source.claimed])
        for name, sources in by_material(self.sources):
            yield page_name("material", name), MaterialPage(name, sources, self).pieces()
        for name in self.codecs:
            mine = [source for source in self.sources if name in _codecs(source)]
            yield page_name("codec", name), self._codec(name, mine)

    def _document(
        self,
        template: str,
        title: str,
        sources: Sequence[Publication],
        values: Mapping[str, object],
        more: Sequence[series.Plot] = (),
    ) -> Iterator[str]:
        """A page in pieces: a template with these values, the plots of its sources, `more` plots, and how their codecs
        look."""
        plots: list[series.Plot] = []
        # Colours and markers are given to the codecs of a run in order. All sources are joined to one run for that, so
        # that a codec has one look on the whole page. Materials of two sources may share a name, so in the joined run
        # each is named after its source, too.
        parts: list[tuple[str, Publication, str]] = []
        for source in sources:
            plots += self.plots[source.name]
            parts += [(f"{source.name}/{material.name}", source, material.name) for material in source.materials]
        plots += more
        labels = {each["label"] for plot in plots for each in plot["series"]}
        looks = [look for look in series.codecs(joined(parts)) if look["label"] in labels]
        return document(template, title, looks, plots, {"kinds": _KINDS, "to_material": _to_material, **values})

    def _front(self, sources: Sequence[Publication]) -> Iterator[str]:
        """The front: a section for each source, then all materials, all codecs, and how to hand in results."""
        links = [(page_name("s", source.name), source.name) for source in sources]
        links += [("materials", "Materials"), ("codecs-list", "Codecs"), ("hand-in", "Hand in results")]
        values = {
            "links": [(f"#{place}", name) for place, name in links],
            "sources": map(_section, sources),  # one at a time, for their figures are large
            "budget": in_words(ENOUGH),
            "materials": self._materials(),
            "codecs": self._codecs(),
            "states": STATES,
            "to_codec": self.to_codec,
        }
        return self._document("front.html", "neubtf-bench: results", sources, values)

    def _materials(self) -> Table:
        """A row a material: the kinds of its truth, and the sources that have it."""
        rows = []
        for name, sources in by_material(self.sources):
            titles = ", ".join(source.title for source in sources)
            rows.append([name, _kind(sources[0], name), titles])
        return Table("list", "Materials", [("material", ""), ("truth", ""), ("results", "")], rows, words=3)

    def _codecs(self) -> Table:
        """A row a codec: its line about itself, and in how many of its comparisons no other is better."""
        rows = []
        for name, found in self.places.items():
            won = f"{sum(place.gap >= 0 for place in found)} of {len(found)}" if found else "no result"
            about = self.known[name].about if name in self.known else "not installed here"
            rows.append([name, about, won])
        headers = [("codec", ""), ("about", ""), ("best of", "")]
        return Table("list", "Codecs", headers, rows, ["Best of: the comparisons on its page."], words=2)

    def to_codec(self, _: str, label: str) -> str:
        """The page of the codec that a row's label names; "" if it has none. Templates also give the material."""
        if not label.strip():
            return ""
        name = label.replace(",", " ").split(maxsplit=1)[0]
        return page_name("codec", name) if name in self.places else ""

    def _codec(self, name: str, sources: Sequence[Publication]) -> Iterator[str]:
        """The page of a codec: its settings if it is installed, where it stands, all its rows, and curves of its
        fits."""
        codec = self.known.get(name)
        links = [(codec.paper, "Paper"), (codec.code, "Code")] if codec else []
        values = {
            "front": FRONT,
            "codec": codec,
            "links": [(link, words) for link, words in links if link],
            "recipes": _recipes(codec) if codec and codec.settings else None,
            "standing": tables.standing(name, self.places[name]),
            "fits": _FITS,
            "sources": sources,
            "rows": tables.all_rows(name, sources),
        }
        fits: list[series.Plot] = []
        for source in sources:
            fits += _fits(name, source)
        return self._document("codec.html", name, sources, values, fits)


class MaterialPage(Page):
    """The rows of one material, a section for each source, as the page of a run has one for each material."""

    def __init__(self, name: str, sources: Sequence[Publication], board: Board):
        self.name = name
        self.sources = {source.title: source for source in sources}
        self.to_codec = board.to_codec
        self.truth = _kind(sources[0], name)
        self.origins = []
        for source in self.sources.values():
            for material in source.materials:
                if material.name == name:
                    self.origins.append(tables.origins(source, material, source.title))
        run = joined([(source.title, source, name) for source in sources])
        shown = [table for table in all_tables(run, narrow=True) if table.material]
        super().__init__(run, shown, [], min(1, PAGES / max(1, len(board.pictured))))
        self.live = {title: Live(each.models, {}) for title, each in self.live.items()}
        self.plots = [plot for plot in self.plots if plot["material"]]
        self.opening = ""

    def pieces(self) -> Iterator[str]:
        """The page in pieces."""
        codecs = series.codecs(self.run)
        return document("board_material.html", self.name, codecs, self.plots, {"page": self}, self.data())

    def links(self) -> list[tuple[str, str]]:
        """The front, and the contents of the page."""
        return [(FRONT, "All results"), *((f"#m{i}", each.name) for i, each in enumerate(self.materials))]

    def codecs(self) -> list[tuple[str, str]]:
        """Links to the codecs that have a row here."""
        names: set[str] = set()
        for material in self.materials:
            names.update(map(tables.codec_of, material.rows))
        return [(page_name("codec", name), name) for name in sorted(names)]

    def strips(self) -> list[tuple[int, list[Picture]]]:
        """The first source with pictures: its number, and its pictures."""
        for number in range(len(self.materials)):
            pictures = self._strip(number)
            if pictures:
                return [(number, pictures)]
        return []

    def _ranking(self, material: MaterialRows) -> list[str]:
        """The labels of the codecs that a strip shows, the best on this material first."""
        return [row.label for row in sorted(material.shown, key=by_psnr, reverse=True)]

    def kept_back(self, material: MaterialRows) -> str:
        """Why the page shows no slices of a material: it has no pictures, or none that may be published."""
        if any("pictures" in row.job for row in material.shown):
            return ""
        return _NO_PICTURES if material.first is None or pictures_are_free(material.first) else _NOT_FREE


def _codecs(source: Publication) -> set[str]:
    """The names of the codecs that have a row in a source."""
    names: set[str] = set()
    for material in source.materials:
        names.update(map(tables.codec_of, material.rows))
    return names


def _place(source: Publication) -> tuple[bool, int]:
    """The key that sorts sources on the front: those with budgets first, then by the first kind of their truth."""
    first_kind = _kind(source).partition(",")[0]
    return not source.has_budgets, kind_order(first_kind)


def _to_material(_: str, name: str) -> str:
    """The page of the material that the first cell of a row names; what the whole table is of does not matter."""
    return page_name("material", name)


def _recipes(codec: Codec) -> Table:
    """The settings of an installed codec."""
    headers = [("setting", ""), ("meaning", ""), ("ours", "")]
    title = "The default of every setting"
    if any(published for _, _, _, published in codec.settings):
        headers.append(("as published", ""))
        title = "Both recipes: the defaults of every setting"
    rows = [list(setting[: len(headers)]) for setting in codec.settings]
    return Table("recipes", title, headers, rows, words=2)


def _plots(source: Publication) -> Iterator[series.Plot]:
    """The plots over all materials of a source, or those of its only one, under the name of the source."""
    every = series.plots_of(source.run)
    over_all = [plot for plot in every if not plot["material"]]
    for plot in over_all or every:
        if plot["kind"] in _KINDS.split():
            yield plot | {"material": source.name}


def _fits(name: str, source: Publication) -> Iterator[series.Plot]:
    """Curves of a codec's fits over steps and over seconds, for each material where its published recipe has one."""
    for material, curves in curves_by_material(source.run).items():
        mine = [fit for fit in curves if fit.label.split()[0] == name]
        if not any("recipe=paper" in fit.label for fit in mine):
            continue
        over_steps: dict[str, list[list[float]]] = {}  # by label
        over_seconds: dict[str, list[list[float]]] = {}
        for fit in mine:
            over_steps[fit.label] = [[step, psnr] for step, _, psnr in fit.points if step > 0]
            over_seconds[fit.label] = [[seconds, psnr] for _, seconds, psnr in fit.points if seconds > 0]
        for unit, short, lines in (("steps", "", over_steps), ("seconds", "s", over_seconds)):
            yield {
                "material": _FITS,
                "kind": "fits",
                "title": f"{material} of {source.title}: quality over {unit}",
                "x": {"label": f"{unit} of the fit", "log": True, "unit": short, "less": True},
                "y": {"label": f"{series.QUALITY} (training samples)"},
                "series": [{"label": label, "line": True, "points": line} for label, line in lines.items()],
                "missing": [],
            }


def _section(source: Publication) -> dict[str, Any]:
    """What the front shows of a source; budgets come first, where validation pairs chose settings."""
    run = source.run
    kind = _kind(source)
    ranked = source.has_budgets
    open_tables: list[Table] = []
    if ranked:
        for name in ("front", "budgets", "curves"):
            open_tables += all_tables(run, kind=name)
    return {
        "id": page_name("s", source.name),
        "name": source.name,
        "kind": kind[:1].upper() + kind[1:],
        "split": next((material.split_in_words for material in source.materials if material.measured), ""),
        "strip": strip(run, ENOUGH) if ranked else None,
        "leads": _leads(run) if ranked else [],
        "fronts": fronts(run) if ranked else [],
        "tables": open_tables,
        "ranks": critical_differences(run) if ranked else [],
        "folded": all_tables(run, kind="when" if ranked else "summary"),
    }


def _leads(run: Run) -> list[str]:
    """Words for each kind of surface: which codec leads, and by how much before `AGAINST` or, where that leads itself
    or is missing, before the second."""
    result = budgets(run)
    points = hulls(result, result.surfaces)
    told: list[str] = []
    for kind, surfaces in by_kind(result.surfaces).items():
        means = readings(result, points, ENOUGH, surfaces)
        if len(means) > 1:
            best, *others = means
            other = AGAINST if AGAINST in others else others[0]
            lead = means[best].value - means[other].value
            told.append(f"{best} leads on {kind} surfaces, {lead:.1f} dB before {other}")
    return told


def _kind(source: Publication, material: str = "") -> str:
    """The kinds of truth of a source or of one of its materials, in words."""
    jobs = (job for job in source.run.jobs if job["status"] == "ok" and material in ("", job["material"]))
    return ", ".join(sorted({kind_of(job) for job in jobs}, key=kind_order))
