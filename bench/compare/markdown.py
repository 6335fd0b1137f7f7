"""A comparison as GitHub Markdown: for the summary of a job, or a comment on a pull request."""

import re
from collections.abc import Iterable, Iterator

from bench.compare import Comparison
from bench.compare.rows import Row
from bench.compare.terminal import advised, summary
from bench.compare.verdicts import Change, Verdict

_MARKS = {
    Verdict.FAILED: "❌ failed",
    Verdict.GONE: "❌ gone",
    Verdict.WORSE: "❌ worse",
    Verdict.UNLIKE: "➖ not comparable",
    Verdict.BETTER: "✅ better",
    Verdict.SAME: "✅ same",
    Verdict.NEW: "🆕 new",
}


def markdown(comparison: Comparison) -> str:
    """The sum, what to look at, the table of verdicts, and everything else folded away."""
    blocks = [f"### neubtf-bench: {summary(comparison)}", "\n".join(_findings(comparison))]
    if comparison.rows:
        blocks.append("\n".join(_table(comparison)))
    if any(row.shown for row in comparison.rows):
        blocks.append("<details><summary>Everything else</summary>\n\n" + "\n".join(_others(comparison)))
        blocks.append("</details>")
    blocks += [_escaped(note) for note in comparison.notes]
    return "\n\n".join(block for block in blocks if block) + "\n"


def _findings(comparison: Comparison) -> Iterator[str]:
    for row in comparison.rows:
        texts = row.reasons() if row.verdict not in (Verdict.SAME, Verdict.NEW) else []
        findings = [(_MARKS[row.verdict], text) for text in texts] + [("ℹ️ note", text) for text in row.notes]
        findings += [("⏱️ advice", advised(row))] if advised(row) else []
        yield from (f"- {mark}: **{_escaped(row.name)}**: {_escaped(text)}" for mark, text in findings)


def _table(comparison: Comparison) -> Iterator[str]:
    names = _headers(change for row in comparison.rows for change in row.deciding)
    yield from _head(["material", "codec", *names.values(), "verdict"], 2)
    for row in comparison.rows:
        cells = [_cell(_named(row.deciding, name)) for name in names]
        yield _line([row.material, row.label, *cells, _MARKS[row.verdict]])


def _others(comparison: Comparison) -> Iterator[str]:
    rows = [row for row in comparison.rows if row.shown]
    names = _headers(change for row in rows for change in row.shown)
    yield from _head(["material", "codec", *names.values(), "time, × mean-colour"], 2)
    for row in rows:
        yield _line([row.material, row.label, *(_cell(_named(row.shown, name)) for name in names), _time(row)])


def _headers(changes: Iterable[Change]) -> dict[str, str]:
    """Headers with unit and an arrow to the better end, by the name of the quantity."""
    found = {change.quantity.name: change.quantity for change in changes}
    return {n: f"{n.replace('_', ' ')}{', ' if q.unit else ' '}{q.scale}" for n, q in found.items()}


def _named(changes: list[Change], name: str) -> Change | None:
    return next((change for change in changes if change.quantity.name == name), None)


def _cell(change: Change | None) -> str:
    if change is None:
        return "—"
    quantity, text = change.quantity, change.quantity.written(change.new)
    if change.verdict == Verdict.UNLIKE:
        return f"{text} (not comparable)"
    difference = quantity.difference(change.difference or 0.0)
    text += f" ({difference})" * (difference != "=")
    text += f", ± {quantity.written(change.margin)}" if change.margin else ""
    return f"**{text}**" if change.verdict in (Verdict.WORSE, Verdict.BETTER) else text


def _time(row: Row) -> str:
    return f"{row.timing.base:.2f} → {row.timing.new:.2f}" if row.timing else "—"


def _head(names: list[str], words: int) -> Iterator[str]:
    yield _line(names)
    yield "| " + " | ".join("---" if i < words else "---:" for i in range(len(names))) + " |"


def _line(cells: list[str]) -> str:
    return "| " + " | ".join(cell if cell.startswith("**") else _escaped(cell) for cell in cells) + " |"


def _escaped(text: str) -> str:
    """Text that Markdown shows as it stands, on one line."""
    return re.sub(r"[\\`*|<\[#~]|(?<!\w)_|_(?!\w)", r"\\\g<0>", " ".join(text.split()))
