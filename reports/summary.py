"""The summary of a run over its materials: the standing of each codec, best bold, second underlined.

A *codec* is here one with its settings; it has one row. Its *standing* is its place by PSNR among the codecs: the mean
of its *ranks* on the materials, and the number that it *won*, on which none is better. Only a codec that was measured
on all materials has a rank; a model of a scene has none. The codecs are *set against* one row by paired differences:
the mean over slices of its PSNR minus that row's, in dB.
"""

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from math import inf, nan
from typing import TYPE_CHECKING, Any, NamedTuple

import pandas as pd

from bench.records import Run
from reports.by_material import Measure, in_summary, rows_of
from reports.notes import (
    about_times,
    dark_notes,
    height_notes,
    lacking_notes,
    left_out_notes,
    missing_note,
    one_texel_notes,
    recipe_notes,
    scene_notes,
)
from reports.numbers import NONE, interval
from reports.ranking import against_one, ranked, with_rank
from reports.rows import MaterialRows
from reports.table import Apart, Note, OfData, Table
from reports.values import Column, Row, written

if TYPE_CHECKING:
    from bench.compare.paired import Against, Interval

_INTERVAL = "{}, with its interval"  # the column of values with the interval of a difference
MANY = 10  # materials from which the interval of their mean is shown; on fewer, Student's is too wide to say anything


def summary_table(
    run: Run, materials: Sequence[MaterialRows], intervals: bool = True, against: str = "", stale: bool = True
) -> Table | None:
    """A row a codec; None if fewer than two codecs were measured. Without `intervals` no slice is read.

    A codec that lacks a material has no means, because they would not be over the materials of the other rows. A model
    of a scene has none either, because it answers for its scene alone. With `intervals`, the codecs are set `against`
    one row; see `reports.ranking.against_one`, which raises `InputError`. `against` is "" for the usual row. With
    `stale`, rows of older versions are marked.
    """
    measured = [material for material in materials if material.measured]
    ranking = ranked(materials)
    if len(ranking) < 2:
        return None
    codecs = with_rank(materials, ranking)
    names = [material.name for material in measured]
    differences = _Differences([], [], [])
    if intervals:
        to_one = against_one(run, materials, codecs, against)
        differences = _differences(to_one, ranking.index, names, codecs, against)
    measures, means_of = _means(measured)
    means = [
        Column("mean rank", "↓", "rank"),
        Column("won", "↑", "won", 0),
        Column("PSNR", "dB ↑", "psnr", 2),
    ]
    for measure in measures:
        column = Column(measure.name, measure.unit, measure.name, measure.digits)
        if measure.timed:  # a time that was measured apart from the others gets a star and is not ranked
            column = column._replace(after=("*", "timed apart"), unranked="timed apart")
        means.append(column)
    columns = [
        Column("codec", "", "codec"),
        Column("materials", "", "materials", write=lambda row: f"{row['materials']:.0f} of {len(measured)}"),
        *means,
        *differences.columns,  # to the right, and never marked
    ]
    values = ranking.join(means_of)
    fields = [column.field for column in means]
    values[fields] = values[fields].where(values["rank"].notna())
    values["stale"] &= stale
    values = values.reset_index(names="codec").join(pd.DataFrame(differences.rows, dtype=object))
    notes = _all_notes(run, materials, measured, differences.notes)
    title = f"Summary over {len(names)} material{'s' if len(names) > 1 else ''}: {', '.join(names)}"
    return written("summary", title, values, columns, notes)


def _all_notes(
    run: Run, materials: Sequence[MaterialRows], measured: Sequence[MaterialRows], on_differences: Sequence[Note]
) -> list[str]:
    """The notes: on what the rows are means of, on special materials and codecs, on times, and on what is left out."""
    notes: list[str] = ["Means over seeds, then over materials. Rows are sorted by mean rank, then by PSNR."]
    for of_codecs in (dark_notes, recipe_notes, scene_notes, lacking_notes):
        notes += of_codecs(measured)
    notes += on_differences
    # Only a time that may be compared needs notes on times.
    timed = [row for material in measured for row in material.measured if not row.timing_obstacle]
    notes += [about_times(text) for text in (*one_texel_notes(timed), *height_notes(measured))]
    notes += left_out_notes(run, materials)
    missing = missing_note(run)
    if missing:
        notes.append(Apart(missing))
    return notes


def _means(measured: Sequence[MaterialRows]) -> tuple[list[Measure], pd.DataFrame]:
    """The columns after that of PSNR; and by label of a codec its means over its materials, by name of column, with
    whether it is `stale` and `timed apart` on any.

    A mean is infinite if no slice of any material has an error, and NaN if a material has no number.
    """
    measures: dict[str, Measure] = {}  # by name: two variants of a metric are one column
    as_stated = []  # a frame for each material, with a row for each codec: infinite where no slice has an error
    as_counted = []  # the same, but such slices count as a number, such as 48.13 dB
    for material in measured:
        of_material = {measure.name: measure for measure in in_summary(material)}
        measures |= of_material
        stating = list(of_material.values())
        counting = [measure._replace(stated=False) for measure in stating]
        names = {measure.field: measure.name for measure in stating}
        codecs = [codec for codec in material.codecs if codec.measured]
        as_stated.append(pd.DataFrame(rows_of(codecs, stating), dtype=object).rename(columns=names))
        as_counted.append(pd.DataFrame(rows_of(codecs, counting), dtype=object).rename(columns=names))
    stated = pd.concat(as_stated).set_index("codec")
    counted = pd.concat(as_counted).set_index("codec")
    shown = []
    for measure in sorted(measures.values(), key=lambda measure: not measure.stated):  # metrics before costs
        if not measure.sparse or stated[measure.name].notna().any():
            shown.append(measure)
    names_shown = [measure.name for measure in shown]
    means = counted[names_shown].astype(float).groupby("codec").agg(pd.Series.mean, skipna=False)
    all_exact = (stated[names_shown] == inf).groupby("codec").all()
    return shown, means.mask(all_exact, inf).join(stated[["stale", "timed apart"]].groupby("codec").any())


class _Differences(NamedTuple):
    """The columns of paired differences of PSNR, which are added to the right of the summary."""

    columns: list[Column]
    rows: list[dict[str, Any]]  # their values by field, in the order of the rows of the summary
    notes: list[Note]


def _differences(
    against: "Against", labels: Iterable[str], materials: Sequence[str], codecs: Mapping[str, str], wanted: str
) -> _Differences:
    """The paired differences of PSNR of the rows with these labels to one row: `wanted`, "" for the usual one.

    On `MANY` or more materials there is one column: the mean difference with its interval. So it is on a single
    material. In between, such an interval would say little: the column has the mean difference alone, and a further
    column for each material has the difference there with its interval. `codecs` has those with a rank, by label.
    """
    codec = codecs.get(against.first, "")  # there is none if no codec has a rank
    several = [*codecs.values()].count(codec) > 1
    column_for_each = 1 < len(materials) < MANY  # whether each material has a column of its own
    of_columns = {"against": against.over}
    unit = OfData(against.first if several else codec)
    columns = [Column("against", unit, "against", write=partial(_with_interval, "against"))]
    if column_for_each:
        columns = [Column("against", unit, "against", 2, signed=True, after=(" *", "told apart"))]
        for number, name in enumerate(materials):
            field = f"on {number}"
            of_columns[field] = against.on.get(name, {})
            columns.append(Column(OfData(f"on {name}"), "dB", field, write=partial(_with_interval, field)))
    rows = []
    for label in labels:
        row: dict[str, Any] = {}
        for field, differences in of_columns.items():
            difference = differences.get(label)  # none to itself, nor where it cannot be compared
            row[field] = difference.mean if difference else nan
            row[_INTERVAL.format(field)] = difference
        row["told apart"] = label in against.over and against.over[label].apart
        rows.append(row)
    notes = []
    if against.over:
        text = _text_on_differences(against, several and not wanted, column_for_each)
        notes.append(Note((text, _is_difference)))
    return _Differences(columns, rows, notes)


def _with_interval(field: str, row: Row) -> str:
    """The cell of a difference with its interval."""
    difference: Interval | None = row[_INTERVAL.format(field)]
    return interval(difference) if difference else NONE


def _is_difference(name: str) -> bool:
    """Whether a column is one of paired differences, by its name."""
    return name == "against" or name.startswith("on ")


def _text_on_differences(against: "Against", first_of_several: bool, column_for_each: bool) -> str:
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
