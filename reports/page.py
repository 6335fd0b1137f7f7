"""One self-contained HTML page: every table and figure of a run, its slices, and its materials live.

Nothing in it points outside it, and nothing of the data is executed: data are JSON in elements that no browser runs,
all text is escaped, and a content security policy allows the page's own scripts alone, by their hashes. How it looks
is said in `reports/templates/`; here is what stands in it. The templates call the methods of `Page`.

A *live* material is drawn by the page in the browser, under lights that a reader moves. A *strip* is a row of pictures:
the truth and some codecs' answers at one pair or, of a scene, in one frame. *Own* codecs are those that the package
lacks, most likely the reader's.
"""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from importlib.resources import files
from itertools import chain
from typing import Any

from bench.records import ARTEFACT, RESULTS, Run, field_names, grouped, kept, method_of, rounded
from reports import series
from reports.atlas import MAGMA, Atlases
from reports.figures import Figure
from reports.html import TEMPLATES
from reports.leads import leads
from reports.live import live
from reports.notes import run_notes
from reports.numbers import EXACT, fixed, integer
from reports.ranking import ranked
from reports.rows import CodecRows, MaterialRows, Row, materials
from reports.scene_models import scene_gains
from reports.scene_pictures import scene_strips
from reports.shaders.writer import WIDTH
from reports.styles import is_own
from reports.table import Table
from reports.viewer.page import Data, as_json, fragment, pack

# Kinds of figures that the page does not hold: it draws the first four itself, and the others are too large.
INTERACTIVE = {"rate", "speed", "fits", "footprints", "contact", "latents"}
STRIPS = 2  # materials that open the page with a picture
LEADERS = 3  # the best codecs, of which a strip shows pictures
MOST_NAMES = 6  # of materials in the first sentence of the page
RECORDS_BUDGET = 6_000_000  # characters of JSON; deflated, a quarter of it
FIRST = ("budgets", "when", "summary")  # kinds of tables that open the page
OPEN = {*FIRST, "scene", "main", "unfinished"}  # kinds of tables that are not folded away
# By kind of plot: what the page says where a material has none.
GAPS = {
    "speed": "The plot of speed and accuracy is omitted: no codec was timed here under the common conditions.",
    "fits": "The plot of quality over seconds is omitted: no codec here is fitted in steps and recorded a curve.",
    "footprints": "The plot of level of detail is omitted: no codec was measured at several footprints.",
    "slices": "The distribution of slices is omitted: the run's arrays are missing, or no slice has an error.",
    "rate": "The plot of rate and distortion is omitted: no codec has an error here.",
}
_SCRIPTS = ("unpacked", "core", "tables", "plots", "slices", "live")  # in `reports/web/`
Picture = tuple[str, str]  # the label of a codec ("" for the truth), and the words below the picture


def document(
    template: str,
    title: str,
    looks: series.Series,
    plots: Sequence[series.Plot],
    values: Mapping[str, object],
    data: Iterable[Data] = (),
) -> Iterator[str]:
    """The text of a page in pieces, because the whole text at once would take several times its size in memory.

    `template` is the name of a file in `reports/templates/`, which is filled with `values`. The page's elements of
    data follow: `data`, then one that has `codecs`, the `looks`, and `plots`. `data` is read only as the pieces
    are, so each element is made when its turn comes.
    """
    viewer_css, viewer_script = fragment()
    folder = files("reports") / "web"
    styles = [(folder / "report.css").read_text("utf-8"), viewer_css]
    scripts = [viewer_script]
    scripts += [(folder / f"{name}.js").read_text("utf-8") for name in _SCRIPTS]
    all_data = chain(data, _plot_data(looks, plots))
    page = TEMPLATES.get_template(template)
    return page.generate(values, title=title, styles=styles, scripts=scripts, data=all_data)


def _plot_data(looks: series.Series, plots: Sequence[series.Plot]) -> Iterator[Data]:
    """One element: the plots, with five digits of each number, and what the page's code needs to draw them."""
    content = {"codecs": looks, "plots": rounded(plots, 5), "width": WIDTH, "magma": MAGMA.tolist()}
    yield Data("data", as_json(content))


@dataclass(frozen=True)
class Scene:
    """What a page says of the scene of a run: the gains of models of the scene, strips of pictures, and tables."""

    name: str
    gains: list[str]
    strips: list[list[tuple[str, str]]]  # for each frame its pictures: the words below one, and its data URL
    tables: list[Table]


class Page:
    """What stands on the page of a run.

    Methods that take a material give the content of its section; templates call them. The page may take this `share`
    of the budgets of slices and live models: less than 1 for a page of a board with many pages. The constructor reads
    the run's stored pictures and models, and makes of them the pictures of slices and the packed models.
    """

    unfolded = OPEN  # kinds of tables; a template reads it

    def __init__(self, run: Run, tables: Sequence[Table], figures: Sequence[Figure], share: float = 1):
        self.run = run
        self.tables = tables
        self.figures = figures
        # The tables over all materials that do not open the page stand in its section "More".
        self.rest = [table for table in tables if not table.material and table.kind not in FIRST]
        self.materials = materials(run)
        self.records = PageRecords(run, self.materials)
        self.plots = series.plots_of(run)
        atlases = Atlases(run, self.materials, share)
        self.slices = [atlases.slices_of(material) for material in self.materials]  # in the order of the materials
        self.measured = [material for material in self.materials if material.first]  # those with a comparable row
        self.sentence = _what_was_measured(self.measured) if self.measured else ""
        self.lead = leads(run)
        self.nothing_measured = not any(table.kind == "main" for table in tables)
        has_means = any(plot["material"] == "" for plot in self.plots)  # plots of means over all materials
        # The material whose plots open the page; "" if those of the means do, or if there are no plots.
        self.opening = ""
        if self.measured and not has_means:
            self.opening = self.measured[0].name
        self.live = live(run, self.materials, share)

    def pieces(self) -> Iterator[str]:
        """The text of the page in pieces; its title names the suite that the run's last start measured."""
        suite = self.run.starts[-1].get("suite", "") if self.run.starts else ""
        title = f"neubtf-bench {suite}".strip()
        return document("report.html", title, series.looks(self.run), self.plots, {"page": self}, self.data())

    def data(self) -> Iterator[Data]:
        """The elements of data, to which the page refers by their ids: slices (`slices0`) and live models (`live0-1`)
        by the number of their material, then the records (`records-data`)."""
        for number, material in enumerate(self.materials):
            if material.first is None:  # nothing of it was measured, so its section shows neither
                continue
            if self.slices[number]["codecs"] and not self.kept_back(material):
                yield Data(f"slices{number}", as_json(self.slices[number]))
            for place, model in enumerate(self.live[material.name].models.values()):
                yield Data(f"live{number}-{place}", model, "text/plain")
        yield Data("records-data", pack(self.records.records), "text/plain")

    def links(self) -> list[tuple[str, str]]:
        """The table of contents of the page: the target of each link, and its text."""
        of_materials = [(f"#m{number}", material.name) for number, material in enumerate(self.materials)]
        more = [("#more", "More")] if self.rest else []
        return [("#summary", "Summary"), *of_materials, *more, ("#records", "Records and provenance")]

    def strips(self) -> list[tuple[int, list[Picture]]]:
        """The materials that open the page with pictures, at most `STRIPS`: the number of each in the order of the
        materials, and its pictures."""
        strips = []
        for material in self.measured[:STRIPS]:
            number = self.materials.index(material)
            pictures = self._strip(number)
            if pictures:
                strips.append((number, pictures))
        return strips

    def _strip(self, number: int) -> list[Picture]:
        """The pictures of the material of this number: its truth, the answers of the `LEADERS`, and those of the
        reader's own best codec, if it is not among them. Empty if no ranked codec has pictures."""
        material = self.materials[number]
        row_of = {row.label: row for row in material.shown}
        labels_with_pictures = {codec["label"] for codec in self.slices[number]["codecs"]}
        best_rows: dict[str, Row] = {}  # by codec: the row of the best of its settings
        for label in self._ranking(material):
            if label in labels_with_pictures:
                row = row_of[label]
                best_rows.setdefault(method_of(row.job), row)
        if not best_rows:
            return []
        rows = list(best_rows.values())  # the best first
        leaders, others = rows[:LEADERS], rows[LEADERS:]
        best_own = [row for row in others if is_own(method_of(row.job))][:1]  # a list of one row, or of none
        pictures: list[Picture] = [("", f"{material.name}, truth")]
        for row in [*leaders, *best_own]:
            psnr = EXACT if row.psnr is None else f"{fixed(row.psnr, 1)} dB"  # None: no slice has an error
            pictures.append((row.label, f"{row.label}: {psnr}, {integer(row.job['bytes']['total'])} bytes"))
        return pictures

    def _ranking(self, material: MaterialRows) -> list[str]:
        """The labels from which the strip of a material takes its codecs, the best first.

        Here they are in the order of the whole run, whatever the material, so that all strips show the same codecs.
        """
        return list(ranked(self.materials).index)

    def summary(self) -> list[Table]:
        """The tables that open the page, in the order of `FIRST`."""
        first = [table for table in self.tables if table.kind in FIRST]
        first.sort(key=lambda table: FIRST.index(table.kind))
        return [self._narrowed(table) for table in first]

    def _narrowed(self, table: Table) -> Table:
        """The summary as the page shows it; other tables as they are.

        Its decibels come first, because a narrow window cuts off the right. The number of materials comes last, and
        only if rows differ in it. The note on missing jobs is left out, because the page says it elsewhere.
        """
        if table.kind != "summary":
            return table
        names = [name for name, _ in table.headers]
        psnr = names.index("PSNR")
        count = names.index("materials")
        rows_differ = len({row[count] for row in table.rows}) > 1  # else the column says nothing of any codec
        order = [0, psnr]  # of columns by their old places; 0 is that of the codecs
        order += [column for column in range(1, len(names)) if column not in (psnr, count)]
        if rows_differ:
            order.append(count)
        return table.of_columns(order).without_apart()

    def scene(self, material: MaterialRows) -> Scene | None:
        """What the section of a material says of its scene; None if the run is for none."""
        tables = [table for table in self.tables if table.material == material.name and table.kind == "scene"]
        if not tables:
            return None
        name = material.measured[0].job["scene"]["name"]
        strips = list(scene_strips(self.run, material))
        without_gains = [table.without_apart() for table in tables]  # which the page shows above them
        return Scene(name, list(scene_gains(material)), strips, without_gains)

    def kinds(self, material: MaterialRows) -> str:
        """The kinds of plots in the section of a material, parted by spaces, for the page's script."""
        kinds = "cost fits footprints slices"
        if material.name == self.opening:  # its plots of these two kinds open the page
            return kinds
        return f"rate speed {kinds}"

    def gaps(self, material: MaterialRows) -> list[str]:
        """The sentences of `GAPS` for the plots that the section of a material lacks."""
        kinds_with_plot = {plot["kind"] for plot in self.plots if plot["material"] == material.name}
        return [why for kind, why in GAPS.items() if kind not in kinds_with_plot]

    def kept_back(self, material: MaterialRows) -> str:
        """Why the page must not show slices of a material; "" where it may. A run's own page may show them all."""
        return ""

    def not_live(self, material: MaterialRows) -> dict[str, list[str]]:
        """The labels of the codecs that are not live, by the reason."""
        reason_of = self.live[material.name].missing
        return grouped(reason_of, lambda label: reason_of[label])

    def tables_of(self, material: MaterialRows) -> list[Table]:
        """The tables in the section of a material, those that are not folded away first."""
        tables = [table for table in self.tables if table.material == material.name and table.kind != "scene"]
        return sorted(tables, key=lambda table: table.kind not in OPEN)

    def figures_of(self, material: MaterialRows) -> list[Figure]:
        """The figures in the section of a material, without the kinds that the page does not hold."""
        figures = [figure for figure in self.figures if figure.material == material.name]
        return [figure for figure in figures if figure.kind not in INTERACTIVE]

    def notes(self) -> list[str]:
        """The notes on the whole run."""
        return list(run_notes(self.run))


def _what_was_measured(measured: Sequence[MaterialRows]) -> str:
    """The sentence that opens the page: "2 codecs at 5 settings on satin, wool (64 × 64 texels, 625 training pairs, 150
    held out): each was decoded from its file and compared with the held-out pairs."

    `measured` has at least one material. The size and the pairs are left out if materials differ in them.
    """
    jobs = [row.job for material in measured for row in material.shown]
    codecs = set(map(method_of, jobs))
    settings = {job["label"] for job in jobs}
    codecs_in_words = f"{len(codecs)} codec{'s' if len(codecs) > 1 else ''}"
    if len(settings) > len(codecs):
        codecs_in_words += f" at {len(settings)} settings"
    names = [material.name for material in measured]
    materials_in_words = ", ".join(names[:MOST_NAMES])
    if len(names) > MOST_NAMES:
        materials_in_words += f" and {len(names) - MOST_NAMES} more"
    splits_in_words = {material.split_in_words for material in measured}
    if len(splits_in_words) == 1:
        materials_in_words += f" ({splits_in_words.pop()})"
    deciding_in_words = {material.deciding_in_words for material in measured}
    pairs_in_words = "held-out pairs or, without any, all pairs"
    if len(deciding_in_words) == 1:
        pairs_in_words = deciding_in_words.pop()
    return (
        f"{codecs_in_words} on {materials_in_words}: each was decoded from its file and compared with the "
        f"{pairs_in_words}."
    )


class PageRecords:
    """The records of a run, by material and codec, each with its timing, until `RECORDS_BUDGET` is spent.

    The page has a `details` element for each entry of `names`, and its script fills it from `records`: both have the
    last start of the run first, if the run knows its starts, and are in the same order. A codec's entry is a list of
    its records, one for each seed.
    """

    def __init__(self, run: Run, materials: Sequence[MaterialRows]):
        self.records: list[Any] = list(run.starts[-1:])
        self.places: dict[tuple[str, str], str] = {}  # by material and label: a link to the element
        self.names: list[tuple[str, str, str]] = []  # of each element: its id, its title, and the fit in words
        if run.starts:
            self.names.append(("provenance", "the run: machine, packages, revision, suite", ""))
        self.left_out = 0  # the number of codecs on a material without an element
        # Fields with paths: of several runs that are read together, these paths are absolute, and of this machine.
        path_fields = set(field_names(ARTEFACT)) - {"file"}
        characters_left = RECORDS_BUDGET
        for number, material in enumerate(materials):
            for place, codec in enumerate(material.codecs):
                record = [_record(row, without=path_fields) for row in codec.rows]
                characters_left -= len(json.dumps(record))
                if characters_left < 0:  # it stays so: from the first that does not fit, all are left out
                    self.left_out += 1
                    continue
                element = f"r{number}-{place}"  # its id
                self.places[material.name, codec.label] = f"#{element}"
                self.names.append((element, f"{material.name}, {codec.label}", _fit_in_words(codec)))
                self.records.append(record)

    def place(self, material: str, label: str) -> str:
        """A link to the element of a codec's record, such as `#r0-2`; "" where there is none.

        A table over all materials has the material "": the link is then to the first material that has such a record.
        """
        if material:
            return self.places.get((material, label), "")
        return next((place for (_, label_of_place), place in self.places.items() if label_of_place == label), "")


def _record(row: Row, without: Set[str]) -> dict[str, Any]:
    """A record as the page shows it: under `job` the job without some fields, and under `timing` the results of its
    timing, without samples and conditions, if it has one."""
    job = {name: value for name, value in row.job.items() if name not in without}
    record: dict[str, Any] = {"job": job}
    if row.timing:
        record["timing"] = kept(row.timing, RESULTS)
    return record


def _fit_in_words(codec: CodecRows) -> str:
    """Seeds, revision and hash of a codec's fits, or the status of a failed one: "3 seeds, fitted by 1a2b3c4, file
    0123456789ab". Revision and hash are those of the first seed."""
    job = codec.rows[0].job
    if job["status"] != "ok":
        return str(job["status"])
    words = []
    if len(codec.rows) > 1:
        words.append(f"{len(codec.rows)} seeds")
    fitted = job.get("fitted") or {}
    if fitted.get("git"):
        words.append(f"fitted by {fitted['git']}")
    digest = str(job["score_key"].get("sha256", ""))[:12]  # its beginning tells files apart
    return ", ".join([*words, f"file {digest}"])
