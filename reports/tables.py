"""Builds the tables of a run as cells of text: columns, rows and footnotes. Other modules format them."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from math import inf
from statistics import fmean
from typing import cast

from bench.codecs.alike import stale
from bench.compare.choosing import has_validation
from bench.records import MOST_DB, Job, Run, grouped
from reports import BY_BUDGET, KINDS, columns
from reports.columns import Column
from reports.fits import fit_tables
from reports.notes import common_notes, cost_notes, main_notes, not_run, quality_notes, scene_notes
from reports.numbers import NONE, NOT_COMPARABLE
from reports.paper import ablation_table, paper_table
from reports.parameters import TimedJob, parameters_table
from reports.rows import CodecRows, MaterialRows, materials
from reports.scene_models import scene_gains, scene_quality
from reports.stress import stress_tables
from reports.summary import summary_table
from reports.table import Table, best_cells
from reports.times import times_tables, variant_tables
from reports.trade import trade_tables

Chosen = Callable[[MaterialRows], Sequence[Column]]  # the columns of a material
_STALE = " †"  # after a codec whose records are of an older version than the installed one


def all_tables(run: Run, narrow: bool = False, kind: str | None = None, against: str = "") -> list[Table]:
    """Every table that has a row, or those of one kind, by kind and then by material.

    With `narrow`, a main table is two: quality, and size and time. The summary sets codecs `against` a row; by default
    the one that `reports.ranking` picks.
    """
    rows = materials(run)
    makers = dict(_OF_KIND)
    makers["summary"] = lambda run, _: [summary_table(run, against=against)]
    if narrow:
        makers["main"] = lambda run, rows: [*_QUALITY(run, rows), *_COST(run, rows)]
    found: list[Table] = []
    for name in KINDS:
        if kind in (None, name):
            found += [table for table in makers[name](run, rows) if table]
    return list(_marked(run, found))


def _marked(run: Run, tables: Iterable[Table]) -> Iterator[Table]:
    """The tables, with a mark at each row whose numbers the installed version of its codec cannot make again."""
    reasons: dict[tuple[str, str], str] = {}  # by material and codec
    for job in run.jobs:
        why = stale(job) if job["status"] == "ok" else ""
        if why:
            reasons[job["material"], job["codec"]] = why
    for table in tables:
        if table.kind == "times":  # settings are timed apart from any job: a stale job says nothing of them
            yield table
        else:
            # By codec; a table over all materials is concerned by the reasons on any of them.
            here = {codec: why for (material, codec), why in reasons.items() if table.material in ("", material)}
            yield _with_stale(table, here)


def _with_stale(table: Table, reasons: dict[str, str]) -> Table:
    """The table with a mark at the rows of these codecs, and a note that gives the reasons, which are by codec."""
    rows = []
    marked: dict[str, str] = {}
    for row in table.rows:
        codec = row[0].partition(" ")[0].rstrip(",")  # of a label "codec key=value", or of a line "codec, key=value"
        if codec in reasons:
            row = [row[0] + _STALE, *row[1:]]
            marked[codec] = reasons[codec]
        rows.append(row)
    notes = list(table.notes)
    if marked:
        words = "; ".join(f"{codec}: {why}" for codec, why in marked.items())
        notes.append(f"†: stale, its numbers cannot be made again by the installed version: {words}.")
    return replace(table, rows=rows, notes=notes)


def main_table(material: MaterialRows, chosen: Sequence[Column] = ()) -> Table | None:
    """Cost, quality and time of each codec; None if nothing was measured."""
    return _table("main", material, "", chosen or columns.main(material), main_notes(material))


def scene_table(material: MaterialRows) -> Table | None:
    """The quality of each codec in the frames of a scene, if the run was given one."""
    scene = material.first.get("scene") if material.first else None
    if material.first is None or not scene:
        return None
    count, height, width = scene["frames"]
    pictures = f"picture{'s' * (count != 1)}"
    notes = [
        *scene_gains(material),
        "Held out in the scene: PSNR of held-out pairs between pairs that the scene uses, weighted by its demand. No "
        "codec saw them; frames have a reference that is interpolated between training pairs, which are seen.",
        f"Frames: the scene's {count} {pictures} of {width} × {height}, rendered from the decoded file and compared "
        "with those of the reference table, over the pixels that show the material.",
        "Weighted: slices of all pairs, weighted by how often the scene looks at them. Outside: at pairs that it never "
        "looks at. PSNR: at the held-out pairs, as in the main table.",
    ]
    about = f"scores in the scene {scene['name']}"
    return _table("scene", material, about, columns.scene(material.first), [*notes, *common_notes(material)])


def unfinished_table(run: Run) -> Table | None:
    """Jobs without numbers and the reasons, including planned jobs that were not run."""
    words = {"failed": "failed", "unavailable": "not available"}
    rows = []
    for material_rows in materials(run):
        for row in material_rows.rows:
            state = row.job["status"]
            if state != "ok":
                why = " ".join(str(row.job.get("error", "")).split())
                rows.append([row.job["material"], row.name, words.get(state, state), why])
    for material, label, seeds in not_run(run):
        rows.append([material, label, "not run", f"seed{'s' * (len(seeds) > 1)} {', '.join(map(str, seeds))}"])
    if not rows:
        return None
    headers = [("material", ""), ("codec", ""), ("state", ""), ("why", "")]
    return Table("unfinished", "Jobs without a result", headers, rows, words=4)


def _table(kind: str, material: MaterialRows, about: str, chosen: Sequence[Column], notes: list[str]) -> Table | None:
    """A row a codec, the mean over its seeds; the best of each column bold, the second underlined."""
    if not material.measured or not chosen:
        return None
    name = f"{material.name}: {about}" if about else material.name
    title = f"{name} ({material.split})"
    by_quality = scene_quality if kind == "scene" else _quality
    codecs = sorted(material.codecs, key=by_quality, reverse=True)
    chosen = [column for column in chosen if not column.sparse or _has_number(column, codecs)]
    rows: list[list[str]] = []
    scores: list[list[float | None]] = []
    for codec in codecs:
        rows.append([codec.label, *_cells(codec, chosen)])
        scores.append([None, *(_score(kind, column, codec) for column in chosen)])
    headers = [("codec", "")]
    for i, column in enumerate(chosen, 1):  # the unit says what the deviation is over, if a cell shows one
        has_deviation = any(" ± " in row[i] for row in rows)
        over = f" ± {column.over}" if has_deviation else ""
        headers.append((column.name, (column.unit + over).strip()))
    native = _native_row(material.measured[0].job, chosen)
    if native:
        rows.append(native)
    marks = best_cells(rows, scores)
    last = [] if kind == "scene" else scene_notes([material])
    notes = [*notes, *last, *_seeds(material)]
    return Table(kind, title, headers, rows, notes, material=material.name, marks=marks)


def _has_number(column: Column, codecs: Iterable[CodecRows]) -> bool:
    """Whether a column shows anything but dashes."""
    return any(column.cell(codec.measured) != NONE for codec in codecs)


def _cells(codec: CodecRows, chosen: Sequence[Column]) -> list[str]:
    """The cells of a codec's row after its label. Without numbers they say why: `n/c` in all, or a first “failed”."""
    if not codec.measured and any(row.obstacle for row in codec.rows):
        return [NOT_COMPARABLE] * len(chosen)
    cells = [column.cell(codec.measured) for column in chosen]
    if not codec.measured and any(row.job["status"] == "failed" for row in codec.rows):
        cells[0] = "failed"
    return cells


def _native_row(job: Job, chosen: Sequence[Column]) -> list[str]:
    """The row of the file in which the measured data came, with its bytes and rank, for reference.

    Empty unless that file is a factorisation, such as a codec makes, and a chosen column has a number for it.
    """
    own = job.get("provenance", {}).get("native")
    if not own or not any(column.native for column in chosen):
        return []
    facts = own | {"bits": columns.bits(job, own["bytes"])}
    cells = [column.write(column.native(facts)) if column.native else NONE for column in chosen]
    return [f"{own.get('name', 'dfmf')} (native)", *cells]


def _quality(codec: CodecRows) -> tuple[bool, float]:
    """What sorts a table, the greatest first: models of whole materials before those of a scene, each by the mean PSNR
    of the codec's seeds. A codec without any number is the last of the models of whole materials."""
    if not codec.measured:
        return True, -inf
    qualities = []
    for row in codec.measured:
        qualities.append(MOST_DB if row.psnr is None else row.psnr)
    return not codec.of_scene, fmean(qualities)


def _score(kind: str, column: Column, codec: CodecRows) -> float | None:
    """The number by which a cell is marked, more is better; None if the cell is not compared. A model of a scene is
    compared only in the table of the scene, and there only in columns about the scene."""
    whole_only = kind != "scene" or column.whole_only
    if codec.of_scene and whole_only:
        return None
    return column.score(codec.measured)


def _seeds(material: MaterialRows) -> Iterator[str]:
    """Notes on several seeds, and on codecs that lack some."""
    seeds = material.seeds
    if len(seeds) < 2:
        return
    yield f"Seeds {', '.join(map(str, seeds))}: a number is their mean; “± seeds”: the deviation over them."
    short = (codec for codec in material.codecs if 0 < len(codec.measured) < len(seeds))
    for count, codecs in grouped(short, lambda codec: len(codec.measured)).items():
        yield f"{count} of {len(seeds)} seeds: {', '.join(codec.label for codec in codecs)}."


def _each(
    kind: str, about: str, chosen: Chosen, notes: Callable[[MaterialRows], list[str]] = common_notes, note: str = ""
) -> "Maker":
    """A function that makes a table for each material that was measured; a `note` comes before other notes."""
    first = [note] if note else []

    def tables(_: Run, rows: list[MaterialRows]) -> Iterator[Table | None]:
        for material in rows:
            if material.measured:
                yield _table(kind, material, about, chosen(material), [*first, *notes(material)])

    return tables


def _by_budget(kind: str) -> "Maker":
    """A function that makes the tables of a kind in `BY_BUDGET`; none if no job was scored at validation pairs."""

    def tables(run: Run, _: list[MaterialRows]) -> Iterable[Table]:
        if not any(map(has_validation, run.jobs)):
            return []
        from reports import budgets  # these load NumPy, which most tables do not need
        from reports.curves import curves_tables

        if kind == "curves":
            return curves_tables(run)
        return budgets.TABLES[kind](run)

    return tables


def _of_first(chosen: Callable[[Job], list[Column]]) -> Chosen:
    """Columns of a material, made from its first comparable job, which says which groups and footprints there are."""
    return lambda material: chosen(material.first) if material.first else []


Maker = Callable[[Run, list[MaterialRows]], Iterable[Table | None]]
_QUALITY = _each("main", "quality", columns.quality, quality_notes)
_COST = _each("main", "size and time", lambda _: (*columns.SIZE, *columns.time()), cost_notes)
_RELATIVE = "(…): relative to the mean radiance of the same pairs, because an absolute error is small in dark slices."
_BOXES = "Answers over a square of this many texels a side, compared with the box-filtered truth."
_OF_KIND: dict[str, Maker] = {
    **{kind: _by_budget(kind) for kind in BY_BUDGET},
    "main": _each("main", "", columns.main, main_notes),
    "slices": _each("slices", "as papers report it, mean ± std over slices", columns.papers, quality_notes),
    "angular": _each("angular", "display PSNR by direction", _of_first(columns.bands)),
    "radiance": _each("radiance", "error of radiance by direction", _of_first(columns.radiance_bands), note=_RELATIVE),
    "footprints": _each("footprints", "display PSNR by footprint", _of_first(columns.footprints), note=_BOXES),
    "scene": lambda _, rows: map(scene_table, rows),
    "fits": lambda run, _: fit_tables(run),
    "times": lambda run, _: times_tables(run),
    "trade": lambda run, _: [*trade_tables(run.folder), *variant_tables(run, "trade")],
    "paper": lambda run, _: [paper_table(run)],
    "parameters": lambda run, _: [parameters_table([cast(TimedJob, job) for job in run.jobs])],
    "ablation": lambda run, _: [ablation_table(run)],
    "stress": lambda run, _: stress_tables(run),
    "unfinished": lambda run, _: [unfinished_table(run)],
}
