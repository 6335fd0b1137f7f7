"""Tables of each codec's quality within budgets of bytes and time, of rungs that `bench.compare` chooses."""

from collections import Counter
from collections.abc import Iterator, Sequence
from statistics import fmean

from bench.compare.choosing import NEAR_DB, Rung
from bench.compare.choosing.budgets import (
    BITS,
    BYTES,
    EAGER,
    ENOUGH,
    FIT,
    Budget,
    Budgets,
    budgets,
    mean_bytes,
    setting_of,
    shown,
)
from bench.compare.paired import AGAINST, FEWEST
from bench.compare.quantities import average
from bench.records import FLIP, KINDS, MOST_DB, PSNR, SSIM, Record, Run, grouped, kind_of, shown_label
from reports.notes import beside
from reports.numbers import EXACT, NONE, fixed, integer, significant
from reports.table import Table, best_cells

_DIGITS = {PSNR: 2, SSIM: 3, FLIP: 3}
_NAMED = 5  # rows that a note on excluded records names
_METRICS = [("PSNR", "dB"), ("SSIM", ""), ("FLIP", "")]
FRONT = Budget(BYTES, 64)  # the least of `BITS` at which all codecs of README.md have a rung on each surface
_CHOICE = "A codec's rung is chosen by validation pairs, its numbers are of test pairs (docs/metrics.md, “Budgets”)."


def budgets_table(run: Run) -> Iterator[Table]:
    """A row a codec, a column a budget: PSNR, mean over materials. A table a kind of surface, then one over all."""
    result = budgets(run)
    kinds = grouped(result.surfaces, lambda material: kind_of(result.surfaces[material]))
    tables = [each for kind in KINDS if kind in kinds for each in _budgets(run, result, kinds[kind], f"{kind} ")]
    if len(kinds) > 1:
        tables += _budgets(run, result, list(result.surfaces), "")
    if tables:  # notes common to them stand once, below the last
        tables[-1].notes.extend([f"{_CHOICE} {NONE}: no rung fits on each surface.", *_common(run, result)])
    yield from tables


def _budgets(run: Run, result: Budgets, materials: Sequence[str], kind: str) -> Iterator[Table]:
    ranked = {budget: result.ranked(budget, materials) for budget in result.limits}
    means = {line: [lines.get(line) for lines in ranked.values()] for by_line in ranked.values() for line in by_line}
    if not means:
        return
    order = sorted(means, key=lambda line: [-(value or 0.0) for value in reversed(means[line][: len(BITS)])])
    many = [*ranked] if len(materials) >= FEWEST else []
    told = {(line, i) for i, each in enumerate(many) for line in result.told_apart(run, each, materials)}
    start = "*:" if told else "None is"
    notes = [f"{start} told apart from {AGAINST}, by Holm's correction over the column."] if many else []
    rows = [
        [line, *(_number(value) + "*" * ((line, i) in told) for i, value in enumerate(means[line]))] for line in order
    ]
    shapes = {tuple(result.surfaces[name]["shape"]) for name in materials}
    headers = [("codec", ""), *(_header(budget, shapes) for budget in ranked)]
    surfaces = f"{len(materials)} {kind}surface{'s' * (len(materials) > 1)}"
    title = f"Budgets on {surfaces} ({', '.join(materials)}): test PSNR, dB"
    yield Table("budgets", title, headers, rows, notes, marks=best_cells(rows, [[None, *means[of]] for of in order]))


def _header(budget: Budget, shapes: set[tuple[int, int]]) -> tuple[str, str]:
    """A budget; one of bytes with the size of the file, if all surfaces have one shape."""
    if budget.kind != BYTES:
        return f"{budget.most:g} {_unit(budget.kind)}", budget.kind
    if len(shapes) > 1:
        return f"{budget.most:g} bits", "a texel"
    ((height, width),) = shapes
    return f"{budget.most:g} bits", f"{significant(budget.most * height * width / 8000, 2)} kB"


def rung_tables(run: Run) -> Iterator[Table]:
    """The rungs that were chosen on each material, with their budgets and quality; first their means."""
    result = budgets(run)
    at = ("at bits, times" if result.times else "at bits a texel", "")
    notes = [_CHOICE, *_common(run, result)]
    if len(result.surfaces) > 1 and (rows := list(_mean_rows(result))):
        title = f"Means over {len(result.surfaces)} materials of the rung of each budget"
        yield Table("rungs", title, [("codec", ""), at, ("total", "bytes"), *_METRICS], rows, notes, words=2)
    headers = [("codec", ""), ("rung", ""), at, ("total", "bytes"), ("validation", "dB"), *_METRICS]
    headers += [(kind, _unit(kind)) for kind in result.times]
    for material in result.surfaces:
        title = f"{material}: the rung of each budget"
        rows = list(_rung_rows(result, material))
        yield Table("rungs", title, headers, rows, notes, words=3, material=material)


def _mean_rows(result: Budgets) -> Iterator[list[str]]:
    """Bytes, PSNR, SSIM and FLIP of each codec, means over the materials; budgets of equal numbers share a row."""
    at: dict[str, dict[tuple[str, ...], list[Budget]]] = {}
    for budget in result.limits:
        for line, rungs in result.picks(budget, result.surfaces).items():
            size = integer(round(fmean(mean_bytes(rung.of) for rung in rungs.values())))
            means = (_number(average([shown(rung, of) for rung in rungs.values()]), of) for of in _DIGITS)
            at.setdefault(line, {}).setdefault((size, *means), []).append(budget)
    yield from ([line, _span(of), *numbers] for line, by_numbers in at.items() for numbers, of in by_numbers.items())


def _rung_rows(result: Budgets, material: str) -> Iterator[list[str]]:
    """A row for each rung that was chosen on a material; those of a line follow each other."""
    at: dict[str, dict[str, tuple[Rung, list[Budget]]]] = {}  # by line and first job
    for budget in result.limits:
        for line, rungs in result.picks(budget, [material]).items():
            rung = rungs[material]
            at.setdefault(line, {}).setdefault(rung.of[0]["job"], (rung, []))[1].append(budget)
    for line, by_job in at.items():
        for name, (rung, budgets_of) in by_job.items():
            numbers = [integer(mean_bytes(rung.of)), _number(rung.score)]
            numbers += [_number(shown(rung, family), family) for family in _DIGITS]
            times = [significant(of_kind.get(name)) for of_kind in result.times.values()]
            yield [line, setting_of(rung.of[0]), _span(budgets_of), *numbers, *times]


def _span(at: list[Budget]) -> str:
    """Budgets in words, budgets of bytes as a range: 32–128, 8 × eager."""
    bits = [f"{each.most:g}" for each in at if each.kind == BYTES]
    ends = "–".join(dict.fromkeys([*bits[:1], *bits[-1:]]))
    times = [f"{each.most:g} {'s' if each.kind == FIT else '×'} {each.kind}" for each in at if each.kind != BYTES]
    return ", ".join(filter(None, [ends, *times]))


def when_table(run: Run) -> Iterator[Table]:
    """Which codec when: a question a row, its answer with numbers, and the next best."""
    rows = []
    for question, ranked, family in _questions(budgets(run)):
        numbers = [f"{_number(value, family)}{' dB' * (family == PSNR)}" for value in ranked.values()]
        rows += [[question, *[*ranked, NONE][:2], *[*numbers, NONE][:2]]] if ranked else []
    headers = [("question", ""), ("best", ""), ("then", ""), ("best", ""), ("then", "")]
    if rows:
        yield Table("when", "Which codec when", headers, rows, [_CHOICE], words=3)


def _questions(result: Budgets) -> Iterator[tuple[str, dict[str, float], str]]:
    """Each question, the codecs that answer it with their numbers, the best first, and the metric."""
    enough = in_words(ENOUGH)
    for budget in result.limits:
        yield f"best quality in {in_words(budget)}", result.ranked(budget, result.surfaces), PSNR
    if fewest := result.fewest_bytes():
        yield f"fewest bytes within {NEAR_DB:g} dB of the best: {in_words(fewest[0])}", fewest[1], PSNR
    if len(result.surfaces) > 1:
        for material in result.surfaces:
            yield f"best on {material} in {enough}", result.ranked(ENOUGH, [material]), PSNR
    for family, name in ((SSIM, "SSIM"), (FLIP, "FLIP")):
        yield f"best {name} in {enough}", result.ranked(ENOUGH, result.surfaces, family), family


def ranks_table(run: Run) -> Iterator[Table]:
    """The mean rank of each line at a budget, and the lines that are not told apart from it."""
    result = budgets(run)
    if not (ranking := result.ranks()):
        return
    rows = []
    for line, rank in ranking.mean.items():
        near = [other for other, its in ranking.mean.items() if other != line and abs(its - rank) < ranking.critical]
        rows.append([line, fixed(rank, 2), ", ".join(near) or NONE])
    title = f"Mean ranks over {len(result.surfaces)} surfaces at {in_words(ENOUGH)}"
    note = f"Nemenyi's critical difference: {ranking.critical:.2f}. Only lines with a rung on each surface are ranked."
    yield Table("ranks", title, [("codec", ""), ("mean rank", "↓"), ("not told apart from", "")], rows, [note, _CHOICE])


def front_table(run: Run) -> Iterator[Table]:
    """Each codec at `FRONT`: decoder, file, time, and quality by kind of surface, all as means over surfaces."""
    result = budgets(run)
    kinds = grouped(result.surfaces, lambda material: kind_of(result.surfaces[material]))
    kinds = {kind: kinds[kind] for kind in KINDS if kind in kinds} | {"all": list(result.surfaces)}
    ranked = {kind: result.ranked(FRONT, surfaces) for kind, surfaces in kinds.items()}
    picks = [result.picks(FRONT, surfaces) for surfaces in kinds.values()]
    rows: list[list[str]] = []
    scores: list[list[float | None]] = []
    for line in dict.fromkeys(line for lines in reversed(ranked.values()) for line in lines):
        rungs = list({name: rung.of for lines in picks for name, rung in lines.get(line, {}).items()}.values())
        parameters, size = (round(fmean(map(of, rungs))) for of in (lambda jobs: jobs[0]["parameters"], mean_bytes))
        times = [time for jobs in rungs if (time := result.times.get(EAGER, {}).get(jobs[0]["job"]))]
        quality = [_number(lines.get(line)) for lines in ranked.values()]
        time = fmean(times) if times else None
        rows.append([line, integer(parameters), integer(size), *quality, significant(time)])
        means = [lines.get(line) for lines in ranked.values()]
        scores.append([None, None, -size, *means, None if time is None else -time])
    surfaces = [(f"{kind}, {len(many)}", "dB ↑") for kind, many in kinds.items()]
    headers = [("codec", ""), ("decoder", "param."), ("total", "bytes ↓"), *surfaces, ("time", "× floor ↓")]
    if rows:
        title = f"Within {in_words(FRONT)}: test PSNR, means over {', '.join(result.surfaces)}"
        yield Table("front", title, headers, rows, [_CHOICE, *_common(run, result)], marks=best_cells(rows, scores))


TABLES = {
    "front": front_table,
    "budgets": budgets_table,
    "when": when_table,
    "rungs": rung_tables,
    "ranks": ranks_table,
}


def _number(value: float | None, family: str = PSNR) -> str:
    return EXACT if value is not None and value >= MOST_DB else fixed(value, _DIGITS[family])


def in_words(budget: Budget) -> str:
    """A budget in words: 64 bits a texel; 8 × floor, eager; 10 s, fit."""
    return f"{budget.most:g} " + ("bits a texel" if budget.kind == BYTES else f"{_unit(budget.kind)}, {budget.kind}")


def _unit(kind: str) -> str:
    return "s" if kind == FIT else "× floor"


def _common(run: Run, result: Budgets) -> Iterator[str]:
    """Notes on times, and on excluded records."""
    if result.times.keys() - {FIT}:
        on: dict[str, None] = {}
        of_settings = [time for time in run.timings if "label" in time]
        for name in (time.get("run", "") for time in of_settings or run.timings):
            start: Record = next((each for each in reversed(run.starts) if not name or each.get("run") == name), {})
            machine = start.get("machine", {})
            parts = [machine.get("processor"), f"{machine['cores']} cores" if "cores" in machine else ""]
            on[", ".join(str(part) for part in parts if part)] = None
        yield f"Times: upper ends of 95 % intervals, × floor, one bilinear fetch; {'; '.join(filter(None, on))}."
    unlike = f"not comparable with {beside(run)}"
    reasons = {"without a score of validation pairs": result.without, unlike: result.unlike}
    suites = {start.get("run"): str(start.get("suite") or "no suite") for start in run.starts}
    left = []
    for why, jobs in ((why, jobs) for why, jobs in reasons.items() if jobs):
        counts = Counter(suites.get(job.get("run"), "no suite") for job in jobs)
        counted = ", ".join(f"{count} of {suite}" for suite, count in counts.items())
        named = ""
        if why == unlike:
            rows = list(dict.fromkeys(f"{job['material']}/{shown_label(job)}" for job in jobs))
            named = f" ({', '.join(rows[:_NAMED])}{', …' * (len(rows) > _NAMED)})"
        left.append(f"{counted}{named}, {why}")
    if left:
        yield f"Left out: {'; '.join(left)}."
