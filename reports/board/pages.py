"""The pages of a board: the front, one for each material and one for each codec.

The *kind* of a material's truth is `measured`, `rendered` and the like. A *strip* is a row of pictures: the truth and
some codecs' answers at one pair. Texts reach a page through templates in `reports/templates/`, which also call the
methods of `MaterialPage`. For the other words of a board see `reports.board.sources` and `reports.board.tables`.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from bench.compare.frame import line_of
from bench.records import kind_of, kind_order, method_of, pictures_are_free
from reports import series
from reports.board import tables
from reports.board.sources import STATES, Codec, Publication, by_material, joined, page_name
from reports.figures.significance import critical_differences
from reports.fits import curves_by_material
from reports.front_plots import front_plots
from reports.leads import leads
from reports.live import Live, by_psnr
from reports.page import Page, Picture, document
from reports.rows import MaterialRows
from reports.table import STALE, Table
from reports.tables import all_tables

FRONT = "index.html"
PAGES = 2.2  # all pages of materials together may have so many times the pictures of a run's page, which take 20 MB
_KINDS = ("rate", "speed", "cost")  # of plots over all materials
_OF_LINES = ("size", "time")  # of plots of lines over budgets
_FITS = "as published and ours"  # the name of a codec's plots of fits
_NO_PICTURES = "No pictures: this page was made without the files of the run."
_NOT_FREE = (
    "No pictures: the licence of this measured material is not known to permit them. Plots and tables are whole."
)
_NamedPage = tuple[str, Iterator[str]]  # the name of a page's file, and its text in pieces


class Board:
    """All pages of some sources."""

    def __init__(self, sources: Sequence[Publication], codecs: Mapping[str, Codec]):
        """Prepare what several pages share; `codecs` has by name what installed codecs say of themselves.

        Sources without a row are left out.
        """
        self.sources = sorted((source for source in sources if source.materials), key=_front_order)
        self.installed = codecs
        self.materials_with_pictures: set[str] = set()
        names = set(codecs)
        self.codec_of: dict[str, str] = {}  # by label and line of budgets, the name of the codec
        for source in self.sources:
            names |= _codec_names(source.materials)
            for job in source.run.jobs:
                self.codec_of[job["label"]] = self.codec_of[line_of(job)] = method_of(job)
                if "pictures" in job or "drawing" in job:  # stored slices, or a model that the page draws live
                    self.materials_with_pictures.add(job["material"])
        self.codecs = sorted(names)
        self.plots = {source.name: list(_plots(source)) for source in self.sources}  # by source

    def pages(self) -> Iterator[_NamedPage]:
        """Every page: the name of its file and its text in pieces, the front first. Claimed results do not stand on
        the front."""
        yield FRONT, self._front([source for source in self.sources if not source.claimed])
        for name, sources in by_material(self.sources).items():
            yield page_name("material", name), MaterialPage(name, sources, self).pieces()
        for name in self.codecs:
            sources_with_codec = [source for source in self.sources if name in _codec_names(source.materials)]
            yield page_name("codec", name), self._codec_page(name, sources_with_codec)

    def _document(
        self,
        template: str,
        title: str,
        sources: Sequence[Publication],
        values: Mapping[str, object],
        more: Sequence[series.Plot] = (),
    ) -> Iterator[str]:
        """The text of a page in pieces: a template with these values, `more` plots, those of its sources, and how
        their codecs look.

        `template` is the name of a file in `reports/templates/`; `values` has what it shows by the names that it uses.
        """
        plots = list(more)
        for source in sources:
            plots += self.plots[source.name]
        looks = _looks(sources, plots)
        kinds = " ".join([*_OF_LINES, *_KINDS])  # as the page's script takes them
        common = {"kinds": kinds, "to_material": _to_material}
        return document(template, title, looks, plots, {**common, **values})

    def _front(self, sources: Sequence[Publication]) -> Iterator[str]:
        """The front: a section for each source, then all materials, all codecs, and how to hand in results."""
        # The ids of the page's elements, each with the text of a link to it.
        elements = [(page_name("s", source.name), source.name) for source in sources]
        elements += [("materials", "Materials"), ("codecs-list", "Codecs"), ("hand-in", "Hand in results")]
        values = {
            "links": [(f"#{element}", words) for element, words in elements],
            "sources": map(_section, sources),  # made when the template takes each, because their figures are large
            "materials": self._materials_table(),
            "codecs": self._codecs_table(),
            "states": STATES,
            "to_codec": self.to_codec,
        }
        of_budgets: list[series.Plot] = []
        for source in sources:
            if source.has_budgets:
                for front in front_plots(source.run):
                    of_budgets += [plot | {"material": source.name} for plot in (front.by_size, front.by_time)]
        return self._document("front.html", "neubtf-bench: results", sources, values, of_budgets)

    def _materials_table(self) -> Table:
        """A row a material: the kinds of its truth, and the sources that have it."""
        rows = []
        for name, sources in by_material(self.sources).items():
            kinds = ", ".join(_kinds(sources[0], name))  # as the first of several sources has them
            rows.append([name, kinds, ", ".join(source.title for source in sources)])
        return Table("list", "Materials", [("material", ""), ("truth", ""), ("results", "")], rows, words=3)

    def _codecs_table(self) -> Table:
        """A row a codec: its line about itself."""
        rows = []
        for name in self.codecs:
            about = self.installed[name].about if name in self.installed else "not installed here"
            rows.append([name, about])
        return Table("list", "Codecs", [("codec", ""), ("about", "")], rows, words=2)

    def to_codec(self, _: str, label: str) -> str:
        """The page of the codec that a row's label names; "" if it has none.

        Templates call this with a table's material, too, which does not matter here.
        """
        row = label.removesuffix(STALE)
        name = self.codec_of.get(row, row)
        return page_name("codec", name) if name in self.codecs else ""

    def _codec_page(self, name: str, sources: Sequence[Publication]) -> Iterator[str]:
        """The page of a codec, in pieces: its settings if it is installed, all its rows, and curves of its fits.

        `sources` are those where it has a row.
        """
        codec = self.installed.get(name)
        addresses = ((codec.paper, "Paper"), (codec.code, "Code")) if codec else ()
        values = {
            "front": FRONT,
            "codec": codec,
            "links": [(address, words) for address, words in addresses if address],  # a codec may state neither
            "recipes": _recipes(codec) if codec and codec.settings else None,
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
        """Make the page of a material; `sources` are those that have a row of it.

        It reads the pictures and models of runs at hand, as `Page` does.
        """
        self.name = name
        self.sources = {source.title: source for source in sources}
        self.to_codec = board.to_codec
        self.truth = ", ".join(_kinds(sources[0], name))
        self.origins = []  # a table for each source
        for source in self.sources.values():
            for material in source.materials:
                if material.name == name:
                    self.origins.append(tables.origins(source, material, source.title))
        # In this run each source is a material of its own, under the source's title.
        run = joined([(source.title, source, name) for source in sources])
        # Other tables would be means over these "materials", which are sources of one material.
        tables_of_sources = [table for table in all_tables(run, narrow=True) if table.material]
        # Of the pictures and models that the page of a run may hold.
        share = min(1, PAGES / max(1, len(board.materials_with_pictures)))
        super().__init__(run, tables_of_sources, figures=[], share=share)
        # The page does not say why codecs are not live, and has no plots of means over all "materials".
        self.live = {title: Live(live.models, {}) for title, live in self.live.items()}
        self.plots = [plot for plot in self.plots if plot["material"]]
        self.opening = ""  # so each section has all of its plots

    def pieces(self) -> Iterator[str]:
        """The text of the page in pieces."""
        looks = series.looks(self.run)
        return document("board_material.html", self.name, looks, self.plots, {"page": self}, self.data())

    def links(self) -> list[tuple[str, str]]:
        """The front, and the contents of the page, a section a source: the target of each link, and its text."""
        of_sources = [(f"#m{number}", material.name) for number, material in enumerate(self.materials)]
        return [(FRONT, "All results"), *of_sources]

    def codecs(self) -> list[tuple[str, str]]:
        """Links to the codecs that have a row here: the page of each, and its name."""
        return [(page_name("codec", name), name) for name in sorted(_codec_names(self.materials))]

    def strips(self) -> list[tuple[int, list[Picture]]]:
        """The strip of the first source with pictures alone, as its number and its pictures; empty without any."""
        for number in range(len(self.materials)):
            pictures = self._strip(number)
            if pictures:
                return [(number, pictures)]
        return []

    def _ranking(self, material: MaterialRows) -> list[str]:
        """The labels of the codecs that a strip shows, the best on this material first."""
        return [row.label for row in sorted(material.shown, key=by_psnr, reverse=True)]

    def kept_back(self, material: MaterialRows) -> str:
        """Why the page shows no slices of a material: it has no pictures, or none that may be published. "" if it shows
        some: jobs of a board name only pictures that may be published."""
        if any("pictures" in row.job for row in material.shown):
            return ""
        if material.first is None or pictures_are_free(material.first):
            return _NO_PICTURES
        return _NOT_FREE


def _looks(sources: Sequence[Publication], plots: Sequence[series.Plot]) -> series.Series:
    """How the codecs and lines of some plots look; each has one look on a page, as if all sources were one run."""
    labels_in_plots: set[str] = set()
    lines: dict[str, None] = {}  # of plots over budgets: each once, in order
    for plot in plots:
        labels = [entry["label"] for entry in plot["series"]]
        labels_in_plots.update(labels)
        if plot["kind"] in _OF_LINES:
            lines |= dict.fromkeys(labels)
    parts: list[tuple[str, Publication, str]] = []
    for source in sources:  # materials of two sources may share a name, so each is named after its source, too
        parts += [(f"{source.name}/{material.name}", source, material.name) for material in source.materials]
    return [look for look in series.looks(joined(parts), lines) if look["label"] in labels_in_plots]


def _codec_names(materials: Sequence[MaterialRows]) -> set[str]:
    """The names of the codecs that have a row of some materials."""
    return {method_of(row.job) for material in materials for row in material.rows}


def _front_order(source: Publication) -> tuple[bool, int]:
    """The key that sorts sources on the front: those with budgets first, then by the first kind of their truth."""
    first_kind = next(iter(_kinds(source)), "")
    return not source.has_budgets, kind_order(first_kind)


def _to_material(_: str, name: str) -> str:
    """The page of the material that the first cell of a row names.

    Templates call this with the material of the whole table, too, which does not matter here.
    """
    return page_name("material", name)


def _recipes(codec: Codec) -> Table:
    """The settings of an installed codec, a row each; the defaults as published only if it has that recipe."""
    headers = [("setting", ""), ("meaning", ""), ("ours", ""), ("as published", "")]
    title = "Both recipes: the defaults of every setting"
    # A setting is (name, meaning, default in our recipe, default as published).
    if not any(published for _, _, _, published in codec.settings):
        headers = headers[:3]
        title = "The default of every setting"
    rows = [list(setting[: len(headers)]) for setting in codec.settings]
    return Table("recipes", title, headers, rows, words=2)


def _plots(source: Publication) -> Iterator[series.Plot]:
    """The plots of a source, of the kinds `_KINDS`: means over its materials or, of a single material, its own."""
    plots = series.plots_of(source.run)
    of_means = [plot for plot in plots if plot["material"] == ""]  # there are none of a single material
    for plot in of_means or plots:
        if plot["kind"] in _KINDS:
            # A page has an element for each source, and its script puts there the plots of this "material".
            yield plot | {"material": source.name}


def _fits(name: str, source: Publication) -> Iterator[series.Plot]:
    """Curves of a codec's fits over steps and over seconds, for each material where its published recipe has one.

    They compare recipes, so materials with fits by our recipe alone have none. Each is a plot as `reports.series`
    describes it; all are shown together under `_FITS`.
    """
    for material, curves in curves_by_material(source.run).items():
        fits_of_codec = [fit for fit in curves if fit.codec == name]  # of all its settings
        if not any(fit.published for fit in fits_of_codec):
            continue
        # By label the points of a line. The axes are logarithmic, so the points at 0 are left out.
        over_steps: dict[str, list[list[float]]] = {}
        over_seconds: dict[str, list[list[float]]] = {}
        for fit in fits_of_codec:
            over_steps[fit.label] = [[step, psnr] for step, _, psnr in fit.points if step > 0]
            over_seconds[fit.label] = [[seconds, psnr] for _, seconds, psnr in fit.points if seconds > 0]
        for unit, symbol, lines in (("steps", "", over_steps), ("seconds", "s", over_seconds)):
            yield {
                "material": _FITS,
                "kind": "fits",
                "title": f"{material} of {source.title}: quality over {unit}",
                "x": {"label": f"{unit} of the fit", "log": True, "unit": symbol, "less": True},
                "y": {"label": f"{series.QUALITY} (training samples)"},
                "series": [{"label": label, "line": True, "points": line} for label, line in lines.items()],
                "missing": [],
            }


def _section(source: Publication) -> dict[str, Any]:
    """What the front shows of a source, by the names that its template uses: with budgets figures and tables of these,
    else the summary alone. `ranks` are drawn only when the template takes them."""
    run = source.run
    kinds = ", ".join(_kinds(source))
    # How many pairs were fitted and held out; the first material stands for all.
    splits_in_words = [material.split_in_words for material in source.materials if material.measured]
    section: dict[str, Any] = {
        "id": page_name("s", source.name),
        "name": source.name,
        "kind": kinds[:1].upper() + kinds[1:],  # a heading begins with it
        "split": splits_in_words[0] if splits_in_words else "",
    }
    if not source.has_budgets:
        nothing: dict[str, Any] = {"lead": "", "tables": [], "ranks": []}
        return section | nothing | {"folded": all_tables(run, kind="summary")}
    open_tables: list[Table] = []
    for kind in ("front", "budgets", "curves"):
        open_tables += all_tables(run, kind=kind)
    return section | {
        "lead": leads(run),
        "tables": open_tables,
        "ranks": critical_differences(run),
        "folded": all_tables(run, kind="when"),
    }


def _kinds(source: Publication, material: str = "") -> list[str]:
    """The kinds of truth of a source or, if it is named, of one of its materials, in order: measured, rendered."""
    measured = [job for job in source.run.jobs if job["status"] == "ok" and material in ("", job["material"])]
    return sorted(set(map(kind_of, measured)), key=kind_order)
