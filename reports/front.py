"""Tables of each codec's quality at equal bytes and within budgets of bytes and time.

Each kind of table is one function from the rungs of a run (`reports.rungs`, which explains the terms) to a table of
values with its columns, which `written` makes cells of. To change a column of a table, change its `Column` here.

Times of queries are multiples of the floor. The *lead* of a line is by how many dB it is ahead of the line `AGAINST` at
equal bytes.
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from itertools import chain
from math import isnan, log2, nan
from typing import Any, NamedTuple

import pandas as pd

from bench.compare.choosing import NEAR_DB
from bench.compare.paired import AGAINST
from bench.compare.ranks import Ranks, ranks
from bench.compare.statistics import FEWEST
from bench.records import MOST_DB, Run, grouped
from reports.curves import curves_tables
from reports.notes import about_times
from reports.numbers import NONE, as_read, fixed, significant
from reports.of_rungs import (
    CODEC,
    METRICS,
    READ,
    Parts,
    common_notes,
    frame_of_leads,
    in_words,
    interval_cell,
    lead_cell,
    lead_notes,
    stale_of,
    unit_of,
    untimed_settings,
    why_absent,
    written_together,
)
from reports.rungs import BYTES, EAGER, ENOUGH, FIT, Budget, Rungs, rungs_of
from reports.table import Note, Table
from reports.values import Column, Row, written

_LEAD = {"lead", "95 % interval"}  # names of columns of the lead, which notes are about
_TIED = 3  # codecs with the same number that a cell names
_WITHIN = (
    "Within a size: read off the curve of the rungs that validation pairs choose, at its end if it ends before; "
    "without a curve, and within a time, of the rung that they choose. A codec without a rung as small or as fast on "
    f"each surface is left out. Numbers are of test pairs; a slice counts at most {MOST_DB} dB."
)
_OUTDONE = "a codec whose curves end before has more dB at a smaller size"
_CHOICE = "A codec's rung is chosen by validation pairs, its numbers are of test pairs (docs/metrics.md, “Budgets”)."


def front_table(run: Run) -> Iterator[Table]:
    """A row a line at 32 bits a texel: PSNR by kind of surface, its lead over `AGAINST`, and its time. The largest
    lead stands first."""
    rungs = rungs_of(run)
    values = _front_values(rungs)
    if values.empty:
        return
    columns = [CODEC]
    absent: dict[str, list[str]] = {}  # kinds by the line that keeps them from having a best
    outdone: list[str] = []  # kinds without a best because smaller files have more
    for kind, surfaces in rungs.kinds.items():
        leader = rungs.absent_leader(ENOUGH, surfaces)
        is_outdone = rungs.is_outdone(ENOUGH, surfaces)
        if leader:
            absent.setdefault(leader, []).append(kind)
        elif is_outdone:
            outdone.append(kind)
        name = f"{kind}, {len(surfaces)}"
        is_ranked = not (leader or is_outdone)
        columns.append(Column(name, "dB ↑", kind, ranked=is_ranked, before=("≥", f"{kind} bound")))
    columns += [
        Column("lead", "dB ↑", "median", signed=True, write=lead_cell, unranked="few"),
        Column("95 % interval", "of the lead", "median", write=interval_cell),
    ]
    title = f"At {in_words(ENOUGH)}: test PSNR, medians over {', '.join(rungs.surfaces)}"
    lead = f"Lead: over {AGAINST} at equal bytes (BD-PSNR), median over all surfaces."
    notes: list[str] = [Note((text, _LEAD.__contains__)) for text in (lead, *lead_notes(values))]
    for leader, names in absent.items():
        notes.append(f"No best is marked on {', '.join(names)} surfaces: {why_absent(leader)}.")
    if outdone:
        notes.append(f"No best is marked on {', '.join(outdone)} surfaces: {_OUTDONE}.")
    if EAGER in rungs.times:
        columns.append(Column("time", "× floor ↓", "time", -3))
        on_time = "Time: eager, of the files that PSNR is read off, median over the surfaces with times."
        notes.append(about_times(on_time))
    yield written("front", title, values, columns, [*notes, READ, *common_notes(run, rungs)])


def _front_values(rungs: Rungs) -> pd.DataFrame:
    """A row a line, the largest lead first: medians over the surfaces of each kind, leads, and time; empty without a
    line that has a value."""
    readings = {kind: rungs.readings(ENOUGH, surfaces) for kind, surfaces in rungs.kinds.items()}
    # A line whose curves all end below this size has dashes for PSNR, but may have a lead at fewer bytes.
    lines = list(dict.fromkeys([*chain.from_iterable(of_kind.index for of_kind in readings.values()), *rungs.hulls]))
    if not lines:
        return pd.DataFrame()
    values = pd.DataFrame({"codec": lines, "stale": stale_of(rungs, lines)}, index=lines)
    for kind, of_kind in readings.items():
        values[[kind, f"{kind} bound"]] = of_kind[["value", "bound"]]
    values = values.join(frame_of_leads({line: rungs.lead(line) for line in lines}))
    values["single"] = [line not in rungs.hulls for line in lines]
    values["time"] = rungs.read(ENOUGH.most, EAGER).median(axis=1)
    values["few"] = values["few"].eq(True)  # not NaN, as of lines without a lead
    values["order"] = values["median"].mask(values.index == AGAINST, 0.0)  # which has no lead over itself
    return values.sort_values(["few", "order"], ascending=[True, False], kind="stable")


def budgets_tables(run: Run) -> Iterator[Table]:
    """A row a codec, a column a budget: PSNR, median over materials. A table a kind of surface, then one over all.

    PSNR at a size is read off curves: it does not depend on where the codec has its rungs. Within a time it is that of
    the best rung in time.
    """
    rungs = rungs_of(run)
    groups = list(rungs.kinds.items())
    if len(groups) > 1:  # of a single kind, the table over all would be the same
        groups.append(("", list(rungs.surfaces)))
    made = [parts for kind, surfaces in groups if (parts := _budgets_parts(rungs, kind, surfaces))]
    if made:
        common = [READ, *common_notes(run, rungs)]
        untimed = untimed_settings(rungs)
        if untimed:
            common.append(f"Not timed, so within no time: {'; '.join(untimed)}.")
        yield from written_together("budgets", made, common)


def _budgets_parts(rungs: Rungs, kind: str, surfaces: Sequence[str]) -> Parts | None:
    """The parts of the table over surfaces of a `kind`, "" for all; None without values."""
    readings = {budget: rungs.readings(budget, surfaces) for budget in rungs.limits}
    values = _budgets_values(rungs, surfaces, readings)
    if values.empty:
        return None
    # The budgets without a mark of the best, for either reason.
    outdone = [budget for budget in readings if rungs.is_outdone(budget, surfaces)]
    leader_of = {budget: rungs.absent_leader(budget, surfaces) for budget in readings}
    with_leader = [budget for budget, leader in leader_of.items() if leader]
    shapes = {rungs.shapes[surface] for surface in surfaces}
    columns = [CODEC]
    for budget in readings:
        name = in_words(budget)
        above, below = _header(budget, shapes)
        better = "" if budget in (*outdone, *with_leader) else "↑"
        bound, apart = ("≥", f"{name} bound"), ("*", f"{name} apart")
        columns.append(Column(above, below, name, better=better, before=bound, after=apart))
    notes = []
    if values.filter(like=" apart").any(axis=None):
        notes.append(f"*: told apart from {AGAINST} in the mean, by Holm's correction over the column.")
    if outdone:
        notes.append(f"No best is marked at {', '.join(map(in_words, outdone))}: {_OUTDONE}.")
    for leader, budgets in grouped(with_leader, lambda budget: leader_of[budget]).items():
        notes.append(f"No best is marked at {', '.join(map(in_words, budgets))}: {why_absent(leader)}.")
    return Parts(_budgets_title(kind, surfaces), values, columns, notes)


def _budgets_values(rungs: Rungs, surfaces: Sequence[str], readings: Mapping[Budget, pd.DataFrame]) -> pd.DataFrame:
    """A row a line with its `readings` by budget, and whether each is a bound, or told apart; empty without lines."""
    # Lines come in the order of the best of each budget, from the smallest on.
    lines = list(dict.fromkeys(chain.from_iterable(reading.index for reading in readings.values())))
    values = pd.DataFrame({"codec": lines, "stale": stale_of(rungs, lines, surfaces)}, index=lines)
    for budget, reading in readings.items():
        name = in_words(budget)
        values[[name, f"{name} bound"]] = reading[["value", "bound"]]
        # The test compares rungs, but values at a size are read between rungs. On fewer surfaces it tells nothing.
        is_tested = budget.kind != BYTES and len(surfaces) >= FEWEST
        told_apart = rungs.told_apart(budget, surfaces) if is_tested else ()
        values[f"{name} apart"] = values.index.isin(list(told_apart))
    # The best first at a size that most codecs reach; ties by the sizes next to it, half of it as near as twice.
    sizes = [budget for budget in readings if budget.kind == BYTES]
    sizes.sort(key=lambda budget: abs(log2(budget.most / ENOUGH.most)))
    return values.sort_values([in_words(budget) for budget in sizes], ascending=False, kind="stable")


def _budgets_title(kind: str, surfaces: Sequence[str]) -> str:
    """The title of the table over surfaces of a `kind`, "" for all."""
    words = [str(len(surfaces)), kind, "surfaces" if len(surfaces) > 1 else "surface"]
    counted = " ".join(word for word in words if word)  # such as "4 measured surfaces"
    return f"Budgets on {counted} ({', '.join(surfaces)}): test PSNR, dB"


def _header(budget: Budget, shapes: set[tuple[int, int]]) -> tuple[str, str]:
    """A budget as the two lines of a header: ("8 × floor", "eager"), or ("32 bits", "a texel") of a budget of bytes.

    If all surfaces have one shape (height, width), the second line of a budget of bytes is the size of the file.
    """
    if budget.kind != BYTES:
        return f"{budget.most:g} {unit_of(budget.kind)}", budget.kind
    bits_a_texel = budget.most
    if len(shapes) > 1:
        return f"{bits_a_texel:g} bits", "a texel"
    ((height, width),) = shapes
    kilobytes = bits_a_texel * height * width / 8000  # 8 bits a byte, 1000 bytes a kilobyte
    return f"{bits_a_texel:g} bits", f"{significant(kilobytes, 2)} kB"


def rung_tables(run: Run) -> Iterator[Table]:
    """A table a material of the rungs that were chosen on it, with their budgets and quality. If there are several
    materials, the ladders of all lines come first."""
    rungs = rungs_of(run)
    notes = [_CHOICE, *common_notes(run, rungs)]
    if len(rungs.surfaces) > 1:
        yield _ladders_table(rungs)
    for material in rungs.surfaces:
        yield _chosen_table(rungs, material, notes)


def _ladders_table(rungs: Rungs) -> Table:
    """The ladders of all lines: which rungs each has on which surfaces, and their seeds."""
    columns = [CODEC, Column("on", "surfaces", "surfaces"), Column("rungs", "", "rungs", 0, ranked=False)]
    columns += [Column("bits a texel", "medians", "bits"), Column("seeds", "of each", "seeds")]
    note = "A codec has one row if it has the same rungs, with as many seeds, on each surface that it has."
    return written("rungs", "Ladders: what was measured of each codec", _ladders(rungs), columns, [note], words=2)


def _chosen_table(rungs: Rungs, material: str, notes: Sequence[str]) -> Table:
    """The rungs that some budget chooses on a material, a row each."""
    budgets_of: dict[int, list[Budget]] = {}  # by the number of a rung: the budgets that choose it
    for budget in rungs.limits:
        for rung in rungs.picks(budget, [material])[material]:
            budgets_of.setdefault(rung, []).append(budget)
    chosen = rungs.frame.loc[list(budgets_of)]
    values = chosen.assign(codec=chosen["line"])
    values["budgets"] = [_span(budgets) for budgets in budgets_of.values()]
    values["stale"] = stale_of(rungs, values["codec"], [material])
    numbers, _ = pd.factorize(values["codec"])  # of each rung that of its codec, by first appearance
    values = values.iloc[numbers.argsort(kind="stable")]  # the rungs of a codec stand together
    at_budgets = "at bits, times" if rungs.times else "at bits a texel"
    columns = [CODEC, Column("rung", "", "setting"), Column(at_budgets, "", "budgets")]
    columns += [Column("total", "bytes", "total", 0), Column("validation", "dB", "validation", 2), *METRICS]
    columns += [Column(kind, unit_of(kind), kind, -3) for kind in rungs.times]
    return written("rungs", f"{material}: the rung of each budget", values, columns, notes, words=3, material=material)


def _ladders(rungs: Rungs) -> pd.DataFrame:
    """A row for each line and each ladder that it has: on which surfaces, its rungs, their bits and their seeds."""
    rows = []
    for line, of_line in rungs.frame.groupby("line", sort=False):
        ladder_on: dict[str, tuple[tuple[str, int], ...]] = {}  # by surface: the labels with counts of seeds
        for surface, on_surface in of_line.groupby("material", sort=False):
            seeds_of_label = zip(on_surface["label"], map(len, on_surface["seeds"]), strict=True)
            ladder_on[str(surface)] = tuple(sorted(seeds_of_label))
        for ladder, surfaces in grouped(ladder_on, ladder_on.__getitem__).items():
            of_ladder = of_line[of_line["material"].isin(surfaces)]
            bits = of_ladder.groupby("label")["bits"].median().sort_values()
            seeds = dict(ladder)
            on_all = set(surfaces) == set(rungs.surfaces)
            row = {"codec": line, "surfaces": f"all {len(surfaces)}" if on_all else ", ".join(surfaces)}
            row |= {"rungs": len(ladder), "bits": ", ".join(significant(size, 2) for size in bits)}
            rows.append(row | {"seeds": ", ".join(str(seeds[label]) for label in bits.index)})
    return pd.DataFrame(rows)


def _span(limits: Sequence[Budget]) -> str:
    """Budgets in words, those of bytes as one range in bits a texel: "32–128, 8 × eager".

    `limits` are in the order of `Rungs.limits`: those of bytes first, and ascending.
    """
    bits = [f"{budget.most:g}" for budget in limits if budget.kind == BYTES]
    parts = []
    if bits:
        ends = dict.fromkeys([bits[0], bits[-1]])  # a single budget is both ends, and stands once
        parts.append("–".join(ends))
    for budget in limits:
        if budget.kind != BYTES:
            unit = "s" if budget.kind == FIT else "×"
            parts.append(f"{budget.most:g} {unit} {budget.kind}")
    return ", ".join(parts)


class _Question(NamedTuple):
    """A question of the table, with its answer."""

    words: str
    medians: "pd.Series[float]"  # over the surfaces, by line, the best first
    metric: Column  # how these are written
    absent: str = ""  # the line that would answer it if it had files as small on all surfaces; "" without one


def when_table(run: Run) -> Iterator[Table]:
    """Which codec when: a question a row, the best codec and the next best, and the numbers of both."""
    questions = list(_questions(rungs_of(run)))
    # Without medians no line reaches that budget on each surface.
    rows = [_answer(question) for question in questions if len(question.medians) and not question.absent]
    columns = [
        Column("question", "", "question"),
        Column("best", "", "best"),
        Column("then", "", "then"),
        Column("best", "", "value", write=partial(_with_unit, "value")),
        Column("then", "", "next", write=partial(_with_unit, "next")),
    ]
    notes = []
    unanswered = [question for question in questions if question.absent]
    for leader, of_leader in grouped(unanswered, lambda question: question.absent).items():
        asked = "”, “".join(question.words for question in of_leader)
        notes.append(f"No answer to “{asked}”: {why_absent(leader)}.")
    if rows:
        yield written("when", "Which codec when", pd.DataFrame(rows), columns, [*notes, _WITHIN], words=3)


def _answer(question: _Question) -> dict[str, Any]:
    """The values of the row of a question that has medians: the best and the next best lines, and both numbers."""
    number_of: dict[Any, float] = question.medians.to_dict()
    # By number as it reads: lines with the same are equally good.
    best_first = grouped(number_of, lambda line: as_read(number_of[line], question.metric.digits))
    (value, best), (next_value, then), *_ = [*best_first.items(), (nan, [NONE])]  # there may be no next best
    row: dict[str, Any] = {"question": question.words, "metric": question.metric}
    return row | {"best": _first_lines(best), "then": _first_lines(then), "value": value, "next": next_value}


def _with_unit(field: str, row: Row) -> str:
    """A number of the field as the row's metric has it, with its unit; a dash without one."""
    if isnan(row[field]):
        return NONE
    return f"{fixed(row[field], row['metric'].digits)} {row['metric'].unit}".rstrip()


def _first_lines(lines: Sequence[str]) -> str:
    """Up to `_TIED` lines by name, and how many more there are."""
    named = ", ".join(lines[:_TIED])
    more = len(lines) - _TIED
    return f"{named} and {more} more" if more > 0 else named


def _questions(rungs: Rungs) -> Iterator[_Question]:
    """The questions of the table: about each budget, the fewest bytes, each surface, and the other metrics."""
    surfaces = list(rungs.surfaces)
    if not surfaces:
        return
    psnr = Column("PSNR", "dB", "psnr", 1)
    enough = in_words(ENOUGH)
    ranked = {budget: rungs.ranked(budget, surfaces) for budget in rungs.limits}
    for budget, medians in ranked.items():
        leader = rungs.absent_leader(budget, surfaces, to_end=True)
        yield _Question(f"best quality in {in_words(budget)}", medians, psnr, leader)
    of_bytes = {budget: medians for budget, medians in ranked.items() if budget.kind == BYTES}
    best = max((medians.max() for medians in of_bytes.values() if len(medians)), default=0.0)
    for budget, medians in of_bytes.items():  # the smallest first
        near = medians[medians >= best - NEAR_DB]
        if len(near) and not rungs.absent_leader(budget, surfaces, to_end=True):
            yield _Question(f"fewest bytes within {NEAR_DB:g} dB of the best: {in_words(budget)}", near, psnr)
            break
    if len(surfaces) > 1:  # on one surface this was asked above
        for material in surfaces:
            yield _Question(f"best on {material} in {enough}", rungs.ranked(ENOUGH, [material]), psnr)
    absent = rungs.absent_leader(ENOUGH, surfaces, to_end=True)
    for metric in METRICS[1:]:
        ranking = rungs.ranked(ENOUGH, surfaces, metric.field)
        yield _Question(f"best {metric.name} in {enough}", ranking, metric, absent)


def mean_ranks(rungs: Rungs) -> Ranks | None:
    """The mean ranks of lines within `ENOUGH`; None for fewer than two lines, or fewer than three surfaces."""
    if not rungs.surfaces:
        return None
    reached = rungs.reached(ENOUGH, list(rungs.surfaces))
    return ranks(dict(zip(reached.index, reached.to_numpy().tolist(), strict=True)))


def ranks_table(run: Run) -> Iterator[Table]:
    """The mean rank of each line at a budget, and the lines that are not told apart from it."""
    rungs = rungs_of(run)
    ranking = mean_ranks(rungs)
    if not ranking:  # too few lines or surfaces to rank
        return
    rows = []
    for line, rank in ranking.mean.items():
        others = [(other, other_rank) for other, other_rank in ranking.mean.items() if other != line]
        near = [other for other, other_rank in others if abs(other_rank - rank) < ranking.critical]
        rows.append({"codec": line, "rank": rank, "near": ", ".join(near) or NONE})
    values = pd.DataFrame(rows)
    values["stale"] = stale_of(rungs, values["codec"])
    # Nothing is marked: ranks are read by their critical difference.
    columns = [CODEC, Column("mean rank", "↓", "rank", 2, ranked=False), Column("not told apart from", "", "near")]
    title = f"Mean ranks over {len(rungs.surfaces)} surfaces at {in_words(ENOUGH)}"
    note = f"Nemenyi's critical difference: {ranking.critical:.2f}."
    yield written("ranks", title, values, columns, [note, _WITHIN])


# By kind of table: the function that makes the tables of a run.
TABLES = {
    "front": front_table,
    "budgets": budgets_tables,
    "when": when_table,
    "rungs": rung_tables,
    "ranks": ranks_table,
    "curves": curves_tables,
}
