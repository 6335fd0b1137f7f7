"""Rows of means over the rows of a comparison: each codec over its materials, and all codecs together.

Fits scatter, each by itself, so their mean scatters less: what no single row can tell from chance may show here.
"""

import math
from collections.abc import Sequence
from statistics import fmean

from bench.compare.quantities import Quantity
from bench.compare.rows import ORDER, Row
from bench.compare.verdicts import Chance, Change, Verdict, verdict

OVER = "all materials"
EVERY = "all codecs"
_DECIDED = (Verdict.SAME, Verdict.BETTER, Verdict.WORSE)


def means(rows: Sequence[Row]) -> list[Row]:
    """A row for each codec that has several rows, and one of all; none where there are fewer than two."""
    codecs: dict[str, list[Row]] = {}
    for row in rows:
        codecs.setdefault(row.label.split()[0], []).append(row)
    found = [_mean(name, several, False) for name, several in codecs.items()]
    return [row for row in (*found, _mean(EVERY, list(rows), True)) if row]


def _mean(label: str, rows: list[Row], every: bool) -> Row | None:
    changes: dict[str, list[Change]] = {}
    for change in (change for row in rows for change in row.deciding):
        numbers = [value for value in (change.base, change.new) if value is not None and math.isfinite(value)]
        if change.quantity.metric and change.verdict in _DECIDED and len(numbers) == 2:
            changes.setdefault(change.quantity.name, []).append(change)
    merged = [_merged(each, every) for each in changes.values() if len(each) > 1]
    if not merged:
        return None
    return Row(OVER, label, next(v for v in ORDER if any(c.verdict == v for c in merged)), deciding=merged)


def _merged(changes: list[Change], every: bool) -> Change:
    """The mean change of one quantity over some rows, and the margin of that mean."""
    quantity: Quantity = changes[0].quantity
    chance = _together([change.chance for change in changes if change.chance], len(changes))
    tolerance = quantity.tolerance
    assert tolerance is not None, "what decides has a tolerance"
    least = tolerance.common if every else tolerance.drawn if chance else tolerance.certain
    room = max(least, chance.margin if chance else 0.0)
    base, new = (fmean([getattr(change, side) for change in changes]) for side in ("base", "new"))
    whole = Change(quantity, base, new, Verdict.SHOWN)
    return Change(quantity, base, new, verdict(whole.loss, room), room, chance=chance)


def _together(chances: list[Chance], count: int) -> Chance | None:
    """How the mean of `count` differences scatters, of which some do, by Welch and Satterthwaite."""
    squares = [chance.error**2 for chance in chances]
    if not any(squares):
        return None
    total = math.fsum(squares)
    freedom = total**2 / math.fsum(s**2 / chance.freedom for s, chance in zip(squares, chances, strict=True))
    return Chance(math.sqrt(total) / count, freedom)
