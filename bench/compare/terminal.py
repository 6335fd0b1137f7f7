"""A comparison for a terminal of 120 columns: what decides, everything else, what to look at, and the sum."""

import textwrap
from collections.abc import Sequence

from bench.compare import Comparison
from bench.compare.quantities import Quantity
from bench.compare.rows import Row
from bench.compare.verdicts import Change, Verdict

WIDTH = 120
_LABEL = 22  # columns of a codec's name, which is folded


def terminal(comparison: Comparison) -> str:
    """The whole of it, without a trailing line break."""
    blocks = []
    for material in dict.fromkeys(row.material for row in comparison.rows):
        rows = [row for row in comparison.rows if row.material == material]
        blocks += [f"{material}\n\n{_table(*_deciding(rows))}", _table(*_others(rows))]
    blocks += ["\n".join(_findings(comparison)), "\n".join(map(_wrapped, _legend(comparison)))]
    return "\n\n".join(block for block in [*blocks, summary(comparison)] if block)


def summary(comparison: Comparison) -> str:
    """One line: how many rows, and what became of them."""
    counted = [(len(comparison.having(verdict)), word) for verdict, word in _WORDS.items()]
    return f"{len(comparison.rows)} rows: " + (", ".join(f"{n} {word}" for n, word in counted if n) or "nothing there")


def advised(row: Row) -> str:
    """A change of decoding time that is worth a look, in words; "" where there is none."""
    if not row.timing or not row.timing.words:
        return ""
    times = f"{row.timing.base:.2f} → {row.timing.new:.2f} × mean-colour"
    return f"decodes {row.timing.words}, {times} (times advise only)"


_WORDS = {
    Verdict.FAILED: "failed",
    Verdict.GONE: "gone",
    Verdict.WORSE: "worse",
    Verdict.UNLIKE: "not comparable",
    Verdict.BETTER: "better",
    Verdict.SAME: "same",
    Verdict.NEW: "new",
}


def _deciding(rows: Sequence[Row]) -> tuple[list[tuple[str, ...]], list[list[str]]]:
    """Headers and cells of what the verdicts are made of."""
    quantities = _all(rows, "deciding")
    headers: list[tuple[str, ...]] = [("codec", "")]
    for quantity in quantities:
        headers.append((quantity.name, quantity.scale))
        if quantity.metric:
            headers += [("change", ""), ("margin", "±")]
    cells = []
    for row in rows:
        line = [row.label]
        for quantity in quantities:
            line += _cells(quantity, _find(row.deciding, quantity))
        cells.append([*line, "n/c" if row.verdict == Verdict.UNLIKE else row.verdict])
    return [*headers, ("verdict", "")], cells


def _cells(quantity: Quantity, change: Change | None) -> list[str]:
    if change is None:
        return ["—", "", ""] if quantity.metric else ["—"]
    value = quantity.written(change.new)
    if change.verdict == Verdict.UNLIKE:
        return [value, "n/c", ""] if quantity.metric else [f"{value} (n/c)"]
    text = quantity.difference(change.difference or 0.0)
    if not quantity.metric:
        return [value if text == "=" else f"{value} ({text})"]
    return [value, text, quantity.written(change.margin)]


def _others(rows: Sequence[Row]) -> tuple[list[tuple[str, ...]], list[list[str]]]:
    """Headers and cells of what is only shown: changes, new − base, and times."""
    rows = [row for row in rows if row.shown]
    quantities = [quantity for quantity in _all(rows, "shown") if any(_changed(row, quantity) for row in rows)]
    headers = [("change of", ""), *((*_split(quantity.name), quantity.scale) for quantity in quantities)]
    cells = []
    for row in rows:
        found = [_find(row.shown, quantity) for quantity in quantities]
        line = [c.quantity.difference(c.difference) if c and c.difference is not None else "—" for c in found]
        cells.append([row.label, *line, *_times(row)])
    if not quantities and not any(row.timing for row in rows):
        return [], []
    return [*headers, ("time, ×", "mean-colour")], cells


def _changed(row: Row, quantity: Quantity) -> bool:
    change = _find(row.shown, quantity)
    return change is not None and (change.difference is None or quantity.difference(change.difference) != "=")


def _times(row: Row) -> list[str]:
    if row.timing is None:
        return ["—"]
    return [f"{row.timing.base:.2f} → {row.timing.new:.2f}"]


def _findings(comparison: Comparison) -> list[str]:
    lines = []
    for row in comparison.rows:
        word = "n/c" if row.verdict == Verdict.UNLIKE else row.verdict
        texts = row.reasons() if row.verdict not in (Verdict.SAME, Verdict.NEW) else []
        texts += row.notes
        lines += [_wrapped(f"{word:<7} {row.name}: {text}") for text in texts]
        lines += [_wrapped(f"advice  {row.name}: {text}") for text in [advised(row)] if text]
    return lines


def _legend(comparison: Comparison) -> list[str]:
    legend = []
    if any(row.deciding for row in comparison.rows):
        legend.append(
            "Means over the seeds that both have; PSNR and FLIP of held-out pairs. A change within its margin is the "
            "same: a small tolerance where seeds agree, else at least three standard deviations of the difference."
        )
    if comparison.having(Verdict.UNLIKE):
        legend.append("n/c: not comparable, and no regression; a new reference makes it comparable again.")
    return [*legend, *(note[:1].upper() + note[1:] + "." for note in comparison.notes)]


def _all(rows: Sequence[Row], which: str) -> list[Quantity]:
    """The quantities of some rows by name, in the order of first appearance."""
    found: dict[str, Quantity] = {}
    for row in rows:
        for change in getattr(row, which):
            found.setdefault(change.quantity.name, change.quantity)
    return list(found.values())


def _find(changes: Sequence[Change], quantity: Quantity) -> Change | None:
    return next((change for change in changes if change.quantity.name == quantity.name), None)


def _split(name: str) -> tuple[str, ...]:
    return tuple(textwrap.wrap(name.replace("_", " "), 9))


def _table(headers: Sequence[tuple[str, ...]], rows: Sequence[Sequence[str]]) -> str:
    """Columns aligned: the first and the last left, the others right."""
    if not rows:
        return ""
    height = max(map(len, headers))
    head = [list(line) for line in zip(*(("",) * (height - len(h)) + tuple(h) for h in headers), strict=True)]
    body = [line for row in rows for line in _folded(row)]
    widths = [max(map(len, column)) for column in zip(*head, *body, strict=True)]
    lines = [*head, ["-" * width for width in widths], *body]
    return "\n".join(_line(line, widths) for line in lines)


def _folded(row: Sequence[str]) -> list[list[str]]:
    """The lines of one row: a long label is folded."""
    label = textwrap.wrap(row[0], _LABEL) or [""]
    return [[label[0], *row[1:]], *([more] + [""] * (len(row) - 1) for more in label[1:])]


def _line(cells: Sequence[str], widths: Sequence[int]) -> str:
    first, *middle, last = cells
    padded = [f"{cell:>{width}}" for cell, width in zip(middle, widths[1:-1], strict=True)]
    return "  ".join([f"{first:<{widths[0]}}", *padded, f"{last:<{widths[-1]}}"]).rstrip()


def _wrapped(text: str) -> str:
    return textwrap.fill(text, WIDTH, subsequent_indent="  ", break_on_hyphens=False)
