"""The summary of a run over its materials: the standing of each codec, best bold, second underlined."""

from collections.abc import Sequence
from statistics import fmean
from typing import TYPE_CHECKING

from bench.records import MOST_DB, Run
from reports import columns
from reports.columns import Column
from reports.notes import about_times, height_notes, left_out_notes, missing_note, one_texel_notes
from reports.numbers import EXACT, NONE, fixed, integer, interval
from reports.rows import CodecRows, materials
from reports.table import Note, Table, best_cells

if TYPE_CHECKING:
    from bench.compare.paired import Against


def summary_table(run: Run, intervals: bool = True) -> Table | None:
    """A row a codec; None if fewer than two codecs were measured. Without `intervals` no slice is read."""
    from reports.ranking import against_one, ranked  # loads NumPy, which a table of one material does not need

    measured = [material for material in materials(run) if material.measured]
    ranking = ranked(run)
    if len(ranking) < 2:
        return None
    chosen = columns.summary(measured)
    headers = [("codec", ""), ("materials", ""), ("mean rank", "↓"), ("won", "↑"), ("PSNR", "dB ↑")]
    headers += [(column.name, column.unit) for column in chosen]
    rows: list[list[str]] = []
    scores: list[list[float | None]] = []
    for each in ranking:
        codecs = [codec for material in measured for codec in material.codecs if codec.label == each.label]
        means = [_mean(column, codecs) for column in chosen]
        stars = [column.star([row for codec in codecs for row in codec.measured]) for column in chosen]
        psnr = EXACT if each.psnr >= MOST_DB else fixed(each.psnr, 2)
        row = [each.label, f"{each.materials} of {len(measured)}", fixed(each.rank, 1), integer(each.wins), psnr]
        score = [None, None, None if each.rank is None else -each.rank, each.wins, each.psnr]
        for column, mean, star in zip(chosen, means, stars, strict=True):
            row.append(NONE if mean is None else column.write(mean) + star)
            score.append(None if mean is None or star else column.sign * mean)  # a star is not ranked
        rows.append(row)
        scores.append([None] * len(score) if each.rank is None else score)  # nor is a codec without a rank
    notes: list[str] = ["Means over seeds, then over materials: docs/metrics.md, “Tables”."]
    if intervals:
        against = against_one(run)
        headers.append(("against", against.first.partition(" ")[0]))
        rows = [[*row, interval(against.over[row[0]]) if row[0] in against.over else NONE] for row in rows]
        notes += [Note((_paired(against), "against".__eq__))] if against.over else []
    timed = [row for material in measured for row in material.measured if not row.timing_obstacle]
    notes += map(about_times, [*one_texel_notes(timed), *height_notes(measured)])
    notes += [*left_out_notes(run), *filter(None, [missing_note(run)])]
    names = ", ".join(material.name for material in measured)
    title = f"Summary over {len(measured)} material{'s' * (len(measured) > 1)}: {names}"
    return Table("summary", title, headers, rows, notes, marks=best_cells(rows, scores))


def _paired(against: "Against") -> str:
    """A note on the differences: what their intervals cover, and how many codecs are told apart."""
    from bench.compare.paired import FEWEST

    every = against.over.values()
    materials, seeds = (max(getattr(each, name) for each in every) for name in ("materials", "seeds"))
    by = "Student's t" if materials > 1 else f"a bootstrap over {'seeds and ' * (seeds > 1)}pairs"
    count = sum(each.apart for each in every) or "None"
    told = f"{count} of {len(every)} told apart (*), by Holm's correction over the rows."
    few = f"On fewer than {FEWEST} surfaces nothing is told apart."
    start = f"Against {against.first}: the mean paired difference of PSNR a slice in dB and its 95 % interval, by {by}."
    return f"{start} {told if materials >= FEWEST else few}"


def _mean(column: Column, codecs: Sequence[CodecRows]) -> float | None:
    """The mean over materials of a column's means over seeds; None if a material has no number."""
    means = [column.mean(codec.measured) for codec in codecs if codec.measured]
    numbers = [mean for mean in means if mean is not None]
    return fmean(numbers) if numbers and len(numbers) == len(means) else None
