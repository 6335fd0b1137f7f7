"""One self-contained HTML page: every table and figure of a run, its slices, and its materials live.

Nothing in it points outside it, and nothing of the data is executed: data are JSON in elements that no browser runs,
all text is escaped, and a content security policy allows the page's own scripts alone, by their hashes. How it looks
is said in `reports/templates/`; here is what stands in it.
"""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from importlib.resources import files
from itertools import chain
from typing import Any

from bench.records import ARTEFACT, RESULTS, Run, field_names, grouped, kept
from reports import series
from reports.atlas import MAGMA, Atlases
from reports.figures import Figure
from reports.html import TEMPLATES
from reports.live import live, pack
from reports.notes import missing_note, run_notes
from reports.numbers import EXACT, fixed, integer
from reports.ranking import ranked
from reports.rows import CodecRows, MaterialRows, Row, materials
from reports.scene_models import scene_gains
from reports.scene_pictures import scene_strips
from reports.shaders.writer import WIDTH
from reports.styles import is_own
from reports.table import Table
from reports.viewer.page import Data, as_json, fragment

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
_SCRIPTS = ("core", "tables", "plots", "slices", "live")
Picture = tuple[str, str]  # the label of a codec, "" for the truth, and words below


def document(
    template: str,
    title: str,
    codecs: series.Series,
    plots: Sequence[series.Plot],
    values: Mapping[str, object],
    data: Iterable[Data] = (),
) -> Iterator[str]:
    """A page in pieces, since its whole text would take several times its size in memory.

    Its template fills `main` from the `values`; `data` and the plots that it names follow.
    """
    viewer = fragment()
    folder = files("reports") / "web"
    styles = [(folder / "report.css").read_text("utf-8"), viewer.css]
    scripts = [viewer.script, *((folder / f"{name}.js").read_text("utf-8") for name in _SCRIPTS)]
    every = chain(data, _drawn(codecs, plots))
    return TEMPLATES.get_template(template).generate(values, title=title, styles=styles, scripts=scripts, data=every)


def _drawn(codecs: series.Series, plots: Sequence[series.Plot]) -> Iterator[Data]:
    """The plots, with five digits of each number, and what the page's code needs to draw them."""
    # Numbers lie at any depth: write all as JSON, and round each one when it is read back.
    rounded = json.loads(json.dumps(plots), parse_float=lambda text: float(f"{float(text):.5g}"))
    drawn = {"codecs": codecs, "plots": rounded, "width": WIDTH, "magma": MAGMA.tolist()}
    yield Data("data", as_json(drawn))


@dataclass(frozen=True)
class Scene:
    """What a page says of the scene of a run: the gains of models of the scene, strips of pictures, and tables."""

    name: str
    gains: list[str]
    strips: list[list[tuple[str, str]]]  # words and a picture
    tables: list[Table]


class Page:
    """What stands on the page of a run. The page may take this `share` of the budgets of slices and live models."""

    unfolded = OPEN

    def __init__(self, run: Run, tables: Sequence[Table], figures: Sequence[Figure], share: float = 1):
        self.run = run
        self.tables = tables
        self.figures = figures
        self.rest = [table for table in tables if not table.material and table.kind not in FIRST]
        self.materials = materials(run)
        self.records = PageRecords(run, self.materials)
        self.plots = series.plots_of(run)
        atlases = Atlases(run, self.materials, share)
        self.slices = [atlases.slices_of(material) for material in self.materials]
        self.measured = [material for material in self.materials if material.first]
        self.sentence = _sentence(self.measured) if self.measured else ""
        self.nothing_measured = not any(table.kind == "main" for table in tables)
        # Whose plots open the page: "" for the means over all materials or, where there are none, the first material.
        over_all = any(not plot["material"] for plot in self.plots)
        self.opening = self.measured[0].name if self.measured and not over_all else ""
        self.live = live(run, self.materials, share)

    def pieces(self) -> Iterator[str]:
        """The page in pieces."""
        suite = self.run.starts[-1].get("suite", "") if self.run.starts else ""
        title = f"neubtf-bench {suite}".strip()
        return document("report.html", title, series.codecs(self.run), self.plots, {"page": self}, self.data())

    def data(self) -> Iterator[Data]:
        """The data that the page refers to by their ids."""
        for number, material in enumerate(self.materials):
            if material.first is None:
                continue
            if self.slices[number]["codecs"] and not self.kept_back(material):
                yield Data(f"slices{number}", as_json(self.slices[number]))
            for i, model in enumerate(self.live[material.name].models.values()):
                yield Data(f"live{number}-{i}", model, "text/plain")
        yield Data("records-data", pack(self.records.records), "text/plain")

    def links(self) -> list[tuple[str, str]]:
        """The contents of the page."""
        links = [("#summary", "Summary")]
        links += [(f"#m{i}", material.name) for i, material in enumerate(self.materials)]
        if self.rest:
            links.append(("#more", "More"))
        return [*links, ("#records", "Records and provenance")]

    def strips(self) -> list[tuple[int, list[Picture]]]:
        """The materials that open the page with pictures: the number of each, and its pictures."""
        strips = []
        for material in self.measured[:STRIPS]:
            number = self.materials.index(material)
            pictures = self._strip(number)
            if pictures:
                strips.append((number, pictures))
        return strips

    def _strip(self, number: int) -> list[Picture]:
        """The truth of a material, and what the run's three best codecs and the reader's own best make of it."""
        material = self.materials[number]
        shown = {row.label: row for row in material.shown}
        known = {codec["label"] for codec in self.slices[number]["codecs"]}
        best: dict[str, Row] = {}  # by codec: at the best of its settings
        for label in self._ranking(material):
            if label in known:
                best.setdefault(str(shown[label].job.get("codec")), shown[label])
        if not best:
            return []
        rows = list(best.values())  # the best first
        leaders, others = rows[:3], rows[3:]
        best_own = [row for row in others if is_own(row.label)][:1]
        pictures = [("", f"{material.name}, truth")]
        for row in [*leaders, *best_own]:
            psnr = EXACT if row.psnr is None else f"{fixed(row.psnr, 1)} dB"
            pictures.append((row.label, f"{row.label}: {psnr}, {integer(row.job['bytes']['total'])} bytes"))
        return pictures

    def _ranking(self, material: MaterialRows) -> list[str]:
        """The labels from which a strip takes its codecs, the best of the whole run first, so that all strips show the
        same codecs."""
        return [each.label for each in ranked(self.run)]

    def summary(self) -> list[Table]:
        """The tables that open the page."""
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
        rows_differ = len({row[count] for row in table.rows}) > 1
        late = [count] if rows_differ else []
        rest = [i for i in range(1, len(names)) if i not in (psnr, count)]
        notes = [each for each in table.notes if each != missing_note(self.run)]
        return replace(table.of_columns([0, psnr, *rest, *late]), notes=notes)

    def scene(self, material: MaterialRows) -> Scene | None:
        """What the section of a material says of its scene, if the run is for one."""
        tables = [table for table in self.tables if table.material == material.name and table.kind == "scene"]
        if not tables:
            return None
        name = material.measured[0].job["scene"]["name"]
        gains = list(scene_gains(material))
        without_gains = []
        for table in tables:
            notes = [note for note in table.notes if note not in gains]
            without_gains.append(replace(table, notes=notes))
        return Scene(name, gains, list(scene_strips(self.run, material)), without_gains)

    def kinds(self, material: MaterialRows) -> str:
        """The kinds of plots in the section of a material."""
        kinds = "cost fits footprints slices"
        return kinds if material.name == self.opening else f"rate speed {kinds}"

    def gaps(self, material: MaterialRows) -> list[str]:
        """Why plots are missing in the section of a material."""
        drawn = {plot["kind"] for plot in self.plots if plot["material"] == material.name}
        return [why for kind, why in GAPS.items() if kind not in drawn]

    def kept_back(self, material: MaterialRows) -> str:
        """Why the page must not show slices of a material; "" where it may."""
        return ""

    def not_live(self, material: MaterialRows) -> dict[str, list[str]]:
        """The labels of the codecs that are not live, by the reason."""
        missing = self.live[material.name].missing
        return grouped(missing, lambda label: missing[label])

    def tables_of(self, material: MaterialRows) -> list[Table]:
        """The tables in the section of a material, those that are not folded away first."""
        tables = [table for table in self.tables if table.material == material.name and table.kind != "scene"]
        return sorted(tables, key=lambda table: table.kind not in OPEN)

    def figures_of(self, material: MaterialRows) -> list[Figure]:
        """The figures in the section of a material."""
        return [each for each in self.figures if each.material == material.name and each.kind not in INTERACTIVE]

    def notes(self) -> list[str]:
        """The notes on the whole run."""
        return list(run_notes(self.run))


def _sentence(measured: Sequence[MaterialRows]) -> str:
    """What was measured on what."""
    shown = [row.job for material in measured for row in material.shown]
    codecs = {str(job.get("codec")) for job in shown}
    settings = {str(job.get("label")) for job in shown}
    counted = f"{len(codecs)} codec{'s' * (len(codecs) > 1)}"
    if len(settings) > len(codecs):
        counted += f" at {len(settings)} settings"
    names = [material.name for material in measured]
    listed = ", ".join(names[:6])
    if len(names) > 6:
        listed += f" and {len(names) - 6} more"
    splits = {material.split for material in measured}
    size = f" ({splits.pop()})" if len(splits) == 1 else ""
    return f"{counted} on {listed}{size}: each was decoded from its file and compared with the {measured[0].deciding}."


class PageRecords:
    """The records of a run, by material and codec, each with its timing, until the budget is spent."""

    def __init__(self, run: Run, materials: Sequence[MaterialRows]):
        self.run = run
        self.records: list[Any] = list(run.starts[-1:])  # in the order of their elements
        self.places: dict[tuple[str, str], str] = {}
        self.names: list[tuple[str, str, str]] = []  # id, title, the fit in words
        if run.starts:
            self.names.append(("provenance", "the run: machine, packages, revision, suite", ""))
        self.left_out = 0
        paths = set(field_names(ARTEFACT)) - {"file"}  # of this machine, where several runs are read together
        left = RECORDS_BUDGET
        for m, material in enumerate(materials):
            for c, codec in enumerate(material.codecs):
                record = [_shown_record(row, without=paths) for row in codec.rows]
                left -= len(json.dumps(record))
                if left < 0:
                    self.left_out += 1
                    continue
                self.places[material.name, codec.label] = f"#r{m}-{c}"
                self.names.append((f"r{m}-{c}", f"{material.name}, {codec.label}", _fit_in_words(codec)))
                self.records.append(record)

    def place(self, material: str, label: str) -> str:
        """A link to the element of a codec's record; "" where there is none. Without a material, to its first one."""
        if material:
            return self.places.get((material, label), "")
        for (_, other), place in self.places.items():
            if other == label:
                return place
        return ""


def _shown_record(row: Row, without: Set[str]) -> dict[str, Any]:
    """A job without these fields, and the results of its timing, if it has one."""
    record: dict[str, Any] = {"job": {name: value for name, value in row.job.items() if name not in without}}
    if row.timing:
        record["timing"] = kept(row.timing, RESULTS)
    return record


def _fit_in_words(codec: CodecRows) -> str:
    """Seeds, revision and file of a codec's fits, or the status of a failed one."""
    job = codec.rows[0].job
    if job["status"] != "ok":
        return str(job["status"])
    words = []
    if len(codec.rows) > 1:
        words.append(f"{len(codec.rows)} seeds")
    fitted = job.get("fitted") or {}
    if fitted.get("git"):
        words.append(f"fitted by {fitted['git']}")
    digest = str(job["score_key"].get("sha256", ""))[:12]
    return ", ".join([*words, f"file {digest}"])
