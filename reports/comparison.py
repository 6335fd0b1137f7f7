"""A comparison of two runs, base and new, as tables: for a terminal of 120 columns, and as GitHub Markdown.

The numbers of a row are means over seeds. A *change* is a quantity's values in base and new, with the margin up to
which they count as the same. Those that decide give the row its *verdict* (same, better, WORSE, GONE). A *finding* is a
sentence on one change that matters. *Advice* is a sentence on a change of the time of a query, which decides nothing.
`bench.compare` makes all of these; here they are only written.
"""

import shlex
from collections.abc import Callable, Iterable, Sequence
from itertools import chain

from bench.compare.comparison import Comparison
from bench.compare.quantities import MAIN, Quantity
from bench.compare.rows import ABSENT, ComparedRow
from bench.compare.verdicts import Change, Verdict
from bench.records import grouped
from reports.numbers import NONE, NOT_COMPARABLE
from reports.table import Table
from reports.text import escaped, plain, wrapped
from reports.text import markdown as in_markdown

# The emoji of verdicts in Markdown; all others, which fail the comparison, have a ❌.
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
_MANY = 3  # so many rows that the new run never had stand in one line, instead of a line each
# What a reader can do about a row with the verdict `UNLIKE`, "not comparable".
_UNLIKE = (
    "n/c: not comparable; this fails like a regression: update the reference in the same change (docs/ci.md), or name "
    "the row with --allow."
)


def terminal(comparison: Comparison) -> str:
    """The whole comparison as text: tables, then findings, a legend, and the summary; without a trailing line break.

    Each material has a table of the quantities that decide and one of all others; a table of means over materials
    follows.
    """
    # Many rows that the new run never had are one line, so that they do not hide the rows that it has.
    absent = [row for row in comparison.rows if row.why == ABSENT]
    listed = list(comparison.rows)
    findings = []
    if len(absent) >= _MANY:
        listed = [row for row in listed if row.why != ABSENT]
        findings.append(_absent_line(absent, listed))

    tables = []
    for material, rows in grouped(listed, lambda row: row.material).items():
        tables += [_deciding_table(material, rows), *_undeciding_tables(material, rows)]
    if comparison.means:
        title = comparison.means[0].material  # in place of a material all of them say "all materials"
        tables.append(_deciding_table(title, comparison.means))

    # A line for each finding, each note and each advice. The first word is 7 wide, so that texts stand below each
    # other.
    for row in (*listed, *comparison.means):
        findings += [f"{_word(verdict):<7} {row.name}: {text}" for verdict, text in row.findings()]
        findings += [f"{_word(row.verdict):<7} {row.name}: {note}" for note in row.notes]
    findings += [f"advice  {row.name}: {row.advice}" for row in comparison.rows if row.advice]

    remarks = "\n".join(wrapped(text, break_on_hyphens=False) for text in findings)
    legend = "\n".join(wrapped(text, break_on_hyphens=False) for text in _legend(comparison))
    blocks = [plain(tables), remarks, legend, comparison.summary]
    return "\n\n".join(block for block in blocks if block)


def _legend(comparison: Comparison) -> list[str]:
    """Texts on what the words and numbers of the tables mean, only those that these tables need, then its notes."""
    legend = []
    if any(row.deciding for row in comparison.rows):
        legend.append(_LEGEND)
    if comparison.means:
        legend.append(_MEANS)
    if comparison.having(Verdict.UNLIKE):
        legend.append(_UNLIKE)
    for note in comparison.notes:
        legend.append(f"{note[:1].upper()}{note[1:]}.")  # as a sentence
    return legend


def _absent_line(absent: Sequence[ComparedRow], present: Sequence[ComparedRow]) -> str:
    """One line on the rows that the new run never had, and the options of the command that compare what it has or,
    where these would choose an absent row, too, that accept what is gone.

    `present` are all other rows.
    """
    materials = dict.fromkeys(row.material for row in present)
    codecs = dict.fromkeys(row.method for row in present)
    options = [f"--material {shlex.quote(name)}" for name in materials]
    options += [f"--codec {shlex.quote(name)}" for name in codecs]
    if any(row.material in materials and row.method in codecs for row in absent):
        options = [f"--allow {shlex.quote(label)}" for label in dict.fromkeys(row.label for row in absent)]
    remedy = f"; to compare what is there: {' '.join(options)}" if options else ""
    return f"{Verdict.GONE:<7} {len(absent)} rows: {ABSENT}{remedy}"  # as wide as the verdicts of other lines


def markdown(comparison: Comparison) -> str:
    """The comparison as Markdown: the summary, findings, the tables of verdicts, and everything else folded away."""
    remarks = []
    for row in (*comparison.rows, *comparison.means):
        findings = [(_MARKS[verdict], text) for verdict, text in row.findings()]
        findings += [("ℹ️ note", text) for text in row.notes]
        if row.advice:
            findings.append(("⏱️ advice", row.advice))
        remarks += [f"- {mark}: **{escaped(row.name)}**: {escaped(text)}" for mark, text in findings]

    deciding = []
    others = []
    for material, rows in grouped(comparison.rows, lambda row: row.material).items():
        deciding.append(_deciding_table(material, rows, _MARKS.__getitem__))
        others += _undeciding_tables(material, rows)
    if comparison.means:
        deciding.append(_deciding_table(comparison.means[0].material, comparison.means, _MARKS.__getitem__))
    blocks = [f"### neubtf-bench: {comparison.summary}", "\n".join(remarks), in_markdown(deciding).strip()]
    if others:
        # The empty line lets GitHub read the tables inside the HTML as Markdown.
        blocks += [f"<details><summary>Everything else</summary>\n\n{in_markdown(others)}</details>"]
    blocks += map(escaped, _legend(comparison))
    return "\n\n".join(block for block in blocks if block) + "\n"


def _word(verdict: Verdict) -> str:
    """A verdict as one short word of a table: "n/c" for "not comparable"."""
    return NOT_COMPARABLE if verdict == Verdict.UNLIKE else verdict


def _deciding_table(material: str, rows: Sequence[ComparedRow], word: Callable[[Verdict], str] = _word) -> Table:
    """The table of the quantities that decide, a row a codec; `material` is its title, `word` writes a verdict.

    A metric has a column of its change and margin; PSNR has one of its value, too. A size, which is no metric, has one
    column of value and change. The last column is the verdict.
    """
    quantities = _quantities(row.deciding for row in rows)
    headers = [("codec", "")]
    for quantity in quantities:
        if quantity.name == MAIN:
            headers.append((quantity.name, quantity.scale))
        headers.append((quantity.name, "±" if quantity.metric else quantity.scale))
    lines = []
    for row in rows:
        line = [row.label]
        for quantity in quantities:
            line += _deciding_cells(quantity, _change_of(quantity, row.deciding))
        lines.append([*line, word(row.verdict)])
    return Table("compare", material, [*headers, ("verdict", "")], lines)


def _deciding_cells(quantity: Quantity, change: Change | None) -> list[str]:
    """The cells of a change: two for PSNR, by which codecs are ranked, and one for any other quantity.

    PSNR has its value in the new run, then the change with its margin; another metric has the change with its margin
    alone; a size, such as bytes, its value and the change. None: the row has no such quantity, so its cells are dashes.
    """
    with_value = quantity.name == MAIN
    if change is None:
        return [NONE, NONE] if with_value else [NONE]
    value = quantity.written(change.new)
    if change.verdict == Verdict.UNLIKE:
        return [value, NOT_COMPARABLE] if with_value else [f"{value} ({NOT_COMPARABLE})"]
    difference = change.difference or 0.0  # None if neither run measured the quantity, so that nothing changed
    text = quantity.difference(difference)
    if not quantity.metric:  # a size, such as bytes
        return [f"{value} ({text})" if quantity.shows(difference) else value]
    with_margin = f"{text} ± {quantity.written(change.margin)}"
    return [value, with_margin] if with_value else [with_margin]


def _undeciding_tables(material: str, rows: Sequence[ComparedRow]) -> list[Table]:
    """A list of one table, or of none where there is nothing to show: the values of a material that do not decide.

    Their changes are new − base; the last column has the times of queries in both runs.
    """
    with_changes = [row for row in rows if row.shown]
    all_changes = list(chain.from_iterable(row.shown for row in with_changes))
    # A quantity that is the same in both runs in all rows needs no column.
    changed_names = {change.quantity.name for change in all_changes if _difference_cell(change) != "="}
    quantities = [quantity for quantity in _quantities([all_changes]) if quantity.name in changed_names]
    if not quantities and not any(row.timing for row in with_changes):
        return []
    headers = [("change of", "")]
    headers += [(quantity.name.replace("_", " "), quantity.scale) for quantity in quantities]
    cells = []
    for row in with_changes:
        differences = [_difference_cell(_change_of(quantity, row.shown)) for quantity in quantities]
        cells.append([row.label, *differences, _time_cell(row)])
    title = f"{material}: everything else"
    return [Table("compare", title, [*headers, ("time", "× floor")], cells)]


def _difference_cell(change: Change | None) -> str:
    """The difference of a change as text, “=” if it rounds to 0; a dash if there is no change or it has no number, and
    `n/c` if it is not comparable."""
    if change is None or change.difference is None:
        return NONE
    if change.verdict == Verdict.UNLIKE:
        return NOT_COMPARABLE
    return change.quantity.difference(change.difference)


def _time_cell(row: ComparedRow) -> str:
    """The mean times of a query in both runs, as multiples of the floor's: "2.10 → 2.05".

    A dash if a run has no time, or they cannot be compared.
    """
    if row.timing is None:
        return NONE
    return f"{row.timing.base.mean:.2f} → {row.timing.new.mean:.2f}"


def _quantities(changes_of_rows: Iterable[Sequence[Change]]) -> list[Quantity]:
    """The quantities of the changes of some rows, each name once, in the order of first appearance."""
    by_name = {change.quantity.name: change.quantity for change in chain.from_iterable(changes_of_rows)}
    return list(by_name.values())


def _change_of(quantity: Quantity, changes: Sequence[Change]) -> Change | None:
    """The change of a quantity, by its name; None if it is not among them."""
    return next((change for change in changes if change.quantity.name == quantity.name), None)
