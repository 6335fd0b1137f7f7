"""Tables of each codec's quality within budgets of bytes and time; `bench.compare.budgets` chooses the rungs.

`budgets` compares the codecs over all materials, `rungs` lists the choices on each material, and `when` answers which
codec to use, one line a question.
"""

from collections.abc import Iterator, Mapping
from functools import lru_cache
from statistics import fmean

from bench.compare.budgets import BITS, BYTES, FIT, Budget, Budgets, apart, budgets, mean_over, shown
from bench.compare.paired import AGAINST, FEWEST, Interval
from bench.compare.ranks import Ranks, ranks
from bench.records import FLIP, KINDS, MOST_DB, PSNR, SSIM, Record, Run
from bench.records.choosing import Rung
from reports.best_cells import best_cells
from reports.numbers import EXACT, NONE, fixed, integer, significant
from reports.rows import fused_times
from reports.table import Table

_NOTHING = f"On fewer than {FEWEST} surfaces nothing is told apart."
NEAR_DB = 0.5  # within this many dB of the best counts as equally good
ENOUGH = Budget(BYTES, 32)  # the budget of ranks, and for questions about a single material or metric
_CHOICE = (
    "For each codec: the settings (a rung) that fit the budget with the best PSNR of validation pairs. Numbers are "
    "means over the slices of test pairs. Bits a texel are those of the whole file, without a shared network."
)


@lru_cache(maxsize=1)
def found(run: Run) -> Budgets:
    """The rungs that were chosen in a run."""
    return budgets(run, fused_times(run))


def budgets_table(run: Run) -> Iterator[Table]:
    """A row a codec, a column a budget: PSNR, mean over materials. A table a kind of surface, then one over all."""
    result = found(run)
    kinds = {kind: result.of_kind(kind) for kind in KINDS}
    parts = {kind: part for kind, part in kinds.items() if part.materials}
    for kind, part in parts.items():
        yield from _budgets(run, part, kind)
    if len(parts) > 1:
        yield from _budgets(run, result, "")


def _budgets(run: Run, result: Budgets, kind: str) -> Iterator[Table]:
    means = {line: values for line, values in _means(result).items() if any(value is not None for value in values)}
    if not means:
        return
    lines = sorted(means, key=lambda line: [-(value or 0.0) for value in reversed(means[line][: len(BITS)])])
    told, notes = _told(run, result) if len(result.materials) >= FEWEST else (set(), [_NOTHING])
    rows = [[line, *(_cell(value, (line, i) in told) for i, value in enumerate(means[line]))] for line in lines]
    headers = [("codec", ""), *(_header(run, result, budget) for budget in result.picks)]
    count = len(result.materials)
    on = " ".join(filter(None, [str(count), kind, f"surface{'s' * (count > 1)}"]))
    title = f"Budgets on {on} ({', '.join(result.materials)}): test PSNR, dB"
    notes = [f"{_CHOICE} {_missing(count)}", *notes, *_common(run, result)]
    marks = best_cells(rows, [[None, *means[line]] for line in lines])
    yield Table("budgets", title, headers, rows, notes, marks=marks)


def rung_tables(run: Run) -> Iterator[Table]:
    """The rungs that were chosen on each material, with their budgets and quality; first their means."""
    result = found(run)
    if result.materials[1:]:
        yield from _over_materials(run, result)
    headers = [("codec", ""), ("rung", ""), _at(result)]
    headers += [("total", "bytes"), ("validation", "dB"), ("PSNR", "dB"), ("SSIM", ""), ("FLIP", "")]
    headers += [(kind, _unit(kind)) for kind in result.times]
    for material in result.materials:
        picked = list(_chosen(result, material))
        rows = [_rung_row(result, line, rung, at) for line, rung, at in picked]
        if rows:
            title = f"{material}: the rung of each budget"
            notes = [_CHOICE, *_common(run, result)]
            yield Table("rungs", title, headers, rows, notes, words=3, material=material)


def _over_materials(run: Run, result: Budgets) -> Iterator[Table]:
    """Bytes, PSNR, SSIM and FLIP of each codec at each budget, means over the materials."""
    rows: dict[tuple[str, ...], list[Budget]] = {}  # the budgets of equal rows, by their other cells
    for line in _means(result):
        for budget, picked in result.picks.items():
            rungs = list(picked.get(line, {}).values())
            values = [mean_over(result.materials, picked.get(line, {}), family) for family in (PSNR, SSIM, FLIP)]
            if values[0] is not None:
                size = fmean(max(job["bytes"]["total"] for job in rung.of) for rung in rungs)
                numbers = [_number(value, digits) for value, digits in zip(values, (2, 3, 3), strict=True)]
                rows.setdefault((line, integer(round(size)), *numbers), []).append(budget)
    headers = [("codec", ""), _at(result), ("total", "bytes"), ("PSNR", "dB"), ("SSIM", ""), ("FLIP", "")]
    cells = [[line, _span(at), *numbers] for (line, *numbers), at in rows.items()]
    if cells:
        title = f"Means over {len(result.materials)} materials of the rung of each budget"
        yield Table("rungs", title, headers, cells, [_CHOICE, *_common(run, result)], words=2)


def when_table(run: Run) -> Iterator[Table]:
    """Which codec when: a question a row, its answer with numbers, and the next best."""
    result = found(run)
    rows = [*_by_budget(result), *_smallest(result), *_by_material(result), *_by_metric(result)]
    headers = [("question", ""), ("best", ""), ("then", ""), ("best", ""), ("then", "")]
    notes = [_CHOICE]
    if rows:
        yield Table("when", "Which codec when", headers, rows, notes, words=3)


def ranked_at(result: Budgets, budget: Budget = ENOUGH) -> Ranks | None:
    """The mean ranks at a budget of the lines with a rung on every material."""
    lines = {
        line: [shown(rungs[name], PSNR) or 0.0 for name in result.materials]
        for line, rungs in result.picks.get(budget, {}).items()
        if rungs.keys() >= set(result.materials)
    }
    return ranks(lines)


def ranks_table(run: Run) -> Iterator[Table]:
    """The mean rank of each line at a budget, and the lines that are not told apart from it."""
    result = found(run)
    if not (ranking := ranked_at(result)):
        return
    rows = []
    for line, rank in ranking.mean.items():
        near = [other for other, its in ranking.mean.items() if other != line and abs(its - rank) < ranking.critical]
        rows.append([line, fixed(rank, 2), ", ".join(near) or NONE])
    title = f"Mean ranks over {len(result.materials)} surfaces at {in_words(ENOUGH)}"
    note = f"Nemenyi's critical difference: {ranking.critical:.2f}. Only lines with a rung on each surface are ranked."
    yield Table("ranks", title, [("codec", ""), ("mean rank", "↓"), ("not told apart from", "")], rows, [note, _CHOICE])


TABLES = {"budgets": budgets_table, "when": when_table, "rungs": rung_tables, "ranks": ranks_table}


def _means(result: Budgets, family: str = PSNR) -> dict[str, list[float | None]]:
    """By line, the mean over materials at each budget."""
    lines = dict.fromkeys(line for by_line in result.picks.values() for line in by_line)
    return {
        line: [mean_over(result.materials, by_line.get(line, {}), family) for by_line in result.picks.values()]
        for line in lines
    }


def _ranked(result: Budgets, budget: Budget, materials: list[str], family: str = PSNR) -> list[tuple[float, str]]:
    """The lines with a rung on each material at a budget, with their numbers, the best first."""
    picked = result.picks.get(budget, {})
    values = [(mean_over(materials, rungs, family), line) for line, rungs in picked.items()]
    return sorted(((value, line) for value, line in values if value is not None), key=lambda each: -each[0])


def _told(run: Run, result: Budgets) -> tuple[set[tuple[str, int]], list[str]]:
    """The cells, by line and column, that are told apart from `AGAINST` in their column, and a note on how."""
    told = {
        (line, column)
        for column, budget in enumerate(result.picks)
        for line, each in _against(run, result, budget).items()
        if each.apart
    }
    return told, [
        f"*: told apart from {AGAINST}, by Student's t over the surfaces' means of paired differences of PSNR a slice, "
        f"with Holm's correction over the column: {len(told)} in all."
    ]


def _against(run: Run, result: Budgets, budget: Budget) -> Mapping[str, Interval]:
    """The paired differences to `AGAINST` at a budget, of the other lines with a rung on each material."""
    picked = result.picks.get(budget, {})
    return apart(run, {line: picked[line] for _, line in _ranked(result, budget, result.materials)})


def _header(run: Run, result: Budgets, budget: Budget) -> tuple[str, str]:
    if budget.kind != BYTES:
        return f"{budget.most:g} {_unit(budget.kind)}", budget.kind
    shapes = {tuple(job["shape"]) for _, rung in result.rungs for job in rung.of}
    if len(shapes) > 1:
        return f"{budget.most:g} bits", "a texel"
    height, width = next(iter(shapes))
    return f"{budget.most:g} bits", f"{significant(budget.most * height * width / 8000, 2)} kB"


def _cell(value: float | None, told: bool) -> str:
    return f"{_number(value, 2)}{'*' * told}"


def _number(value: float | None, digits: int) -> str:
    return EXACT if value is not None and value >= MOST_DB else fixed(value, digits)


def _missing(count: int) -> str:
    return f"{NONE}: no rung fits{' on each material' * (count > 1)}. “As published”: the rungs of the paper's recipe."


def _chosen(result: Budgets, material: str) -> Iterator[tuple[str, Rung, list[Budget]]]:
    """Line, rung and budgets of each rung that was chosen on a material."""
    at: dict[tuple[str, str], tuple[Rung, list[Budget]]] = {}
    for budget, lines in result.picks.items():
        for line, rungs in lines.items():
            if material in rungs:
                rung = rungs[material]
                at.setdefault((line, rung.of[0]["job"]), (rung, []))[1].append(budget)
    order = list(dict.fromkeys(line for line, _ in at))
    for (line, _), (rung, budgets_of) in sorted(at.items(), key=lambda each: order.index(each[0][0])):
        yield line, rung, budgets_of


def _rung_row(result: Budgets, line: str, rung: Rung, at: list[Budget]) -> list[str]:
    numbers = [integer(max(job["bytes"]["total"] for job in rung.of)), _number(rung.score, 2)]
    numbers += [_number(shown(rung, family), 2 if family == PSNR else 3) for family in (PSNR, SSIM, FLIP)]
    times = [result.times[kind].get(rung.of[0]["job"]) for kind in result.times]
    return [line, rung.name, _span(at), *numbers, *map(significant, times)]


def _at(result: Budgets) -> tuple[str, str]:
    return ("at bits, times" if result.times else "at bits a texel"), ""


def in_words(budget: Budget) -> str:
    """A budget in words: 64 bits a texel; 8 × floor, eager; 10 s, fit."""
    return f"{budget.most:g} " + ("bits a texel" if budget.kind == BYTES else f"{_unit(budget.kind)}, {budget.kind}")


def _unit(kind: str) -> str:
    return "s" if kind == FIT else "× floor"


def _span(at: list[Budget]) -> str:
    """Budgets in words, budgets of bytes as a range: 32–128, 8 × eager."""
    bits = [f"{each.most:g}" for each in at if each.kind == BYTES]
    ends = "–".join(dict.fromkeys([*bits[:1], *bits[-1:]]))
    times = [f"{each.most:g} {'s' if each.kind == FIT else '×'} {each.kind}" for each in at if each.kind != BYTES]
    return ", ".join(filter(None, [ends, *times]))


def _by_budget(result: Budgets) -> Iterator[list[str]]:
    for budget in result.picks:
        ranked = _ranked(result, budget, result.materials)
        if ranked:
            yield _answer(f"best quality in {in_words(budget)}", ranked, "dB", 2)


def _smallest(result: Budgets) -> Iterator[list[str]]:
    """The smallest budget of bytes that is within `NEAR_DB` of the best of all."""
    by_budget = {budget: _ranked(result, budget, result.materials) for budget in result.picks if budget.kind == BYTES}
    best = max((ranked[0][0] for ranked in by_budget.values() if ranked), default=0.0)
    for budget, ranked in by_budget.items():
        near = [each for each in ranked if each[0] >= best - NEAR_DB]
        if near:
            question = f"fewest bytes within {NEAR_DB:g} dB of the best: {budget.most:g} bits a texel"
            yield _answer(question, near, "dB", 2)
            return


def _by_material(result: Budgets) -> Iterator[list[str]]:
    for material in result.materials if result.materials[1:] else []:
        ranked = _ranked(result, ENOUGH, [material])
        if ranked:
            yield _answer(f"best on {material} in {ENOUGH.most:g} bits a texel", ranked, "dB", 2)


def _by_metric(result: Budgets) -> Iterator[list[str]]:
    for family, name, sign in ((SSIM, "SSIM", 1), (FLIP, "FLIP", -1)):
        ranked = sorted(_ranked(result, ENOUGH, result.materials, family), key=lambda each: -sign * each[0])
        if ranked:
            yield _answer(f"best {name} in {ENOUGH.most:g} bits a texel", ranked, "", 3)


def _answer(question: str, ranked: list[tuple[float, str]], unit: str, digits: int) -> list[str]:
    words, numbers = (
        [line for _, line in ranked[:2]],
        [f"{_number(value, digits)} {unit}".strip() for value, _ in ranked[:2]],
    )
    gap = [NONE] * (2 - len(words))
    return [question, *words, *gap, *numbers, *gap]


def _common(run: Run, result: Budgets) -> Iterator[str]:
    """Notes on times, and on excluded records."""
    if result.times.keys() - {FIT}:
        on = dict.fromkeys(_machine(run, str(time.get("run", ""))) for time in run.timings)
        yield f"Times: upper ends of 95 % intervals, × floor; {'; '.join(filter(None, on))}."
    if result.without:
        yield f"Left out, because they have no score of validation pairs: {_by_suite(run, result.without)}."
    if result.unlike:
        yield f"Left out, because they are not comparable with the newest job: {_by_suite(run, result.unlike)}."


def _machine(run: Run, name: str) -> str:
    start: Record = next((each for each in reversed(run.starts) if not name or each.get("run") == name), {})
    machine = start.get("machine", {})
    parts = [machine.get("processor"), f"{machine['cores']} cores" if "cores" in machine else ""]
    return ", ".join(str(part) for part in parts if part)


def _by_suite(run: Run, jobs: list[Record]) -> str:
    """The number of records of each suite, in words."""
    suites = {start.get("run"): str(start.get("suite", "")) for start in run.starts}
    counts: dict[str, int] = {}
    for job in jobs:
        suite = suites.get(job.get("run"), "")
        counts[suite] = counts.get(suite, 0) + 1
    return ", ".join(f"{count} of {suite or 'no suite'}" for suite, count in counts.items())
