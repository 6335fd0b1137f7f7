"""The summary of a run over its materials: the standing of each codec, best bold, second underlined."""

from collections.abc import Sequence
from statistics import fmean
from typing import TYPE_CHECKING

from bench.records import MOST_DB, Run
from reports import columns
from reports.columns import Column
from reports.notes import about_times, height_notes, left_out_notes, missing_note, one_texel_notes, scene_notes
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
    one row; see `reports.ranking.against_one`, which raises `InputError`.
    """
    from reports.ranking import ranked  # loads NumPy, which a table of one material does not need

    measured = [material for material in materials(run) if material.measured]
    ranking = ranked(run)
    if len(ranking) < 2:
        return None
    chosen = columns.summary(measured)
    headers = [("codec", ""), ("materials", ""), ("mean rank", "↓"), ("won", "↑"), ("PSNR", "dB ↑")]
    headers += [(column.name, column.unit) for column in chosen]
    rows: list[list[str]] = []
    scores: list[list[float | None]] = []
    for standing in ranking:
        row, score = _standing_cells(standing, measured, chosen)
        rows.append(row)
        scores.append(score)
    notes: list[str] = ["Means over seeds, then over materials: docs/metrics.md, “Tables”."]
    notes += [*scene_notes(measured), *_lacking(measured)]
    if intervals:
        more, cells, note = _differences(run, [row[0] for row in rows], [each.name for each in measured], against)
        headers += more
        rows = [[*row, *added] for row, added in zip(rows, cells, strict=True)]
        notes += note
    timed = [row for material in measured for row in material.measured if not row.timing_obstacle]
    notes += [about_times(text) for text in (*one_texel_notes(timed), *height_notes(measured))]
    notes += left_out_notes(run)
    missing = missing_note(run)
    if missing:
        notes.append(missing)
    names = ", ".join(material.name for material in measured)
    title = f"Summary over {len(measured)} material{'s' * (len(measured) > 1)}: {names}"
    return Table("summary", title, headers, rows, notes, marks=best_cells(rows, scores))


def _standing_cells(
    standing: "Standing", measured: Sequence[MaterialRows], chosen: Sequence[Column]
) -> tuple[list[str], list[float | None]]:
    """The cells of a codec's row, and their scores; a codec without a rank has no means and no scores."""
    has_rank = standing.rank is not None
    codecs: list[CodecRows] = []
    seeds: list[Row] = []
    for material in measured:
        for codec in material.codecs:
            if codec.label == standing.label:
                codecs.append(codec)
                seeds += codec.measured

    if not has_rank:
        psnr = NONE
    elif standing.psnr >= MOST_DB:
        psnr = EXACT
    else:
        psnr = fixed(standing.psnr, 2)
    materials_of = f"{standing.materials} of {len(measured)}"
    # In the order of the headers of `summary_table`; the label and the number of materials are not scored.
    row = [standing.label, materials_of, fixed(standing.rank, 1), integer(standing.wins), psnr]
    rank_score = None if standing.rank is None else -standing.rank
    score = [None, None, rank_score, standing.wins, standing.psnr]
    for column in chosen:
        mean = _mean(column, codecs) if has_rank else None
        star = column.star(seeds)
        row.append(NONE if mean is None else column.write(mean) + star)
        if mean is None or star:  # a time that was measured apart is not ranked
            score.append(None)
        else:
            score.append(column.sign * mean)
    if not has_rank:
        score = [None] * len(score)
    return row, score


def _lacking(measured: Sequence[MaterialRows]) -> list[str]:
    """A list of one note on the codecs without means, with the materials that each lacks; empty without such codecs."""
    measured_on: dict[str, list[str]] = {}
    for material in measured:
        for codec in material.codecs:
            if codec.measured and not codec.of_scene:
                measured_on.setdefault(codec.label, []).append(material.name)
    labels_by_lack: dict[tuple[str, ...], list[str]] = {}
    for label, names in measured_on.items():
        lacks = tuple(material.name for material in measured if material.name not in names)
        if lacks:
            labels_by_lack.setdefault(lacks, []).append(label)
    if not labels_by_lack:
        return []
    words = "; ".join(f"{', '.join(labels)} (not on {', '.join(lacks)})" for lacks, labels in labels_by_lack.items())
    return [f"Without means, which would be over fewer materials: {words}. --material NAME chooses."]


def _differences(
    run: Run, labels: Sequence[str], materials: Sequence[str], wanted: str
) -> tuple[list[tuple[str, str]], list[list[str]], list[Note]]:
    """Headers, cells by row and notes of the paired differences of PSNR to the row `wanted`, or to the usual one.

    On `MANY` or more materials there is a column of the mean difference with its interval, and on a single material,
    too. In between, such an interval would say little: the mean stands alone, and a column for each material has the
    difference there with its interval.
    """
    from reports.ranking import against_one, rows_of

    against = against_one(run, wanted)
    codec = against.first.partition(" ")[0]
    several = rows_of(codec, run) > 1
    alone = 1 < len(materials) < MANY  # whether each material has a column of its own
    headers = [("against", against.first if several else codec)]
    if alone:
        headers += [(f"on {name}", "dB") for name in materials]
    rows = []
    for label in labels:
        whole = against.over.get(label)
        if whole is None:
            cells = [NONE]
        elif alone:
            mark = " *" if whole.apart else ""
            cells = [signed(whole.mean) + mark]
        else:
            cells = [interval(whole)]
        if alone:
            for name in materials:
                part = against.on.get(name, {}).get(label)
                cells.append(NONE if part is None else interval(part))
        rows.append(cells)
    notes = []
    if against.over:
        text = _paired(against, first_of_several=several and not wanted, alone=alone)
        notes.append(Note((text, _is_difference)))
    return headers, rows, notes


def _is_difference(name: str) -> bool:
    """Whether a column is one of paired differences, by its name."""
    return name == "against" or name.startswith("on ")


def _paired(against: "Against", first_of_several: bool, alone: bool) -> str:
    """A note on the differences: to which row, what their intervals cover, and how many codecs are told apart.

    `first_of_several`: that row is the first of several of its codec, by default. `alone`: each material has a column.
    """
    from bench.compare.paired import FEWEST

    every = against.over.values()
    materials = max(each.materials for each in every)
    seeds = max(each.seeds for each in every)
    bootstrap = "a bootstrap over seeds and pairs" if seeds > 1 else "a bootstrap over pairs"
    which = " (its first row; --against LABEL picks another)" if first_of_several else ""
    text = f"Against {against.first}{which}: the mean paired difference of PSNR a slice in dB"
    if alone:
        text += f"; on each material with its 95 % interval, by {bootstrap}, which speaks of that material only."
    else:
        method = bootstrap if materials == 1 else "Student's t"
        text += f" and its 95 % interval, by {method}."
    if materials < FEWEST:
        return f"{text} On fewer than {FEWEST} surfaces nothing is told apart."
    count = sum(each.apart for each in every) or "None"
    return f"{text} {count} of {len(every)} told apart (*), by Holm's correction over the rows."


def _mean(column: Column, codecs: Sequence[CodecRows]) -> float | None:
    """The mean over materials of a column's means over seeds; None if a material has no number."""
    means = [column.mean(codec.measured) for codec in codecs if codec.measured]
    numbers = [mean for mean in means if mean is not None]
    if not numbers or len(numbers) < len(means):
        return None
    return fmean(numbers)
