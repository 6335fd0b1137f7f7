"""Tables of each codec's quality within budgets of bytes and time.

A *rung* is one setting of a codec, as measured with one seed or several. A *line* is a codec, by its name; a codec as
its paper publishes it is a line of its own, "neumip, as published". A *surface* is a material as these tables group
them, by kind, such as measured or rendered. A *budget* is a limit on the bytes of a file, on the time of a query
or on the time of a fit. The *curve* of a line on a surface joins its rungs on the upper convex hull of quality over
bytes. Rungs are chosen by *validation* pairs of directions, and shown with their scores at *test* pairs.
`bench.compare.choosing` chooses them; docs/metrics.md has the rules.

Times of queries are multiples of the *floor*, the time of one bilinear fetch of a colour. The *lead* of a line is by
how many dB it is ahead of the line `AGAINST` at equal bytes; two lines are *told apart* if chance hardly explains the
gap. A cell without a number is a dash, `NONE`.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from math import log2
from statistics import fmean
from typing import NamedTuple

from bench.compare.choosing import NEAR_DB, Rung
from bench.compare.choosing.budgets import (
    BYTES,
    EAGER,
    ENOUGH,
    FIT,
    Budget,
    Budgets,
    budgets,
    mean_bytes,
    mean_test_score,
    setting_of,
)
from bench.compare.choosing.curves import FEWEST as LEAST_SURFACES
from bench.compare.choosing.curves import (
    Points,
    Reading,
    Summary,
    differences,
    gaps_of_rungs,
    hulls,
    mean_at,
    readings,
    summarised,
)
from bench.compare.choosing.within import fewest_bytes, mean_ranks, ranked
from bench.compare.paired import AGAINST
from bench.compare.statistics import FEWEST, average
from bench.records import FLIP, MOST_DB, PSNR, SSIM, Job, Machine, Run, by_kind, shown_label
from reports.notes import beside
from reports.numbers import NONE, fixed, integer, signed, significant
from reports.table import Table, best_cells

_DIGITS = {PSNR: 2, SSIM: 3, FLIP: 3}  # decimals in cells, by metric
_NAMED = 5  # rows that a note on excluded records names
_TIED = 3  # codecs with the same number that a cell names
_METRICS = [("PSNR", "dB"), ("SSIM", ""), ("FLIP", "")]  # headers: name and unit, in the order of `_DIGITS`
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


def budgets_table(run: Run) -> Iterator[Table]:
    """A row a codec, a column a budget: PSNR, mean over materials. A table a kind of surface, then one over all.

    PSNR at a size is read off curves: it does not depend on where the codec has its rungs. Within a time it is that of
    the best rung in time.
    """
    result = budgets(run)
    points = hulls(result, result.surfaces)  # of the curves, by line and surface
    kinds = by_kind(result.surfaces)  # the names of surfaces by kind
    tables = list[Table]()
    for kind, surfaces in kinds.items():
        tables += _table_of_surfaces(result, points, surfaces, kind)
    if len(kinds) > 1:  # of a single kind, the table over all would be the same
        tables += _table_of_surfaces(result, points, list(result.surfaces), "")
    if tables:  # notes common to them stand once, below the last
        notes = [_READ, *_common(run, result)]
        untimed = _untimed(result)
        if untimed:
            notes.append(f"Not timed, so within no time: {'; '.join(untimed)}.")
        tables[-1].notes.extend(notes)
    yield from tables


def _table_of_surfaces(result: Budgets, points: Points, surfaces: Sequence[str], kind: str) -> Iterator[Table]:
    """The table over some surfaces, if a line has a value there; else none.

    `kind` is the kind of these surfaces, "" for all.
    """
    # By budget, then by line: the reading of a cell.
    columns = {budget: _column(result, points, budget, surfaces) for budget in result.limits}
    lines = list(dict.fromkeys(chain.from_iterable(columns.values())))
    if not lines:
        return
    told_apart: dict[Budget, set[str]] = {}  # by budget of time: the lines that are told apart from `AGAINST`
    if len(surfaces) >= FEWEST:  # on fewer surfaces the test tells nothing apart
        for budget in columns:
            if budget.kind != BYTES:  # the test compares rungs, but values at a size are read between rungs
                told_apart[budget] = result.told_apart(budget, surfaces)

    outdone = _outdone(columns)
    rows: list[list[str]] = []
    scores: list[list[float | None]] = []  # a number for each cell, by which the best of a column is marked
    for line in sorted(lines, key=lambda line: _sort_key(columns, line)):
        cells: list[str] = [line]
        values: list[float | None] = [None]
        for budget, column in columns.items():
            reading = column.get(line)
            cell = _reading_cell(reading)
            if line in told_apart.get(budget, ()):
                cell += "*"
            cells.append(cell)
            if reading is None or budget in outdone:
                values.append(None)  # it gets no mark
            else:
                values.append(reading.value)
        rows.append(cells)
        scores.append(values)

    shapes = set()  # (height, width) in texels
    for name in surfaces:
        height, width = result.surfaces[name]["shape"]
        shapes.add((height, width))
    headers = [("codec", ""), *(_header(budget, shapes) for budget in columns)]
    words = [str(len(surfaces)), kind, "surfaces" if len(surfaces) > 1 else "surface"]
    counted = " ".join(word for word in words if word)  # such as "4 fabric surfaces"
    title = f"Budgets on {counted} ({', '.join(surfaces)}): test PSNR, dB"
    notes = []
    if any(told_apart.values()):
        notes.append(f"*: told apart from {AGAINST}, by Holm's correction over the column.")
    if outdone:
        notes.append("No best is marked at a size where a codec whose curves end before has more dB at a smaller one.")
    yield Table("budgets", title, headers, rows, notes, marks=best_cells(rows, scores))


def _column(result: Budgets, points: Points, budget: Budget, surfaces: Sequence[str]) -> dict[str, Reading]:
    """By line: its PSNR within a budget, the mean over some surfaces.

    At a budget of bytes it is read off curves; within a budget of time it is that of rungs.
    """
    if budget.kind == BYTES:
        return readings(result, points, budget, surfaces)
    # No curve leads from one time to another, so the best rung within a time is the codec's own value, not a bound.
    ranked = result.ranked(budget, surfaces)
    return {line: Reading(value, lower_bound=False) for line, value in ranked.items()}


def _outdone(columns: Mapping[Budget, Mapping[str, Reading]]) -> set[Budget]:
    """The sizes at which no line is as good as some line at a smaller size. To mark a best there would mislead."""
    found = set()
    best_so_far = 0.0
    for budget, column in columns.items():  # the sizes come in ascending order
        if budget.kind == BYTES and column:
            best = max(reading.value for reading in column.values())
            if best < best_so_far:
                found.add(budget)
            best_so_far = max(best_so_far, best)
    return found


def _sort_key(columns: Mapping[Budget, Mapping[str, Reading]], line: str) -> list[float]:
    """The key that sorts rows, the best first: by the value at `ENOUGH`, a size that most codecs reach.

    Ties are sorted by the values at the sizes next to it, and so on to the smallest and the largest. A key has the
    negative of each value, because lists sort upwards.
    """
    sizes = [budget for budget in columns if budget.kind == BYTES]
    sizes.sort(key=lambda budget: abs(log2(budget.most / ENOUGH.most)))  # half of it is as near as twice
    key = []
    for budget in sizes:
        reading = columns[budget].get(line)
        key.append(-reading.value if reading else 0.0)  # PSNR is above 0, so a line that lacks it comes last
    return key


def _reading_cell(reading: Reading | None) -> str:
    """A reading as a cell; with “≥” where only a best rung within the size is known."""
    if reading is None:
        return NONE
    number = _number(reading.value, digits=1)  # PSNR in dB
    return f"≥{number}" if reading.lower_bound else number


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
    materials, a table of the means over them comes first."""
    result = budgets(run)
    at_budgets = ("at bits, times" if result.times else "at bits a texel", "")  # a header: name, no unit
    notes = [_CHOICE, *_common(run, result)]
    means = list(_mean_rows(result)) if len(result.surfaces) > 1 else []
    if means:
        title = f"Means over {len(result.surfaces)} materials of the rung of each budget"
        yield Table("rungs", title, [("codec", ""), at_budgets, ("total", "bytes"), *_METRICS], means, notes, words=2)
    headers = [("codec", ""), ("rung", ""), at_budgets, ("total", "bytes"), ("validation", "dB"), *_METRICS]
    headers += [(kind, _unit(kind)) for kind in result.times]
    for material in result.surfaces:
        title = f"{material}: the rung of each budget"
        rows = list(_rung_rows(result, material))
        yield Table("rungs", title, headers, rows, notes, words=3, material=material)


def _mean_rows(result: Budgets) -> Iterator[list[str]]:
    """Rows of the table of means: line, budgets, then bytes, PSNR, SSIM and FLIP, means over the materials.

    Budgets at which a line has the same numbers share a row, because mostly the same rungs were chosen.
    """
    # By line, and by the cells of its numbers: the budgets that have these numbers.
    budgets_by_cells: dict[str, dict[tuple[str, ...], list[Budget]]] = {}
    for budget in result.limits:
        for line, by_surface in result.picks(budget, result.surfaces).items():  # of each surface the chosen rung
            rungs = list(by_surface.values())
            mean_total = fmean(mean_bytes(rung.of) for rung in rungs)  # `rung.of`: its jobs, one a seed
            cells = [integer(round(mean_total))]
            for family in _DIGITS:
                mean = average([mean_test_score(rung, family) for rung in rungs])
                cells.append(_number(mean, family))
            budgets_by_cells.setdefault(line, {}).setdefault(tuple(cells), []).append(budget)
    for line, by_cells in budgets_by_cells.items():
        for equal_cells, limits in by_cells.items():
            yield [line, _span(limits), *equal_cells]


def _rung_rows(result: Budgets, material: str) -> Iterator[list[str]]:
    """A row for each rung that was chosen on a material: line, settings, budgets, bytes, quality and times.

    The rows of a line follow each other. A rung that was chosen at several budgets has one row.
    """
    # By line, and by the name of the first job of a rung: the rung, and the budgets at which it was chosen.
    chosen: dict[str, dict[str, tuple[Rung, list[Budget]]]] = {}
    for budget in result.limits:
        for line, rungs in result.picks(budget, [material]).items():
            rung = rungs[material]
            rungs_of_line = chosen.setdefault(line, {})
            _, limits = rungs_of_line.setdefault(rung.of[0]["job"], (rung, []))
            limits.append(budget)
    for line, rungs_of_line in chosen.items():
        for first_job, (rung, limits) in rungs_of_line.items():
            numbers = [integer(mean_bytes(rung.of)), _number(rung.score)]
            numbers += [_number(mean_test_score(rung, family), family) for family in _DIGITS]
            # One time of each kind (eager, fused, fit), a dash where it was not measured.
            times = [significant(by_job.get(first_job)) for by_job in result.times.values()]
            yield [line, setting_of(rung.of[0]), _span(limits), *numbers, *times]


def _span(limits: list[Budget]) -> str:
    """Budgets in words, those of bytes as one range in bits a texel: "32–128, 8 × eager".

    `limits` are in the order of `Budgets.limits`: those of bytes first, and ascending.
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
    for question, means, family in _questions(budgets(run)):
        if not means:  # no line reaches that budget on each surface
            continue
        places = _by_number(means, family)
        if len(places) == 1:  # there is no next best
            places.append((NONE, [NONE]))
        (best, best_lines), (second, second_lines) = places[:2]
        rows.append([question, _named(best_lines), _named(second_lines), best, second])
    headers = [("question", ""), ("best", ""), ("then", ""), ("best", ""), ("then", "")]
    if rows:
        yield Table("when", "Which codec when", headers, rows, [_WITHIN], words=3)


def _by_number(means: Mapping[str, float], family: str) -> list[tuple[str, list[str]]]:
    """The lines by their number as it reads, the best first: lines with the same number are equally good."""
    unit = " dB" if family == PSNR else ""
    lines_with: dict[str, list[str]] = {}
    for line, value in means.items():
        number = _number(value, family, digits=1 if family == PSNR else None) + unit
        lines_with.setdefault(number, []).append(line)
    return list(lines_with.items())


def _named(lines: Sequence[str]) -> str:
    """Up to `_TIED` lines by name, and how many more there are."""
    named = ", ".join(lines[:_TIED])
    more = len(lines) - _TIED
    return f"{named} and {more} more" if more > 0 else named


class _Question(NamedTuple):
    """A question in words, the lines that answer it with their means, the best first, and the metric of these."""

    words: str
    means: dict[str, float]
    family: str


def _questions(result: Budgets) -> Iterator[_Question]:
    """The questions of the table: about each budget, the fewest bytes, each surface, and the other metrics."""
    points = hulls(result, result.surfaces)
    surfaces = list(result.surfaces)
    enough = in_words(ENOUGH)
    for budget in result.limits:
        yield _Question(f"best quality in {in_words(budget)}", ranked(result, points, budget, surfaces), PSNR)
    fewest = fewest_bytes(result, points)  # a budget of bytes, and the lines that are near the best within it
    if fewest:
        budget, near = fewest
        yield _Question(f"fewest bytes within {NEAR_DB:g} dB of the best: {in_words(budget)}", near, PSNR)
    if len(surfaces) > 1:  # on one surface this was asked above
        for material in surfaces:
            yield _Question(f"best on {material} in {enough}", ranked(result, points, ENOUGH, [material]), PSNR)
    for family, name in ((SSIM, "SSIM"), (FLIP, "FLIP")):
        yield _Question(f"best {name} in {enough}", ranked(result, points, ENOUGH, surfaces, family), family)


def ranks_table(run: Run) -> Iterator[Table]:
    """The mean rank of each line at a budget, and the lines that are not told apart from it."""
    result = budgets(run)
    ranking = mean_ranks(result, hulls(result, result.surfaces))
    if not ranking:  # too few lines or surfaces to rank
        return
    rows = []
    for line, rank in ranking.mean.items():
        not_apart = []
        for other, its_rank in ranking.mean.items():
            if other != line and abs(its_rank - rank) < ranking.critical:
                not_apart.append(other)
        rows.append([line, fixed(rank, 2), ", ".join(not_apart) or NONE])
    title = f"Mean ranks over {len(result.surfaces)} surfaces at {in_words(ENOUGH)}"
    note = f"Nemenyi's critical difference: {ranking.critical:.2f}."
    yield Table("ranks", title, [("codec", ""), ("mean rank", "↓"), ("not told apart from", "")], rows, [note, _WITHIN])


def front_table(run: Run) -> Iterator[Table]:
    """A row a line at 32 bits a texel: PSNR by kind of surface and over all, its lead over `AGAINST`, and its time."""
    result = budgets(run)
    points = hulls(result, result.surfaces)
    kinds = by_kind(result.surfaces) | {"all": list(result.surfaces)}
    readings_of_kinds = [readings(result, points, ENOUGH, surfaces) for surfaces in kinds.values()]  # each by line
    picks = result.picks(ENOUGH, result.surfaces)  # by line and surface: the chosen rung, of which the time is shown
    # Rows stand in the order of the column of all surfaces, which is the last; lines without a value there follow.
    lines = list(dict.fromkeys(chain.from_iterable(reversed(readings_of_kinds))))
    if not lines:
        return
    # A line whose curves all end below this size has dashes for PSNR, but may have a lead at fewer bytes.
    lines += [line for line in points if line not in lines]
    leads: dict[str, Summary] = {}
    rows: list[list[str]] = []
    scores: list[list[float | None]] = []
    for line in lines:
        lead = _lead(result, points, line)
        if lead:
            leads[line] = lead
        jobs_of_rungs = [rung.of for rung in picks.get(line, {}).values()]
        time = _mean_time(result, jobs_of_rungs)
        # Cells and their scores, column by column; a score of None is not compared.
        cells = [line]
        values: list[float | None] = [None]
        for reading_of_line in readings_of_kinds:
            reading = reading_of_line.get(line)
            cells.append(_reading_cell(reading))
            values.append(reading.value if reading else None)
        pooled = mean_at(points.get(line, {}), result.surfaces, ENOUGH.most, statistic="pooled")
        cells.append(_number(pooled, digits=1))
        values.append(pooled)
        cells += _lead_cells(line, lead, line in points)
        values += [lead.median if lead else None, None, None]  # only the median is compared
        cells.append(significant(time))
        values.append(None if time is None else -time)  # less time is better
        rows.append(cells)
        scores.append(values)
    headers = [("codec", "")]
    headers += [(f"{kind}, {len(surfaces)}", "dB ↑") for kind, surfaces in kinds.items()]
    headers += [
        ("pooled", "dB ↑"),
        ("lead, median", "dB ↑"),
        ("95 % interval", "of the mean"),
        ("ahead", "on"),
        ("time", "× floor ↓"),
    ]
    title = f"At {in_words(ENOUGH)}: test PSNR, means over {', '.join(result.surfaces)}"
    notes = ["Pooled: of the squared error of all slices of a surface together, mean over all surfaces."]
    notes += [f"Lead: over {AGAINST} at equal bytes (BD-PSNR), median over surfaces.", *_lead_notes(leads, points)]
    if EAGER in result.times:
        notes.append("Time: eager, of the rung within that size that validation pairs choose, mean over surfaces.")
    yield Table("front", title, headers, rows, [*notes, _READ, *_common(run, result)], marks=best_cells(rows, scores))


def _mean_time(result: Budgets, rungs: Sequence[Sequence[Job]]) -> float | None:
    """The mean time of a query, × floor, over the rungs that were timed; None if none was.

    A rung is given by its jobs, one a seed. Times are those of the execution `eager`, which runs operation by
    operation.
    """
    time_of_job = result.times.get(EAGER, {})
    times = [time_of_job.get(jobs[0]["job"]) for jobs in rungs]  # of a rung, that of its first seed
    return average([time for time in times if time is not None])


def _lead_cells(line: str, lead: Summary | None, has_curves: bool) -> list[str]:
    """The three cells of a lead: its median over surfaces, the interval of its mean, and on how many it is above 0.

    Without curves (`has_curves`), the lead comes from single rungs, and its median has a °.
    """
    if lead is None:
        # `AGAINST` has no lead over itself; any other line shares no bytes with it.
        return ["", "", ""] if line == AGAINST else [NONE, "", ""]
    median = signed(lead.median, 1)
    if not has_curves:
        median += "°"
    interval = f"{signed(lead.low, 1)} to {signed(lead.high, 1)}"
    if lead.apart:
        interval += "*"
    return [median, interval, f"{lead.won} of {lead.surfaces}"]


def _lead_notes(leads: Mapping[str, Summary], points: Points) -> Iterator[str]:
    """Notes on the marks beside leads: what ° and * mean, or why no lead is told apart.

    `leads` is by line, and `points` are those of the lines that have curves.
    """
    if leads.keys() - points.keys():  # a line without curves has a lead
        yield "°: of fewer than three rungs, each at its own bytes."
    if any(lead.apart for lead in leads.values()):
        yield "*: told apart: the interval leaves out 0."
    elif leads:
        most_surfaces = max(lead.surfaces for lead in leads.values())
        if most_surfaces < LEAST_SURFACES:
            yield f"None is told apart: that takes {LEAST_SURFACES} surfaces."
        else:
            yield "None is told apart."


def _lead(result: Budgets, points: Points, line: str) -> Summary | None:
    """The lead of a line over `AGAINST` at equal bytes; None for `AGAINST` itself, and where they share no bytes."""
    if line == AGAINST:
        return None
    anchor = points.get(AGAINST, {})
    # By surface a list: the gap in dB, then the gap of each draw of seeds, from which the interval comes.
    if line in points:
        gaps = differences(points[line], anchor)
    else:  # too few rungs for a curve: each rung is compared with the anchor's curve at the rung's own bytes
        gaps = gaps_of_rungs(result, line, anchor)
    return summarised(gaps) if gaps else None


# By kind of table: the function that makes the tables of a run.
TABLES = {
    "front": front_table,
    "budgets": budgets_table,
    "when": when_table,
    "rungs": rung_tables,
    "ranks": ranks_table,
}


def _number(value: float | None, family: str = PSNR, digits: int | None = None) -> str:
    """A value as a cell, a dash for None; by default with the usual digits of its metric."""
    if digits is None:
        digits = _DIGITS[family]
    return fixed(value, digits)


def in_words(budget: Budget) -> str:
    """A budget in words, such as "64 bits a texel", "8 × floor, eager" or "10 s, fit"."""
    if budget.kind == BYTES:
        return f"{budget.most:g} bits a texel"
    return f"{budget.most:g} {_unit(budget.kind)}, {budget.kind}"


def _unit(kind: str) -> str:
    """The unit of a kind of time: seconds of a fit, or multiples of the floor, of a query."""
    return "s" if kind == FIT else "× floor"


def _common(run: Run, result: Budgets) -> Iterator[str]:
    """Notes common to all tables of budgets: on what machine times were measured, and which jobs are left out."""
    if result.times.keys() - {FIT}:  # there are times of queries, and not of fits alone
        machines = "; ".join(_machines(run))
        yield f"Times: upper ends of 95 % intervals, × floor, one bilinear fetch; {machines}."
    excluded = []
    if result.without:
        excluded.append(f"{_by_suite(run, result.without)}, without a score of validation pairs")
    if result.unlike:
        rows = list(dict.fromkeys(f"{job['material']}/{shown_label(job)}" for job in result.unlike))
        first_rows = ", ".join(rows[:_NAMED])
        if len(rows) > _NAMED:
            first_rows += ", …"
        excluded.append(f"{_by_suite(run, result.unlike)} ({first_rows}), not comparable with {beside(run)}")
    if excluded:
        yield f"Left out: {'; '.join(excluded)}."


def _untimed(result: Budgets) -> list[str]:
    """The settings without a time of a query, of lines that have times of others."""
    times = result.times.get(EAGER, {})
    found = []
    for by_label in result.rungs.values():
        untimed = []
        for label, by_material in by_label.items():
            jobs = chain.from_iterable(by_material.values())
            if not any(job["job"] in times for job in jobs):
                untimed.append(label)
        if len(untimed) < len(by_label):
            found += untimed
    return found


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
