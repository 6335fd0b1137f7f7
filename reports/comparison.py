"""A comparison of two runs as tables: for a terminal of 120 columns, and as GitHub Markdown."""

import shlex
import textwrap
from collections.abc import Iterable, Sequence
from itertools import chain

from bench.compare.comparison import Comparison
from bench.compare.quantities import Quantity
from bench.compare.rows import ABSENT, ComparedRow
from bench.compare.verdicts import Change, Verdict
from bench.inputs.errors import visible
from reports.numbers import NONE, NOT_COMPARABLE
from reports.table import BOLD, Table
from reports.text import WIDTH, escaped, grid, plain

_LOOKS = {Verdict.UNLIKE: "➖", Verdict.BETTER: "✅", Verdict.SAME: "✅", Verdict.NEW: "🆕"}
_MARKS = {verdict: f"{_LOOKS.get(verdict, '❌')} {verdict.lower()}" for verdict in Verdict}
_LEGEND = (
    "Change ± margin, of held-out pairs; train: of training pairs; grazing: of slices seen or lit beyond 60°. A change "
    "within its margin counts as the same: a small tolerance if seeds agree; else chance exceeds it once in 1,000 "
    "times (PSNR) or 4,000 times (other numbers), so it is the smallest loss that these seeds can reveal."
)
_MEANS = (
    "All materials: values are plain means of rows; a change is a weighted mean, in which rows that scatter more count "
    "less."
)
_MANY = 3  # rows that the run never had: so many are one line
_UNLIKE = (
    "n/c: not comparable; this fails like a regression: update the reference in the same change (docs/ci.md), or name "
    "the row with --allow."
)


def terminal(comparison: Comparison) -> str:
    """The whole comparison: deciding rows, all others, remarks, and the summary; without a trailing line break."""
    absent = [row for row in comparison.rows if row.why == ABSENT]
    present = [row for row in comparison.rows if len(absent) < _MANY or row not in absent]
    tables = []
    for material in dict.fromkeys(row.material for row in present):
        rows = [row for row in present if row.material == material]
        tables += [_deciding(material, rows), *_others(material, rows)]
    tables += [_deciding(comparison.means[0].material, comparison.means)] if comparison.means else []
    every = [*present, *comparison.means]
    findings = [_wrapped(_partial(absent, present))] if len(absent) >= _MANY else []
    findings += [
        _wrapped(f"{_word(verdict):<7} {row.name}: {text}")
        for row in every
        for verdict, text in (*row.findings(), *((row.verdict, note) for note in row.notes))
    ]
    findings += [_wrapped(f"advice  {row.name}: {row.advice}") for row in comparison.rows if row.advice]
    legend = [_LEGEND] if any(row.deciding for row in comparison.rows) else []
    legend += [_MEANS] if comparison.means else []
    legend += [_UNLIKE] if comparison.having(Verdict.UNLIKE) else []
    legend += [note[:1].upper() + note[1:] + "." for note in comparison.notes]
    blocks = [plain(tables), "\n".join(findings), "\n".join(map(_wrapped, legend)), comparison.summary]
    return "\n\n".join(block for block in blocks if block)


def _partial(absent: Sequence[ComparedRow], present: Sequence[ComparedRow]) -> str:
    """One line on rows that the run never had, and the options that compare what it has."""
    names = (("material", [row.material for row in present]), ("codec", [row.label.split()[0] for row in present]))
    options = " ".join(f"--{word} {shlex.quote(name)}" for word, found in names for name in dict.fromkeys(found))
    remedy = f"; to compare what is there: {options}" if options else ""
    return f"{Verdict.GONE}    {len(absent)} rows: {ABSENT}{remedy}"


def markdown(comparison: Comparison) -> str:
    """The summary, remarks, the table of verdicts, and everything else folded away."""
    every, remarks = [*comparison.rows, *comparison.means], []
    for row in every:
        findings = [(_MARKS[verdict], text) for verdict, text in row.findings()]
        findings += [("ℹ️ note", text) for text in row.notes]
        findings += [("⏱️ advice", row.advice)] if row.advice else []
        remarks += [f"- {mark}: **{escaped(row.name)}**: {escaped(text)}" for mark, text in findings]
    blocks = [f"### neubtf-bench: {comparison.summary}", "\n".join(remarks)]
    if comparison.rows:
        verdicts = [_MARKS[row.verdict] for row in every]
        blocks.append(grid(_combined(every, [row.deciding for row in every], "verdict", verdicts)))
    if rows := [row for row in comparison.rows if row.shown]:
        rest = grid(_combined(rows, [row.shown for row in rows], "time, × mean-colour", list(map(_time, rows))))
        blocks += [f"<details><summary>Everything else</summary>\n\n{rest}", "</details>"]
    blocks += [escaped(note) for note in comparison.notes]
    return "\n\n".join(block for block in blocks if block) + "\n"


def _word(verdict: Verdict) -> str:
    return NOT_COMPARABLE if verdict == Verdict.UNLIKE else verdict


def _deciding(material: str, rows: Sequence[ComparedRow]) -> Table:
    """The table of the deciding metrics: PSNR itself, and the change and margin of each metric."""
    quantities = _quantities(row.deciding for row in rows)
    headers = [("codec", "")]
    for quantity in quantities:
        headers += [(quantity.name, quantity.scale)] if quantity.name == "PSNR" else []
        headers += [(quantity.name, "±") if quantity.metric else (quantity.name, quantity.scale)]
    cells = [
        [row.label, *(cell for q in quantities for cell in _cells(q, _find(row.deciding, q))), _word(row.verdict)]
        for row in rows
    ]
    return Table("compare", material, [*headers, ("verdict", "")], cells)


def _cells(quantity: Quantity, change: Change | None) -> list[str]:
    first = quantity.name == "PSNR"
    if change is None:
        return [NONE] * (1 + first)
    value = quantity.written(change.new)
    if change.verdict == Verdict.UNLIKE:
        return [value, NOT_COMPARABLE] if first else [f"{value} ({NOT_COMPARABLE})"]
    text = quantity.difference(change.difference or 0.0)
    if not quantity.metric:
        return [value if text == "=" else f"{value} ({text})"]
    return [value] * first + [f"{text} ± {quantity.written(change.margin)}"]


def _others(material: str, rows: Sequence[ComparedRow]) -> list[Table]:
    """The table of values that do not decide: changes, new − base, and times; None if there are none."""
    rows = [row for row in rows if row.shown]

    every = [change for row in rows for change in row.shown]
    changed = {c.quantity.name for c in every if c.difference is None or c.quantity.difference(c.difference) != "="}
    quantities = [quantity for quantity in _quantities([every]) if quantity.name in changed]
    if not quantities and not any(row.timing for row in rows):
        return []
    headers = [("change of", ""), *((q.name.replace("_", " "), q.scale) for q in quantities)]
    cells = []
    for row in rows:
        changes = [_find(row.shown, quantity) for quantity in quantities]
        line = [c.quantity.difference(c.difference) if c and c.difference is not None else NONE for c in changes]
        cells.append([row.label, *line, _time(row)])
    title = f"{material}: everything else"
    return [Table("compare", title, [*headers, ("time", "× mean-colour")], cells)]


def _combined(rows: Sequence[ComparedRow], by_row: Sequence[list[Change]], name: str, last: list[str]) -> Table:
    """Value, change and margin of each quantity in one cell, bold where it decides against or for the row."""
    quantities, cells = _quantities(by_row), []
    marks: dict[tuple[int, int], str] = {}
    for i, row in enumerate(rows):
        changes = [_find(by_row[i], quantity) for quantity in quantities]
        cells.append([row.material, row.label, *map(_cell, changes), last[i]])
        decided = (Verdict.WORSE, Verdict.BETTER)
        marks |= {(i, j): BOLD for j, change in enumerate(changes, 2) if change and change.verdict in decided}
    headers = [(f"{q.name.replace('_', ' ')}{',' if q.unit else ''}", q.scale) for q in quantities]
    return Table("compare", "", [("material", ""), ("codec", ""), *headers, (name, "")], cells, words=2, marks=marks)


def _cell(change: Change | None) -> str:
    if change is None:
        return NONE
    quantity, text = change.quantity, change.quantity.written(change.new)
    if change.verdict == Verdict.UNLIKE:
        return f"{text} (not comparable)"
    difference = quantity.difference(change.difference or 0.0)
    text += f" ({difference})" * (difference != "=")
    return text + (f", ± {quantity.written(change.margin)}" if change.margin else "")


def _time(row: ComparedRow) -> str:
    return f"{row.timing.base.mean:.2f} → {row.timing.new.mean:.2f}" if row.timing else NONE


def _quantities(by_row: Iterable[Sequence[Change]]) -> list[Quantity]:
    """The quantities of the changes of some rows, each name once, in the order of first appearance."""
    return list({change.quantity.name: change.quantity for change in chain.from_iterable(by_row)}.values())


def _find(changes: Sequence[Change], quantity: Quantity) -> Change | None:
    return next((change for change in changes if change.quantity.name == quantity.name), None)


def _wrapped(text: str) -> str:
    return textwrap.fill(visible(text), WIDTH, subsequent_indent="  ", break_on_hyphens=False)
