"""Builds the tables of a run as cells of text: columns, rows and footnotes. Other modules format them.

A *job* is one codec with its settings on one material, fitted with one seed; its *label* is the codec with these
settings. A row of a table is a codec with its settings, over all seeds. A *slice* is one picture of a material: all
texels at one *pair* of view and light directions. A model *of a scene* was fitted to the pairs that one scene uses; its
*frames* are pictures of that scene. The *kind* of a table is one of `reports.KINDS`; for each, `_OF_KIND` has a
*maker*, a function that makes the tables of a run. A job is *stale* if the installed version of its codec cannot make
it again.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from math import inf
from statistics import fmean
from typing import NamedTuple, cast

from bench.codecs.alike import stale
from bench.compare.choosing import has_validation
from bench.records import MOST_DB, Job, Run, grouped
from reports import BY_BUDGET, KINDS, columns
from reports.columns import Column
from reports.fits import fit_tables
from reports.notes import common_notes, cost_notes, main_notes, not_run, quality_notes, scene_notes
from reports.numbers import NONE, NOT_COMPARABLE, fixed
from reports.paper import ablation_table, paper_table
from reports.parameters import TimedJob, parameters_table
from reports.rows import CodecRows, MaterialRows, materials
from reports.scene_models import scene_gains, scene_quality
from reports.stress import stress_tables
from reports.summary import summary_table
from reports.table import Table, best_cells
from reports.times import times_tables, variant_tables
from reports.trade import trade_tables

ColumnsOf = Callable[[MaterialRows], Sequence[Column]]  # a function that gives the columns of a material's table
_STALE = " †"  # after a codec whose records are of an older version than the installed one


def all_tables(run: Run, narrow: bool = False, kind: str | None = None, against: str = "") -> list[Table]:
    """Every table that has a row, or those of one `kind`, in the order of `KINDS` and then by material.

    With `narrow`, a main table is two: quality, and size and time. The summary sets codecs `against` a row, a label; ""
    is the one that `reports.ranking` picks, and `InputError` is raised for one that the run lacks.
    """
    rows = [] if kind in BY_BUDGET else materials(run)  # which those do not need, and which takes long
    makers = dict(_OF_KIND)
    makers["summary"] = lambda run, _: [summary_table(run, against=against)]
    if narrow:
        makers["main"] = lambda run, rows: [*_QUALITY(run, rows), *_COST(run, rows)]
    tables: list[Table] = []
    for name in KINDS:
        if kind in (None, name):
            tables += [table for table in makers[name](run, rows) if table]
    return tables if kind in BY_BUDGET else list(_with_stale_rows_marked(run, tables))  # these mark their own


def _with_stale_rows_marked(run: Run, tables: Iterable[Table]) -> Iterator[Table]:
    """The tables, with a mark at each row whose numbers the installed version of its codec cannot make again."""
    reasons: dict[tuple[str, _Fitted], str] = {}  # by material and codec: why it is stale, in words
    finished = [job for job in run.jobs if job["status"] == "ok"]
    reason_of_job = stale(finished)
    for job in finished:
        if job["job"] in reason_of_job:
            fitted = _Fitted(job["codec"], as_published=job.get("settings", {}).get("recipe") == "paper")
            reasons[job["material"], fitted] = reason_of_job[job["job"]]
    for table in tables:
        # Tables of budgets mark their own; settings are timed apart from any job, and a stale job says nothing of them.
        if table.kind in (*BY_BUDGET, "times"):
            yield table
            continue
        of_table = {}
        for (material, fitted), reason in reasons.items():
            if table.material in ("", material):  # a table over all materials has the stale rows of each
                of_table[fitted] = reason
        yield _with_rows_marked(table, of_table)


class _Fitted(NamedTuple):
    """A codec by its name, and whether it was fitted by its paper's recipe, which may have a version of its own."""

    codec: str
    as_published: bool


def _fitted_in(table: Table, cell: str) -> list[_Fitted]:
    """What a row of a table may show, by its cell that names the codec.

    That is a label such as "neumip recipe=paper steps=100", or a line such as "neumip" or
    "neumip, as published". The ablation has the name of the codec alone, whatever the recipe.
    """
    codec = _codec_in(cell)
    if table.kind == "ablation":
        return [_Fitted(codec, as_published=False), _Fitted(codec, as_published=True)]
    return [_Fitted(codec, as_published="recipe=paper" in cell or "as published" in cell)]


def _codec_in(cell: str) -> str:
    """The name of the codec with which a cell begins."""
    return cell.partition(" ")[0].rstrip(",")


def _with_rows_marked(table: Table, reasons: Mapping[_Fitted, str]) -> Table:
    """The table with a mark at the rows of these codecs, and a note that gives the reasons why they are stale."""
    names = [name for name, _ in table.headers]
    column = names.index("codec") if "codec" in names else 0
    rows = []
    reasons_of_rows: dict[str, str] = {}  # by codec that has a row here
    for row in table.rows:
        cell = row[column]
        found = [reasons[fitted] for fitted in _fitted_in(table, cell) if fitted in reasons]
        if found:
            reasons_of_rows[_codec_in(cell)] = found[0]
            row = [*row[:column], cell + _STALE, *row[column + 1 :]]
        rows.append(row)
    notes = list(table.notes)
    if reasons_of_rows:
        words = "; ".join(f"{codec}: {reason}" for codec, reason in reasons_of_rows.items())
        notes.append(f"†: stale, its numbers cannot be made again by the installed version: {words}.")
    return replace(table, rows=rows, notes=notes)


def main_table(material: MaterialRows, chosen: Sequence[Column] = ()) -> Table | None:
    """Cost, quality and time of each codec, or only the `chosen` columns; None if nothing was measured."""
    return _table("main", material, "", chosen or columns.main(material), main_notes(material))


def scene_table(material: MaterialRows) -> Table | None:
    """The quality of each codec in the frames of a scene; None if the run was given no scene, or nothing was
    measured."""
    if material.first is None:
        return None
    scene = material.first.get("scene")
    if not scene:
        return None
    count, height, width = scene["frames"]  # the number of frames, and their sides in pixels
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
    """Jobs without numbers and the reasons, including planned jobs that were not run; None if all have numbers."""
    rows = []
    for material_rows in materials(run):
        for row in material_rows.rows:
            status = row.job["status"]
            if status != "ok":
                status_in_words = "not available" if status == "unavailable" else status
                why = " ".join(str(row.job.get("error", "")).split())  # on one line
                rows.append([row.job["material"], row.name, status_in_words, why])
    for material, label, seeds in not_run(run):
        seeds_in_words = f"seed{'s' * (len(seeds) > 1)} {', '.join(map(str, seeds))}"
        rows.append([material, label, "not run", seeds_in_words])
    if not rows:
        return None
    headers = [("material", ""), ("codec", ""), ("state", ""), ("why", "")]
    return Table("unfinished", "Jobs without a result", headers, rows, words=4)


def _table(kind: str, material: MaterialRows, about: str, chosen: Sequence[Column], notes: list[str]) -> Table | None:
    """A row a codec, the mean over its seeds; the best of each column bold, the second underlined. None without
    columns, or if nothing was measured.

    `about` are words for the title, after the name of the material. `notes` come first below the table.
    """
    if not material.measured or not chosen:
        return None
    name = f"{material.name}: {about}" if about else material.name
    title = f"{name} ({material.split_in_words})"

    # The rows, the best first, and a score for each cell, by which the best of a column is marked.
    by_quality = scene_quality if kind == "scene" else _quality
    codecs = sorted(material.codecs, key=by_quality, reverse=True)
    chosen = [column for column in chosen if not column.sparse or _has_number(column, codecs)]
    rows: list[list[str]] = []
    scores: list[list[float | None]] = []
    for codec in codecs:
        rows.append([codec.label, *_cells(codec, chosen)])
        scores.append([None])  # of the label
        scores[-1] += [_score(kind, column, codec) for column in chosen]

    headers = [("codec", "")]
    for i, column in enumerate(chosen, 1):  # after the label of the codec
        unit = column.unit
        if any(" ± " in row[i] for row in rows):  # a cell shows a deviation: the header says what it is over
            unit += f" ± {column.over}"
        headers.append((column.name, unit.strip()))
    first = material.measured[0].job
    for row in (_native_row(first, chosen), _black_row(first, chosen)):
        if row:  # it has no scores, so it is never marked
            rows.append(row)
    marks = best_cells(rows, scores)
    all_notes = list(notes)
    if kind != "scene":  # they say that models of a scene stand last, which is not so in its table
        all_notes += scene_notes([material])
    all_notes += _seed_notes(material)
    return Table(kind, title, headers, rows, all_notes, material=material.name, marks=marks)


def _has_number(column: Column, codecs: Iterable[CodecRows]) -> bool:
    """Whether a column shows anything but dashes."""
    return any(column.cell(codec.measured) != NONE for codec in codecs)


def _cells(codec: CodecRows, chosen: Sequence[Column]) -> list[str]:
    """The cells of a codec's row after its label. Without numbers they say why: `n/c` in each cell, if a job is not
    comparable; “failed” in the first cell, if a job failed."""
    if not codec.measured and any(row.obstacle for row in codec.rows):
        return [NOT_COMPARABLE] * len(chosen)
    cells = [column.cell(codec.measured) for column in chosen]  # dashes without a measured row
    if not codec.measured and any(row.job["status"] == "failed" for row in codec.rows):
        cells[0] = "failed"
    return cells


def _black_row(job: Job, chosen: Sequence[Column]) -> list[str]:
    """The row of an all-black answer, with its PSNR; empty if the material is well exposed, or no column shows that."""
    shows_psnr = [column.name == columns.HELDOUT.name for column in chosen]
    if "black" not in job or not any(shows_psnr):
        return []
    return ["black", *(fixed(job["black"], 2) if is_psnr else NONE for is_psnr in shows_psnr)]


def _native_row(job: Job, chosen: Sequence[Column]) -> list[str]:
    """The row of the file in which the measured data came, with its bytes and rank, for reference.

    Empty unless that file is a factorisation, such as a codec makes, and a chosen column has a number for it.
    """
    native_file = job.get("provenance", {}).get("native")  # its `bytes`, its `rank`, and its `name` from some readers
    if not native_file or not any(column.native for column in chosen):
        return []
    facts = native_file | {"bits": columns.bits(job, native_file["bytes"])}  # bits a texel
    name = native_file.get("name", "dfmf")  # only the reader of UBO2014, whose files are of this format, gives no name
    cells = [f"{name} (native)"]
    for column in chosen:
        cells.append(column.write(column.native(facts)) if column.native else NONE)
    return cells


def _quality(codec: CodecRows) -> tuple[bool, float]:
    """The key that sorts a table, the greatest first: whether the codec models the whole material and not a scene, then
    the mean PSNR of its seeds. A codec without any number is the last of the models of whole materials."""
    if not codec.measured:
        return True, -inf
    psnr_of_seeds = []
    for row in codec.measured:
        psnr_of_seeds.append(MOST_DB if row.psnr is None else row.psnr)  # None: there is no error
    is_whole = not codec.of_scene
    return is_whole, fmean(psnr_of_seeds)


def _score(kind: str, column: Column, codec: CodecRows) -> float | None:
    """The number by which a cell is marked, more is better; None if the cell is not compared.

    A model of a scene is compared only in the table of the scene, and there only in columns about the scene.
    """
    is_about_scene = kind == "scene" and not column.whole_only
    if codec.of_scene and not is_about_scene:
        return None
    return column.score(codec.measured)


def _seed_notes(material: MaterialRows) -> Iterator[str]:
    """Notes on several seeds, and on codecs that lack some."""
    seeds = material.seeds
    if len(seeds) < 2:
        return
    yield f"Seeds {', '.join(map(str, seeds))}: a number is their mean; “± seeds”: the deviation over them."
    lacking = [codec for codec in material.codecs if 0 < len(codec.measured) < len(seeds)]
    for count, codecs in grouped(lacking, lambda codec: len(codec.measured)).items():
        yield f"{count} of {len(seeds)} seeds: {', '.join(codec.label for codec in codecs)}."


def _of_each_material(
    kind: str,
    about: str,
    columns_of: ColumnsOf,
    notes_of: Callable[[MaterialRows], list[str]] = common_notes,
    first_note: str = "",
) -> "Maker":
    """A maker of a table for each material that was measured; for `kind` and `about` see `_table`.

    `columns_of` and `notes_of` give the columns and the notes of a material's table. `first_note` comes before these.
    """

    def tables(_: Run, rows: list[MaterialRows]) -> Iterator[Table | None]:
        for material in rows:
            if material.measured:
                notes = notes_of(material)
                if first_note:
                    notes = [first_note, *notes]
                yield _table(kind, material, about, columns_of(material), notes)

    return tables


def _by_budget(kind: str) -> "Maker":
    """A maker of the tables of a kind in `BY_BUDGET`. It makes none if no job was scored at validation pairs, by which
    these tables choose settings."""

    def tables(run: Run, _: list[MaterialRows]) -> Iterable[Table]:
        if not any(map(has_validation, run.jobs)):
            return []
        from reports import front  # it loads pandas, which most tables do not need

        return front.TABLES[kind](run)

    return tables


def _of_first_job(columns_of_job: Callable[[Job], list[Column]]) -> ColumnsOf:
    """A function that gives the columns of a material by its first comparable job, whose groups of pairs and footprints
    are those of all comparable jobs."""

    def columns_of(material: MaterialRows) -> list[Column]:
        return columns_of_job(material.first) if material.first else []

    return columns_of


# A function that makes the tables of a kind, from a run and its rows by material; None is no table.
Maker = Callable[[Run, list[MaterialRows]], Iterable[Table | None]]
_QUALITY = _of_each_material("main", "quality", columns.quality, quality_notes)
_COST = _of_each_material("main", "size and time", lambda _: (*columns.SIZE, *columns.time()), cost_notes)
_RELATIVE = "(…): relative to the mean radiance of the same pairs, because an absolute error is small in dark slices."
_BOXES = "Answers over a square of this many texels a side, compared with the box-filtered truth."
_OF_KIND: dict[str, Maker] = {
    **{kind: _by_budget(kind) for kind in BY_BUDGET},
    "main": _of_each_material("main", "", columns.main, main_notes),
    "slices": _of_each_material("slices", "as papers report it, mean ± std over slices", columns.papers, quality_notes),
    "angular": _of_each_material("angular", "display PSNR by direction", _of_first_job(columns.bands)),
    "radiance": _of_each_material(
        "radiance", "error of radiance by direction", _of_first_job(columns.radiance_bands), first_note=_RELATIVE
    ),
    "footprints": _of_each_material(
        "footprints", "display PSNR by footprint", _of_first_job(columns.footprints), first_note=_BOXES
    ),
    "scene": lambda _, rows: map(scene_table, rows),
    "fits": lambda run, _: fit_tables(run),
    "times": lambda run, _: times_tables(run),
    "trade": lambda run, _: [*trade_tables(run), *variant_tables(run, "trade")],
    "paper": lambda run, _: [paper_table(run)],
    "parameters": lambda run, _: [parameters_table([cast(TimedJob, job) for job in run.jobs])],
    "ablation": lambda run, _: [ablation_table(run)],
    "stress": lambda run, _: stress_tables(run),
    "unfinished": lambda run, _: [unfinished_table(run)],
}
