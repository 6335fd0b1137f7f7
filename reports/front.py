"""Tables of each codec's quality within budgets of bytes and time, and of its curves of quality over bytes.

Each kind of table is one function from the rungs of a run (`reports.rungs`, which explains the terms) to a table of
values with its columns, which `written` makes cells of. To change a column of a table, change its `Column` here.

Times of queries are multiples of the floor. The *lead* of a line is by how many dB it is ahead of the line `AGAINST` at
equal bytes; two lines are *told apart* if chance hardly explains the gap.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from math import isinf, isnan, log2, nan
from statistics import median
from typing import Any, NamedTuple

import pandas as pd

from bench.compare.choosing import NEAR_DB
from bench.compare.paired import AGAINST
from bench.compare.ranks import Ranks, ranks
from bench.compare.statistics import FEWEST, bd_rate
from bench.records import MOST_DB, Job, Machine, Run, shown_label
from reports.notes import beside
from reports.numbers import NONE, fixed, signed, significant
from reports.rungs import (
    BYTES,
    EAGER,
    ENOUGH,
    FIT,
    FOOTPRINTS,
    LEAST_RUNGS,
    LEAST_SURFACES,
    Budget,
    Rungs,
    Summary,
    median_over,
    rungs_of,
)
from reports.table import Table
from reports.values import Column, Row, written

_NAMED = 5  # rows that a note on excluded records names
MEMORY = 256  # bits a texel of a decoder in memory, at which codecs are compared
_TIED = 3  # codecs with the same number that a cell names
_NEVER = "∞"  # a BD-rate: no number of bytes is enough
_METRICS = [Column("PSNR", "dB", "psnr", 2), Column("SSIM", "", "ssim", 3), Column("FLIP", "", "flip", 3)]
_Parts = tuple[str, pd.DataFrame, list[Column], list[str]]  # title, values, columns and notes of a table
_CODEC = Column("codec", "", "codec")
_CAP = f"A slice counts at most {MOST_DB} dB, an error of one step of an 8-bit display."
_READ = (
    f"At a size: read off the curve of the rungs that validation pairs choose, test pairs (docs/metrics.md, “Curves”). "
    f"{NONE}: a curve does not reach that size on each surface. ≥: fewer than three rungs, the best within that size. "
    f"A slice counts at most {MOST_DB} dB, an error of one step of an 8-bit display."
)
_WITHIN = (
    "Within a size: read off the curve of the rungs that validation pairs choose, at its end if it ends before; "
    "without a curve, and within a time, of the rung that they choose. A codec without a rung as small or as fast on "
    f"each surface is left out. Numbers are of test pairs; a slice counts at most {MOST_DB} dB."
)
_CHOICE = "A codec's rung is chosen by validation pairs, its numbers are of test pairs (docs/metrics.md, “Budgets”)."


def front_table(run: Run) -> Iterator[Table]:
    """A row a line at 32 bits a texel: PSNR by kind of surface, its lead over `AGAINST`, and its time. The largest
    lead stands first."""
    rungs = rungs_of(run)
    kinds = rungs.kinds
    readings = {kind: rungs.readings(ENOUGH, surfaces) for kind, surfaces in kinds.items() if surfaces}
    lines = list(dict.fromkeys(line for found in readings.values() for line in found.index))
    if not lines:
        return
    # A line whose curves all end below this size has dashes for PSNR, but may have a lead at fewer bytes.
    lines += [line for line in rungs.hulls if line not in lines]
    values = pd.DataFrame({"codec": lines, "stale": _stale(rungs, lines)}, index=lines)
    for kind, found in readings.items():
        values[kind] = found["value"]
        values[f"{kind} bound"] = found["bound"]
    values["pooled"] = median_over(rungs.read(ENOUGH.most, "pooled"))
    leads = {line: rungs.lead(line) for line in lines}
    values = values.join(_of_leads(leads))
    values["single"] = [line not in rungs.hulls for line in lines]
    values["time"] = rungs.read(ENOUGH.most, EAGER).median(axis=1)  # of those timed
    against = values.index == AGAINST  # which has no lead over itself
    values = values.assign(order=values["median"].mask(against, 0.0)).sort_values(
        "order", ascending=False, kind="stable"
    )
    columns = [_CODEC]
    absent: dict[str, list[str]] = {}  # kinds by the line that keeps them from having a best
    for kind, surfaces in kinds.items():
        leader = rungs.absent_leader(ENOUGH, surfaces)
        if leader:
            absent.setdefault(leader, []).append(kind)
        better = "none" if leader else ""
        name = f"{kind}, {len(surfaces)}"
        columns.append(Column(name, "dB ↑", kind, better=better, before=("≥", f"{kind} bound")))
    columns += [
        Column("pooled", "dB ↑", "pooled"),
        Column("lead", "dB ↑", "median", signed=True, write=_lead),
        Column("95 % interval", "of the lead", "median", write=_interval),
        Column("ahead", "on", "won", write=_won),
        Column("time", "× floor ↓", "time", -3),
    ]
    title = f"At {in_words(ENOUGH)}: test PSNR, medians over {', '.join(rungs.surfaces)}"
    notes = ["Pooled: of the squared error of all slices of a surface together, median over all surfaces."]
    notes += [f"Lead: over {AGAINST} at equal bytes (BD-PSNR), median over all surfaces.", *_lead_notes(values)]
    for leader, names in absent.items():
        notes.append(f"No best is marked on {', '.join(names)} surfaces: {_absent(leader)}.")
    if EAGER in rungs.times:
        notes.append("Time: eager, of the files between which PSNR is read off, in the same shares; a median, too.")
    yield written("front", title, values, columns, [*notes, _READ, *_common(run, rungs)])


def _of_leads(leads: Mapping[str, Summary | None]) -> pd.DataFrame:
    """The fields of leads, and whether they are told apart, by line; lines without a lead are left out."""
    rows = {line: {**lead._asdict(), "apart": lead.apart} for line, lead in leads.items() if lead}
    return pd.DataFrame.from_dict(rows, orient="index", columns=[*Summary._fields, "apart"])


def _lead(row: Row) -> str:
    """The lead, with a ° if it comes from single rungs."""
    if isnan(row["median"]):
        # `AGAINST` has no lead over itself; any other line shares no bytes with it.
        return "" if row["codec"] == AGAINST else NONE
    return signed(row["median"], 1) + "°" * row["single"]


def _interval(row: Row) -> str:
    """The interval of a lead, with a star if it tells the two apart; "" without a lead."""
    if isnan(row["median"]):
        return ""
    return f"{signed(row['low'], 1)} to {signed(row['high'], 1)}{'*' * row['apart']}"


def _won(row: Row) -> str:
    """On how many surfaces a line is ahead, and of how many; "" without a lead."""
    return "" if isnan(row["median"]) else f"{row['won']:.0f} of {row['surfaces']:.0f}"


def _lead_notes(values: pd.DataFrame) -> Iterator[str]:
    """Notes on the marks beside leads: what ° and * mean, or why no lead is told apart."""
    leads = values[values["median"].notna()]
    if leads["single"].any():
        yield "°: of fewer than three rungs, each at its own bytes."
    if leads["apart"].astype(bool).any():
        yield "*: told apart: the interval leaves out 0."
    elif len(leads):
        few = leads["surfaces"].max() < LEAST_SURFACES
        yield f"None is told apart: that takes {LEAST_SURFACES} surfaces." if few else "None is told apart."


def budgets_tables(run: Run) -> Iterator[Table]:
    """A row a codec, a column a budget: PSNR, median over materials. A table a kind of surface, then one over all.

    PSNR at a size is read off curves: it does not depend on where the codec has its rungs. Within a time it is that of
    the best rung in time.
    """
    rungs = rungs_of(run)
    groups = list(rungs.kinds.items())
    if len(groups) > 1:  # of a single kind, the table over all would be the same
        groups.append(("", list(rungs.surfaces)))
    made = [found for kind, surfaces in groups if (found := _of_surfaces(rungs, kind, surfaces))]
    if made:  # notes common to them stand once, below the last
        notes = made[-1][-1]
        notes += [_READ, *_common(run, rungs)]
        untimed = _untimed(rungs)
        if untimed:
            notes.append(f"Not timed, so within no time: {'; '.join(untimed)}.")
    for title, values, columns, notes in made:
        yield written("budgets", title, values, columns, notes)


def _of_surfaces(
    rungs: Rungs, kind: str, surfaces: Sequence[str]
) -> tuple[str, pd.DataFrame, list[Column], list[str]] | None:
    """Title, values, columns and notes of the table over surfaces of a `kind`, "" for all; None without values."""
    # By budget and line; lines come in the order of the best of each budget, from the smallest on.
    readings = {budget: rungs.readings(budget, surfaces) for budget in rungs.limits}
    lines = list(dict.fromkeys(line for found in readings.values() for line in found.index))
    if not lines:
        return None
    values = pd.DataFrame({"codec": lines, "stale": _stale(rungs, lines, surfaces)}, index=lines)
    columns = [_CODEC]
    shapes = {rungs.shapes[name] for name in surfaces}
    best_so_far = 0.0
    outdone = False
    absent: dict[str, list[str]] = {}  # sizes by the line that keeps them from having a best
    for budget, found in readings.items():
        name = in_words(budget)
        values[name], values[f"{name} bound"] = found["value"], found["bound"]
        # The test compares rungs, but values at a size are read between rungs. On fewer surfaces it tells nothing.
        tested = budget.kind != BYTES and len(surfaces) >= FEWEST
        values[f"{name} apart"] = values.index.isin(list(rungs.told_apart(budget, surfaces)) if tested else [])
        better = "↑"
        if budget.kind == BYTES and len(found):  # to mark a best that is worse than one at a smaller size would mislead
            best = found["value"].max()
            if best < best_so_far:
                outdone, better = True, ""
            best_so_far = max(best, best_so_far)
        leader = rungs.absent_leader(budget, surfaces)
        if leader:
            absent.setdefault(leader, []).append(name)
            better = ""
        above, below = _header(budget, shapes)
        marks = ("≥", f"{name} bound"), ("*", f"{name} apart")
        columns.append(Column(above, below, name, better=better, before=marks[0], after=marks[1]))
    # The best first at a size that most codecs reach; ties by the sizes next to it, half of it as near as twice.
    sizes = [budget for budget in readings if budget.kind == BYTES]
    sizes.sort(key=lambda budget: abs(log2(budget.most / ENOUGH.most)))
    values = values.sort_values([in_words(budget) for budget in sizes], ascending=False, kind="stable")

    words = [str(len(surfaces)), kind, "surfaces" if len(surfaces) > 1 else "surface"]
    counted = " ".join(word for word in words if word)  # such as "4 fabric surfaces"
    title = f"Budgets on {counted} ({', '.join(surfaces)}): test PSNR, dB"
    notes = []
    if values.filter(like=" apart").any(axis=None):
        notes.append(f"*: told apart from {AGAINST}, by Holm's correction over the column.")
    if outdone:
        notes.append("No best is marked at a size where a codec whose curves end before has more dB at a smaller one.")
    for leader, names in absent.items():
        notes.append(f"No best is marked at {', '.join(names)}: {_absent(leader)}.")
    return title, values, columns, notes


def _absent(leader: str) -> str:
    """Why no line is marked as the best where `leader` has a value on some surfaces alone."""
    return f"{leader} leads on the surfaces where its curve reaches that size"


def _header(budget: Budget, shapes: set[tuple[int, int]]) -> tuple[str, str]:
    """A budget as the two lines of a header: ("8 × floor", "eager"), or ("32 bits", "a texel") of a budget of bytes.

    If all surfaces have one shape (height, width), the second line of a budget of bytes is the size of the file.
    """
    if budget.kind != BYTES:
        return f"{budget.most:g} {_unit(budget.kind)}", budget.kind
    bits_a_texel = budget.most
    if len(shapes) > 1:
        return f"{bits_a_texel:g} bits", "a texel"
    ((height, width),) = shapes
    kilobytes = bits_a_texel * height * width / 8000  # 8 bits a byte, 1000 bytes a kilobyte
    return f"{bits_a_texel:g} bits", f"{significant(kilobytes, 2)} kB"


def rung_tables(run: Run) -> Iterator[Table]:
    """A table a material of the rungs that were chosen on it, with their budgets and quality. If there are several
    materials, the ladders of all lines and the medians over the materials come first."""
    rungs = rungs_of(run)
    surfaces = list(rungs.surfaces)
    if len(surfaces) > 1:
        columns = [_CODEC, Column("on", "surfaces", "surfaces"), Column("rungs", "", "rungs", 0, better="none")]
        columns += [Column("bits a texel", "medians", "bits"), Column("seeds", "of each", "seeds")]
        note = "A codec has one row if it has the same rungs, with as many seeds, on each surface that it has."
        yield written("rungs", "Ladders: what was measured of each codec", _ladders(rungs), columns, [note], words=2)
    at_budgets = Column("at bits, times" if rungs.times else "at bits a texel", "", "budgets")
    total = Column("total", "bytes", "total", 0)
    notes = [_CHOICE, *_common(run, rungs)]
    medians = [total, *_METRICS]
    rows = list(_median_rows(rungs, medians)) if len(surfaces) > 1 else []
    if rows:
        values = pd.DataFrame(rows)
        values["stale"] = _stale(rungs, values["codec"])
        title = f"Medians over {len(surfaces)} materials of the rung of each budget"
        yield written("rungs", title, values, [_CODEC, at_budgets, *medians], notes, words=2)
    columns = [_CODEC, Column("rung", "", "setting"), at_budgets, total, Column("validation", "dB", "validation", 2)]
    columns += [*_METRICS, *(Column(kind, _unit(kind), kind, -3) for kind in rungs.times)]
    for material in surfaces:
        picked: dict[str, dict[int, list[Budget]]] = {}  # by line and number of a rung: the budgets that choose it
        for budget in rungs.limits:
            best: dict[Any, int] = rungs.picks(budget, [material])[material].to_dict()
            for line, rung in best.items():
                picked.setdefault(line, {}).setdefault(rung, []).append(budget)
        chosen = {rung: _span(limits) for of_line in picked.values() for rung, limits in of_line.items()}
        values = rungs.frame.loc[list(chosen)].assign(codec=lambda rung: rung["line"])
        values["budgets"] = list(chosen.values())
        values["stale"] = _stale(rungs, values["codec"], [material])
        title = f"{material}: the rung of each budget"
        yield written("rungs", title, values, columns, notes, words=3, material=material)


def _ladders(rungs: Rungs) -> pd.DataFrame:
    """A row for each line and each ladder that it has: on which surfaces, its rungs, their bits and their seeds."""
    rows = []
    for line, of_line in rungs.frame.groupby("line", sort=False):
        surfaces_of: dict[tuple[tuple[str, int], ...], list[str]] = {}  # by ladder: its labels with counts of seeds
        for surface, own in of_line.groupby("material", sort=False):
            ladder = tuple(sorted(zip(own["label"], map(len, own["seeds"]), strict=True)))
            surfaces_of.setdefault(ladder, []).append(str(surface))
        for ladder, surfaces in surfaces_of.items():
            own = of_line[of_line["material"].isin(surfaces)]
            bits = own.groupby("label")["bits"].median().sort_values()
            seeds = dict(ladder)
            all_of_them = len(surfaces) == len(rungs.surfaces)
            row = {"codec": line, "surfaces": f"all {len(surfaces)}" if all_of_them else ", ".join(surfaces)}
            row |= {"rungs": len(ladder), "bits": ", ".join(significant(size, 2) for size in bits)}
            rows.append(row | {"seeds": ", ".join(str(seeds[label]) for label in bits.index)})
    return pd.DataFrame(rows)


def _median_rows(rungs: Rungs, columns: Sequence[Column]) -> Iterator[Row]:
    """Rows of the table of medians over the materials: line, budgets, and a median for each column.

    Budgets at which a line has the same numbers share a row, because mostly the same rungs were chosen.
    """
    # By line, and by the numbers as they read: the medians, and the budgets that have them.
    found: dict[str, dict[tuple[float | None, ...], tuple[Row, list[Budget]]]] = {}
    for budget in rungs.limits:
        picks = rungs.picks(budget, list(rungs.surfaces))
        medians = pd.DataFrame({column.field: median_over(rungs.of_picks(picks, column.field)) for column in columns})
        by_line: Any = medians.to_dict("index")
        for line, row in by_line.items():
            read = tuple(None if isnan(row[column.field]) else column.rounded(row[column.field]) for column in columns)
            found.setdefault(line, {}).setdefault(read, (row, []))[1].append(budget)
    for line, of_line in found.items():
        for row, limits in of_line.values():
            yield {**row, "codec": line, "budgets": _span(limits)}


def _span(limits: list[Budget]) -> str:
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


def when_table(run: Run) -> Iterator[Table]:
    """Which codec when: a question a row, the best codec and the next best, and the numbers of both."""
    rows = []
    absent: dict[str, list[str]] = {}  # sizes by the line that keeps them from having a best
    for question, medians, metric, leader in _questions(rungs_of(run)):
        if leader:
            absent.setdefault(leader, []).append(question)
            continue
        lines: dict[float, list[str]] = {}  # by number as it reads: lines with the same are equally good
        by_line: dict[Any, float] = medians.to_dict()
        for line, value in by_line.items():
            lines.setdefault(metric.rounded(value), []).append(line)
        if not lines:  # no line reaches that budget on each surface
            continue
        first, second, *_ = [*lines.items(), (nan, [NONE])]  # there may be no next best
        row: dict[str, Any] = {"question": question, "metric": metric}
        row |= {"best": _named(first[1]), "then": _named(second[1]), "value": first[0], "next": second[0]}
        rows.append(row)
    columns = [Column("question", "", "question"), Column("best", "", "best"), Column("then", "", "then")]
    columns += [
        Column(name, "", field, write=_with_unit(field)) for name, field in (("best", "value"), ("then", "next"))
    ]
    notes = [f"No answer to “{'”, “'.join(asked)}”: {_absent(leader)}." for leader, asked in absent.items()]
    if rows:
        yield written("when", "Which codec when", pd.DataFrame(rows), columns, [*notes, _WITHIN], words=3)


def _with_unit(field: str) -> Callable[[Row], str]:
    """A function that writes a number of the field as the row's metric does, with its unit."""

    def write(row: Row) -> str:
        """The number of a row; a dash without one."""
        if isnan(row[field]):
            return NONE
        return f"{fixed(row[field], row['metric'].digits)} {row['metric'].unit}".rstrip()

    return write


def _named(lines: Sequence[str]) -> str:
    """Up to `_TIED` lines by name, and how many more there are."""
    named = ", ".join(lines[:_TIED])
    more = len(lines) - _TIED
    return f"{named} and {more} more" if more > 0 else named


class _Question(NamedTuple):
    """A question in words, the lines that answer it with their medians, the best first, and how these are written; and
    the line, if there is one, that would answer it if it had files as small on all surfaces."""

    words: str
    medians: "pd.Series[float]"
    metric: Column
    absent_leader: str = ""


def _questions(rungs: Rungs) -> Iterator[_Question]:
    """The questions of the table: about each budget, the fewest bytes, each surface, and the other metrics."""
    surfaces = list(rungs.surfaces)
    psnr, *others = [Column("PSNR", "dB", "psnr", 1), *_METRICS[1:]]
    enough = in_words(ENOUGH)
    ranked = {budget: rungs.ranked(budget, surfaces) for budget in rungs.limits} if surfaces else {}
    for budget, medians in ranked.items():
        leader = rungs.absent_leader(budget, surfaces, to_end=True)
        yield _Question(f"best quality in {in_words(budget)}", medians, psnr, leader)
    of_bytes = {budget: medians for budget, medians in ranked.items() if budget.kind == BYTES}
    best = max((medians.max() for medians in of_bytes.values() if len(medians)), default=0.0)
    for budget, medians in of_bytes.items():  # the smallest first
        near = medians[medians >= best - NEAR_DB]
        if len(near):
            yield _Question(f"fewest bytes within {NEAR_DB:g} dB of the best: {in_words(budget)}", near, psnr)
            break
    if len(surfaces) > 1:  # on one surface this was asked above
        for material in surfaces:
            yield _Question(f"best on {material} in {enough}", rungs.ranked(ENOUGH, [material]), psnr)
    for metric in others if surfaces else []:
        yield _Question(f"best {metric.name} in {enough}", rungs.ranked(ENOUGH, surfaces, metric.field), metric)


def mean_ranks(rungs: Rungs) -> Ranks | None:
    """The mean ranks of lines within `ENOUGH`; None for fewer than two lines or three surfaces."""
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
        near = [other for other, its in ranking.mean.items() if other != line and abs(its - rank) < ranking.critical]
        rows.append({"codec": line, "rank": rank, "near": ", ".join(near) or NONE})
    values = pd.DataFrame(rows)
    values["stale"] = _stale(rungs, values["codec"])
    # Nothing is marked: ranks are read by their critical difference.
    columns = [_CODEC, Column("mean rank", "↓", "rank", 2, better="none"), Column("not told apart from", "", "near")]
    title = f"Mean ranks over {len(rungs.surfaces)} surfaces at {in_words(ENOUGH)}"
    note = f"Nemenyi's critical difference: {ranking.critical:.2f}."
    yield written("ranks", title, values, columns, [note, _WITHIN])


def curves_tables(run: Run) -> Iterator[Table]:
    """The tables of curves: differences to `AGAINST`, three metrics and PSNR by footprint at one size, bytes in memory.

    PSNR at several sizes stands in `table budgets`.
    """
    rungs = rungs_of(run)
    made = []
    if AGAINST in rungs.hulls:
        made.append(_differences(rungs))
    made += [_three_metrics(rungs), _footprints(rungs), _in_memory(rungs)]
    with_rows = [found for found in made if len(found[1])]
    if with_rows:  # notes on all of them stand once, below the last
        notes = with_rows[-1][-1]
        reach = (
            f"{NONE}: a curve does not reach that size on each surface, or has fewer than {LEAST_RUNGS} rungs there."
        )
        notes.append(
            f"Read off the hull of rungs that validation pairs leave (docs/metrics.md, “Curves”). {reach} {_CAP}"
        )
        if rungs.unlike:
            notes.append(f"Left out: {len(rungs.unlike)} jobs that are not comparable.")
    for title, values, columns, notes in with_rows:
        values["codec"] = values.index
        values["stale"] = _stale(rungs, values.index)
        yield written("curves", title, values, [_CODEC, *columns], notes)


def _differences(rungs: Rungs) -> _Parts:
    """A row a codec: BD-PSNR by kind of surface and over all, each with its interval, and BD-rate."""
    lines = [line for line in rungs.hulls if line != AGAINST]
    values = _of_leads({line: rungs.lead(line) for line in lines})
    for kind, surfaces in rungs.kinds.items():
        of_kind = _of_leads({line: rungs.lead(line, surfaces) for line in values.index})
        whole = of_kind[of_kind["surfaces"] == len(surfaces)]  # a median over fewer surfaces would not compare
        values[kind] = whole["median"].reindex(values.index)
        values[f"{kind} interval"] = whole.apply(_interval, axis=1).reindex(values.index, fill_value="")
    values["rate"] = [100 * _median_rate(rungs, line) for line in values.index]
    values = values.sort_values("median", ascending=False, kind="stable")
    told = f"None is told apart: that takes {LEAST_SURFACES} surfaces."
    if (values["surfaces"] >= LEAST_SURFACES).any():
        told = f"*: told apart: at least {LEAST_SURFACES} surfaces, and an interval without 0."
    notes = [
        "BD-PSNR: the mean gap in dB at equal bytes, over the bytes that both codecs reach. BD-rate: the mean gap in "
        f"bytes at equal dB; less than 0 takes fewer bytes; {_NEVER}: on half of the surfaces or more, no file of the "
        f"codec is as good as the smallest of {AGAINST}. {told}"
    ]
    columns = [
        *(Column(f"{kind}, {len(on)}", "dB ↑", kind, write=_with_interval(kind)) for kind, on in rungs.kinds.items()),
        Column("all", "dB ↑", "median", signed=True),
        Column("95 % interval", "of the median", "median", write=_interval),
        Column("ahead", "on ↑", "won", 0, write=_won),
        Column("BD-rate", "median ↓", "rate", 0, signed=True, write=_rate),
    ]
    return f"Curves against {AGAINST}: Bjøntegaard's differences, test PSNR", values, columns, notes


def _with_interval(kind: str) -> Callable[[Row], str]:
    """A function that writes the lead of a row on surfaces of a kind, with its interval."""

    def write(row: Row) -> str:
        """The lead and its interval: “+0.5 (+0.2 to +1.1)”; a dash without one."""
        if isnan(row[kind]):
            return NONE
        return f"{signed(row[kind], 1)} ({row[f'{kind} interval'].rstrip('*')})"

    return write


def _median_rate(rungs: Rungs, line: str) -> float:
    """The median of BD-rate over the surfaces where a line and `AGAINST` have curves, as a share; NaN without any.

    A surface on which one line is above all that the other reaches counts with −1 or infinity, and not at all if both
    lines are level there, at what a display shows.
    """
    rates = []
    for surface, hull in rungs.hulls[line].items():
        other = rungs.hulls[AGAINST].get(surface)
        ours, theirs = rungs.curve(hull), rungs.curve(other) if other else None
        rate = bd_rate(ours, theirs) if ours and theirs else None
        if rate is not None:
            rates.append(rate)
    return median(rates) if rates else nan


def _rate(row: Row) -> str:
    """A BD-rate in per cent as a cell."""
    if isnan(row["rate"]):
        return NONE
    return _NEVER if isinf(row["rate"]) else f"{signed(row['rate'], 0)} %"


def _three_metrics(rungs: Rungs) -> _Parts:
    """A row a codec: three metrics at one size, `ENOUGH`, each with the codec's place by it.

    So a reader sees whether the metrics agree on the order. Codecs that lack a metric, or whose curves do not reach
    that size on each surface, are left out: places among different codecs would not compare.
    """
    values = pd.DataFrame({each.field: median_over(rungs.read(ENOUGH.most, each.field)) for each in _METRICS}).dropna()
    for metric in _METRICS:
        values[f"{metric.field} place"] = values[metric.field].rank(ascending=metric.field == "flip", method="first")
    values = values.sort_values("psnr", ascending=False, kind="stable")
    columns = [
        Column("PSNR", "dB ↑", "psnr", better="none", write=_with_place("psnr", 1)),
        Column("SSIM", "↑", "ssim", better="none", write=_with_place("ssim", 3)),
        Column("FLIP", "↓", "flip", better="none", write=_with_place("flip", 3)),
    ]
    where = f"at {ENOUGH.most} bits a texel on {len(rungs.surfaces)} surfaces"
    return f"Curves {where}: three metrics, and the place by each", values, columns, []


def _with_place(field: str, digits: int) -> Callable[[Row], str]:
    """A function that writes a number of the field with the place by it."""
    return lambda row: f"{fixed(row[field], digits)} ({row[f'{field} place']:.0f})"


def _footprints(rungs: Rungs) -> _Parts:
    """A row a codec: PSNR at one size, a column a footprint. From further away a pixel covers more texels a side."""
    values = pd.DataFrame({side: median_over(rungs.read(ENOUGH.most, side)) for side in FOOTPRINTS}).dropna()
    values = values.sort_values(FOOTPRINTS[-1], ascending=False, kind="stable")
    columns = [Column("1 texel" if side == "1" else f"{side} texels", "dB ↑", side) for side in FOOTPRINTS]
    note = (
        "Footprint: texels a side of a pixel. The truth is averaged over it; a codec without levels of detail aliases."
    )
    where = f"at {ENOUGH.most} bits a texel on {len(rungs.surfaces)} surfaces"
    return f"Curves {where}: PSNR by footprint", values, columns, [note]


def _in_memory(rungs: Rungs) -> _Parts:
    """A row a codec: PSNR by kind of surface, at one size in memory in place of one in the file, and the lead there."""
    resident = rungs.over_memory()
    values = pd.DataFrame({kind: median_over(resident.read(MEMORY)[on]) for kind, on in rungs.kinds.items()})
    values = values.dropna(how="all")
    values = values.join(_of_leads({line: resident.lead(line) for line in values.index}))
    values["single"] = False
    values = values.sort_values([*rungs.kinds], ascending=False, kind="stable")
    columns = [
        *(Column(f"{kind}, {len(on)}", "dB ↑", kind) for kind, on in rungs.kinds.items()),
        Column("lead", "dB ↑", "median", signed=True, write=_lead),
        Column("95 % interval", "of the lead", "median", write=_interval),
    ]
    note = (
        "In memory: textures, tables and networks as this suite's decoders hold them to be asked, in float32. "
        f"A renderer may hold them in fewer bits. Lead: over {AGAINST} at equal bytes in memory."
    )
    return f"Curves over bytes in memory: test PSNR at {MEMORY} bits a texel", values, columns, [note]


# By kind of table: the function that makes the tables of a run.
TABLES = {
    "front": front_table,
    "budgets": budgets_tables,
    "when": when_table,
    "rungs": rung_tables,
    "ranks": ranks_table,
    "curves": curves_tables,
}


def _stale(rungs: Rungs, lines: Iterable[str], surfaces: Sequence[str] = ()) -> list[str]:
    """Of each line its codec and why its numbers, on some surfaces or on all, cannot be made again; "" if they can."""
    on = surfaces or rungs.surfaces
    reasons = {line: reason for (line, surface), reason in rungs.stale.items() if surface in on}
    return [reasons.get(line, "") for line in lines]


def in_words(budget: Budget) -> str:
    """A budget in words, such as "64 bits a texel", "8 × floor, eager" or "10 s, fit"."""
    if budget.kind == BYTES:
        return f"{budget.most:g} bits a texel"
    return f"{budget.most:g} {_unit(budget.kind)}, {budget.kind}"


def _unit(kind: str) -> str:
    """The unit of a kind of time: seconds of a fit, or multiples of the floor, of a query."""
    return "s" if kind == FIT else "× floor"


def _common(run: Run, rungs: Rungs) -> Iterator[str]:
    """Notes common to all tables of budgets: on what machine times were measured, and which jobs are left out."""
    if set(rungs.times) - {FIT}:  # there are times of queries, and not of fits alone
        machines = "; ".join(_machines(run))
        yield f"Times: medians, × floor, one bilinear fetch; {machines}."
    excluded = []
    if rungs.without:
        excluded.append(f"{_by_suite(run, rungs.without)}, without a score of validation pairs")
    if rungs.unlike:
        rows = list(dict.fromkeys(f"{job['material']}/{shown_label(job)}" for job in rungs.unlike))
        first_rows = ", ".join(rows[:_NAMED])
        if len(rows) > _NAMED:
            first_rows += ", …"
        excluded.append(f"{_by_suite(run, rungs.unlike)} ({first_rows}), not comparable with {beside(run)}")
    if excluded:
        yield f"Left out: {'; '.join(excluded)}."


def _untimed(rungs: Rungs) -> list[str]:
    """The settings without a time of a query, of lines that have times of others."""
    timed = rungs.frame.groupby(["line", "label"], sort=False)[EAGER].count() > 0
    some = timed.groupby(level="line").transform("any")
    return timed.index[some & ~timed].get_level_values("label").tolist()


def _machines(run: Run) -> list[str]:
    """The processors and cores on which times were measured, each once: "AMD EPYC, 8 cores"."""
    machines: dict[str, None] = {}
    # Only timings of settings, apart from surfaces, have `rounds`. Where there are any, budgets use no others.
    timings = [timing for timing in run.timings if "rounds" in timing]
    if not timings:
        timings = list(run.timings)
    for timing in timings:
        name = timing.get("run", "")
        # A start is one call of the command that measures. A timing that names none is taken to be of the last one.
        starts = [start for start in run.starts if not name or start.get("run") == name]
        machine = starts[-1].get("machine", Machine()) if starts else Machine()
        parts = []
        if machine.get("processor"):
            parts.append(str(machine["processor"]))
        if "cores" in machine:
            parts.append(f"{machine['cores']} cores")
        if parts:
            machines[", ".join(parts)] = None
    return list(machines)


def _by_suite(run: Run, jobs: Sequence[Job]) -> str:
    """How many jobs are of which suite, the file that names what to measure: "3 of budgets, 1 of no suite"."""
    suites = {start.get("run"): str(start.get("suite") or "no suite") for start in run.starts}  # by name of the start
    counts = Counter(suites.get(job.get("run"), "no suite") for job in jobs)
    return ", ".join(f"{count} of {suite}" for suite, count in counts.items())
