"""The summary of a run over its materials: the standing of each codec, best bold, second underlined.

A *codec* is here one with its settings, named by its *label*; it has one row. Its *standing* is its place by PSNR among
the codecs: the mean of its *ranks* on the materials, and the number that it *won*, on which none is better. Only a
codec that was measured on all materials has a rank. A model *of a scene* was fitted to the directions that one scene
uses, so it has none. The codecs are *set against* one row by paired differences: the mean over slices (pictures at one
pair of directions) of its PSNR minus that row's, in dB. *Told apart* are two whose difference is hardly chance.
"""

import math
from collections.abc import Sequence
from statistics import fmean
from typing import TYPE_CHECKING, NamedTuple

from bench.records import Run
from reports import columns
from reports.columns import Column
from reports.notes import (
    about_times,
    height_notes,
    left_out_notes,
    missing_note,
    one_texel_notes,
    recipe_notes,
    scene_notes,
)
from reports.numbers import EXACT, NONE, fixed, integer, interval, signed
from reports.rows import CodecRows, MaterialRows, Row, materials
from reports.table import Note, Table, best_cells

if TYPE_CHECKING:
    from bench.compare.paired import Against
    from bench.compare.ranks import Standing

MANY = 10  # materials from which the interval of their mean is shown; on fewer, Student's is too wide to say anything


def summary_table(run: Run, intervals: bool = True, against: str = "") -> Table | None:
    """A row a codec; None if fewer than two codecs were measured. Without `intervals` no slice is read.

    A codec that lacks a material has no means, because they would not be over the materials of the other rows. A model
    of a scene has none either, because it answers for its scene alone. With `intervals`, the codecs are set `against`
    one row; see `reports.ranking.against_one`, which raises `InputError`. `against` is "" for the usual row.
    """
    from reports.ranking import ranked  # loads NumPy, which a table of one material does not need

    measured = [material for material in materials(run) if material.measured]
    ranking = ranked(run)
    if len(ranking) < 2:
        return None

    # A row for each codec, with a score for each cell by which the best of a column is marked.
    chosen = columns.summary(measured)
    headers = [("codec", ""), ("materials", ""), ("mean rank", "↓"), ("won", "↑"), ("PSNR", "dB ↑")]
    headers += [(column.name, column.unit) for column in chosen]
    rows: list[list[str]] = []
    scores: list[list[float | None]] = []
    for standing in ranking:
        row, score = _standing_cells(standing, measured, chosen)
        rows.append(row)
        scores.append(score)
    notes: list[str] = ["Means over seeds, then over materials. Rows are sorted by mean rank, then by PSNR."]
    notes += [*recipe_notes(measured), *scene_notes(measured), *_lacking(measured)]
    # To the right, the differences to one row; they are never marked.
    if intervals:
        labels = [row[0] for row in rows]
        names = [material.name for material in measured]
        differences = _differences(run, labels, names, against)
        headers += differences.headers
        rows = [[*row, *cells] for row, cells in zip(rows, differences.rows, strict=True)]
        notes += differences.notes
    # Notes on times, which only a time that may be compared needs, and on what is left out.
    timed = [row for material in measured for row in material.measured if not row.timing_obstacle]
    notes += [about_times(text) for text in (*one_texel_notes(timed), *height_notes(measured))]
    notes += left_out_notes(run)
    missing = missing_note(run)
    if missing:
        notes.append(missing)
    materials_in_words = ", ".join(material.name for material in measured)
    title = f"Summary over {len(measured)} material{'s' * (len(measured) > 1)}: {materials_in_words}"
    return Table("summary", title, headers, rows, notes, marks=best_cells(rows, scores))


def _standing_cells(
    standing: "Standing", measured: Sequence[MaterialRows], chosen: Sequence[Column]
) -> tuple[list[str], list[float | None]]:
    """The cells of a codec's row, and a score for each by which it is marked (more is better; None: not marked).

    `measured` are the materials with a measured row. A codec without a rank has no means and no scores. `chosen` are
    the columns after that of PSNR.
    """
    has_rank = standing.rank is not None
    # The codec's rows: on each material, and all of them together.
    codecs: list[CodecRows] = []
    seeds: list[Row] = []
    for material in measured:
        for codec in material.codecs:
            if codec.label == standing.label:
                codecs.append(codec)
                seeds += codec.measured

    if not has_rank:
        psnr = NONE
    else:
        psnr = fixed(standing.psnr, 2)
    # In the order of the headers of `summary_table`: each cell with its score.
    scored_cells: list[tuple[str, float | None]] = [
        (standing.label, None),
        (f"{standing.materials} of {len(measured)}", None),
        (fixed(standing.rank, 1), None if standing.rank is None else -standing.rank),  # a smaller rank is better
        (integer(standing.wins), standing.wins),
        (psnr, standing.psnr),
    ]
    for column in chosen:
        mean = _mean(column, codecs) if has_rank else None
        star = column.star(seeds)
        if has_rank and seeds and column.is_exact(seeds):
            scored_cells.append((EXACT, math.inf))
        elif mean is None:
            scored_cells.append((NONE, None))
        elif star:  # a time that was measured apart is not ranked
            scored_cells.append((column.write(mean) + star, None))
        else:
            scored_cells.append((column.write(mean), column.sign * mean))  # the sign is −1 where less is better
    cells = [cell for cell, _ in scored_cells]
    scores = [score if has_rank else None for _, score in scored_cells]
    return cells, scores


def _lacking(measured: Sequence[MaterialRows]) -> list[str]:
    """A list of one note on the codecs without means, with the materials that each lacks; empty without such codecs."""
    measured_on: dict[str, list[str]] = {}  # by label of a model of the whole material: names of materials
    for material in measured:
        for codec in material.codecs:
            if codec.measured and not codec.of_scene:
                measured_on.setdefault(codec.label, []).append(material.name)
    labels_by_lack: dict[tuple[str, ...], list[str]] = {}  # by the materials that these labels lack
    for label, names in measured_on.items():
        lacks = tuple(material.name for material in measured if material.name not in names)
        if lacks:
            labels_by_lack.setdefault(lacks, []).append(label)
    if not labels_by_lack:
        return []
    words = "; ".join(f"{', '.join(labels)} (not on {', '.join(lacks)})" for lacks, labels in labels_by_lack.items())
    return [f"Without means, which would be over fewer materials: {words}. --material NAME chooses."]


class _Differences(NamedTuple):
    """The columns of paired differences of PSNR, which are added to the right of the summary."""

    headers: list[tuple[str, str]]
    rows: list[list[str]]  # their cells, in the order of the rows of the summary
    notes: list[Note]


def _differences(run: Run, labels: Sequence[str], materials: Sequence[str], wanted: str) -> _Differences:
    """The paired differences of PSNR of the rows with these labels to the row `wanted`, "" for the usual one.

    On `MANY` or more materials there is one column: the mean difference with its interval. So it is on a single
    material. In between, such an interval would say little: the column has the mean difference alone, and a further
    column for each material has the difference there with its interval. Reads the slices of the run. `InputError` if
    the run has no row `wanted`.
    """
    from reports.ranking import against_one, rows_of

    against = against_one(run, wanted)
    codec = against.first.partition(" ")[0]  # a label is the codec, then its settings
    codec_has_several_rows = rows_of(codec, run) > 1
    column_for_each = 1 < len(materials) < MANY  # whether each material has a column of its own
    headers = [("against", against.first if codec_has_several_rows else codec)]
    if column_for_each:
        headers += [(f"on {name}", "dB") for name in materials]
    rows = []
    for label in labels:
        over_all = against.over.get(label)  # None for the row itself, and for rows that cannot be compared
        if over_all is None:
            cells = [NONE]
        elif column_for_each:
            mark = " *" if over_all.apart else ""  # a star if the two are told apart
            cells = [signed(over_all.mean) + mark]
        else:
            cells = [interval(over_all)]
        if column_for_each:
            for name in materials:
                on_material = against.on.get(name, {}).get(label)
                cells.append(NONE if on_material is None else interval(on_material))
        rows.append(cells)
    notes = []
    if against.over:
        text = _paired(against, codec_has_several_rows and not wanted, column_for_each)
        notes.append(Note((text, _is_difference)))
    return _Differences(headers, rows, notes)


def _is_difference(name: str) -> bool:
    """Whether a column is one of paired differences, by its name."""
    return name == "against" or name.startswith("on ")


def _paired(against: "Against", first_of_several: bool, column_for_each: bool) -> str:
    """A note on the differences: to which row, what their intervals cover, and how many codecs are told apart.

    `against` has at least one difference. `first_of_several`: the row was picked by default, as the first of several
    rows of its codec. `column_for_each`: each material has a column of its own.
    """
    from bench.compare.statistics import FEWEST

    # The largest numbers of materials and of seeds behind a difference; one of fewer materials is in the same column.
    intervals = against.over.values()
    materials = max(interval.materials for interval in intervals)
    seeds = max(interval.seeds for interval in intervals)
    bootstrap = "a bootstrap over seeds and pairs" if seeds > 1 else "a bootstrap over pairs"
    which = " (its first row; --against LABEL picks another)" if first_of_several else ""
    text = f"Against {against.first}{which}: the mean paired difference of PSNR a slice in dB"
    if column_for_each:
        text += f"; on each material with its 95 % interval, by {bootstrap}, which speaks of that material only."
    else:
        method = bootstrap if materials == 1 else "Student's t"
        text += f" and its 95 % interval, by {method}."
    if materials < FEWEST:  # so no interval has a star, and a count of them would be 0 by definition
        return f"{text} On fewer than {FEWEST} surfaces nothing is told apart."
    count = sum(interval.apart for interval in intervals)
    return f"{text} {count or 'None'} of {len(intervals)} told apart (*), by Holm's correction over the rows."


def _mean(column: Column, codecs: Sequence[CodecRows]) -> float | None:
    """The mean over materials of a column's means over seeds; None if a material has no number.

    `codecs` are the rows of one label, an item for each material.
    """
    means = [column.mean(codec.measured) for codec in codecs if codec.measured]
    numbers = [mean for mean in means if mean is not None]
    if not numbers or len(numbers) < len(means):
        return None
    return fmean(numbers)
