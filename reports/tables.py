"""Builds the tables of a run as cells of text: columns, rows and footnotes. Other modules format them."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain

from bench.records import Run
from reports import KINDS, columns
from reports.best_cells import best_cells
from reports.columns import Column
from reports.fits import fit_tables
from reports.missing import not_run
from reports.notes import common_notes, cost_notes, main_notes, quality_notes
from reports.numbers import NONE, NOT_COMPARABLE
from reports.paper import paper_table
from reports.parameters import parameters_table
from reports.rates import compared, rate_tables
from reports.rows import CodecRows, MaterialRows, materials
from reports.stress import stress_tables
from reports.summary import summary_table
from reports.table import Table
from reports.trade import trade_tables


def all_tables(run: Run, narrow: bool = False, kind: str | None = None) -> list[Table]:
    """Every table that has a row, or those of one kind, by kind and then by material, with every column.

    `narrow` splits the main table in two, each of which fits a printed page.
    """
    makers = _OF_KIND | (_NARROW if narrow else {})
    return [table for name in KINDS if kind in (None, name) for table in makers[name](run, materials(run)) if table]


def main_table(material: MaterialRows, chosen: Sequence[Column] = ()) -> Table | None:
    """Cost, quality and time of each codec; None where nothing was measured."""
    return _table("main", material, "", chosen or columns.main(material), main_notes(material))


def quality_table(material: MaterialRows) -> Table | None:
    """The columns of the main table that say how good a codec is."""
    return _table("main", material, "quality", columns.quality(material), quality_notes(material))


def cost_table(material: MaterialRows) -> Table | None:
    """The columns of the main table that say what a codec costs."""
    return _table("main", material, "size and time", (*columns.SIZE, *columns.time()), cost_notes(material))


def slices_table(material: MaterialRows) -> Table | None:
    """Every metric as papers report it: mean ± std over slices."""
    about = "as papers report it, mean ± std over slices"
    return _table("slices", material, about, columns.papers(material), quality_notes(material))


def angular_table(material: MaterialRows) -> Table | None:
    """Display PSNR by where the held-out pairs lie."""
    chosen = columns.bands(material.first) if material.first else []
    return _table("angular", material, "display PSNR by direction", chosen, common_notes(material))


def radiance_table(material: MaterialRows) -> Table | None:
    """The error of linear radiance by where the held-out pairs lie, absolute and relative to the band's mean."""
    chosen = columns.radiance_bands(material.first) if material.first else []
    note = "(…): relative to the mean radiance of the same pairs, because dark slices flatter an absolute error."
    return _table("radiance", material, "error of radiance by direction", chosen, [note, *common_notes(material)])


def footprint_table(material: MaterialRows) -> Table | None:
    """Display PSNR of answers averaged over several texels."""
    chosen = columns.footprints(material.first) if material.first else []
    note = "Answers over a square of so many texels a side, against box-filtered truth."
    return _table("footprints", material, "display PSNR by footprint", chosen, [note, *common_notes(material)])


def scene_table(material: MaterialRows) -> Table | None:
    """The quality of each codec in the frames of a scene, if the run was given one."""
    if material.first is None or not (scene := material.first.get("scene")):
        return None
    count, height, width = scene["frames"]
    notes = [
        f"Frames: the scene's {count} of {width} × {height}, rendered from the decoded file against the reference "
        "table, over the pixels that show the material.",
        "Weighted: the slices of all pairs, each counting as much as the scene looks at it. Outside: of the pairs that "
        "it does not look at. PSNR: of the held-out pairs, as in the main table.",
    ]
    about = f"judged by the scene {scene['name']}"
    return _table("scene", material, about, columns.scene(material.first), [*notes, *common_notes(material)])


def rate_points(material: MaterialRows) -> Table | None:
    """Size and quality of every codec of a material that has fronts to compare."""
    return _table("rate", material, "rates", columns.RATES, common_notes(material)) if compared(material) else None


def unfinished_table(run: Run) -> Table | None:
    """Jobs without numbers, and why, with those that were planned and not run."""
    words = {"failed": "failed", "unavailable": "not available"}
    rows = [
        [job["material"], name, words.get(job["status"], job["status"]), " ".join(str(job.get("error", "")).split())]
        for name, job in [(row.name, row.job) for each in materials(run) for row in each.rows]
        if job["status"] != "ok"
    ]
    for material, label, seeds in not_run(run):
        rows.append([material, label, "not run", f"seed{'s' * (len(seeds) > 1)} {', '.join(map(str, seeds))}"])
    headers = [("material", ""), ("codec", ""), ("state", ""), ("why", "")]
    return Table("unfinished", "Jobs without a result", headers, rows, words=4) if rows else None


def _table(kind: str, material: MaterialRows, about: str, chosen: Sequence[Column], notes: list[str]) -> Table | None:
    """A row a codec, mean ± std over its seeds; the best of each column bold, the second underlined."""
    if not material.measured or not chosen:
        return None
    title = f"{material.name}" + (f": {about}" if about else "") + f" ({material.split})"
    codecs = material.codecs
    chosen = [c for c in chosen if not c.sparse or any(c.cell(codec.measured) != NONE for codec in codecs)]
    headers = [("codec", ""), *((column.name, column.unit) for column in chosen)]
    rows = [[codec.label, *_cells(codec, chosen)] for codec in codecs]
    scores = [[None, *(column.score(codec.measured) for column in chosen)] for codec in codecs]
    rows += _native_row(material, chosen)
    notes = [*notes, *_seeds(material)]
    return Table(kind, title, headers, rows, notes, material=material.name, marks=best_cells(rows, scores))


def _seeds(material: MaterialRows) -> Iterator[str]:
    """Notes on what ± covers where there are several seeds, and on codecs that lack some."""
    seeds = material.seeds
    if len(seeds) < 2:
        return
    yield (
        f"Seeds {', '.join(map(str, seeds))}: a number is their mean ± std where they differ; mean and std over slices "
        "are means over the seeds."
    )
    short: dict[int, list[str]] = {}
    for codec in material.codecs:
        if 0 < len(codec.measured) < len(seeds):
            short.setdefault(len(codec.measured), []).append(codec.label)
    yield from (f"{count} of {len(seeds)} seeds: {', '.join(labels)}." for count, labels in short.items())


def _native_row(material: MaterialRows, chosen: Sequence[Column]) -> list[list[str]]:
    """The measured data's own file, where it is itself a factorisation: its bytes and rank, for reference."""
    job = material.first
    if job is None or "native" not in job.get("provenance", {}) or not any(column.native for column in chosen):
        return []
    name = job["provenance"]["native"].get("name", "dfmf")
    return [[f"{name} (native)", *(column.native(job) if column.native else NONE for column in chosen)]]


def _cells(codec: CodecRows, chosen: Sequence[Column]) -> list[str]:
    if codec.measured:
        return [column.cell(codec.measured) for column in chosen]
    if any(row.obstacle for row in codec.rows):
        return [NOT_COMPARABLE] * len(chosen)
    word = "failed" if any(row.job["status"] == "failed" for row in codec.rows) else NONE
    return [word] + [NONE] * (len(chosen) - 1)


Makers = dict[str, Callable[[Run, list[MaterialRows]], Iterable[Table | None]]]
_NARROW: Makers = {"main": lambda _, materials: [*map(quality_table, materials), *map(cost_table, materials)]}
_OF_KIND: Makers = {
    "summary": lambda run, _: [summary_table(run)],
    "main": lambda _, materials: map(main_table, materials),
    "slices": lambda _, materials: map(slices_table, materials),
    "angular": lambda _, materials: map(angular_table, materials),
    "radiance": lambda _, materials: map(radiance_table, materials),
    "footprints": lambda _, materials: map(footprint_table, materials),
    "scene": lambda _, materials: map(scene_table, materials),
    "rate": lambda _, materials: [*map(rate_points, materials), *chain.from_iterable(map(rate_tables, materials))],
    "fits": lambda run, _: fit_tables(run),
    "trade": lambda run, _: trade_tables(run.folder),
    "paper": lambda run, _: [paper_table(run)],
    "parameters": lambda run, _: [parameters_table(run.jobs)],
    "stress": lambda run, _: stress_tables(run),
    "unfinished": lambda run, _: [unfinished_table(run)],
}
