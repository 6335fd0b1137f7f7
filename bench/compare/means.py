"""Averages the rows of a comparison: each codec over its materials, and all codecs together.

Fits scatter independently, so their mean scatters less: it can show a loss that no single row can tell from chance.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

from bench.compare.rows import ComparedRow, worst
from bench.compare.verdicts import DECIDED, Chance, Change, Verdict, verdict
from bench.records import grouped


def means(rows: Sequence[ComparedRow]) -> list[ComparedRow]:
    """A mean row for each codec with several rows, and one for all codecs; none for fewer than two rows."""
    codecs = grouped(rows, lambda row: row.label.split()[0])
    by_codec = [_mean(name, several, False) for name, several in codecs.items()]
    return [row for row in (*by_codec, _mean("all codecs", list(rows), True)) if row]


def _mean(label: str, rows: list[ComparedRow], every: bool) -> ComparedRow | None:
    changes: dict[str, list[Change]] = {}
    for change in (change for row in rows for change in row.deciding):
        numbers = [value for value in (change.base, change.new) if value is not None and math.isfinite(value)]
        if change.quantity.metric and change.verdict in DECIDED and len(numbers) == 2:
            changes.setdefault(change.quantity.name, []).append(change)
    merged = [_merged(each, every) for each in changes.values() if len(each) > 1]
    return ComparedRow("all materials", label, worst(merged), deciding=merged) if merged else None


def _merged(changes: list[Change], every: bool) -> Change:
    """The mean change of one quantity over some rows, weighted by their variances, and the margin of that mean."""
    quantity, tolerance = changes[0].quantity, changes[0].quantity.tolerance
    assert tolerance is not None, "a deciding quantity has a tolerance"
    # The inverse of each variance is best if all rows lose alike; `common` is a lower bound of the standard errors.
    inverse = [1 / ((each.chance.error if each.chance else 0.0) ** 2 + tolerance.common**2) for each in changes]
    weights = [each / math.fsum(inverse) for each in inverse]
    chance = _together(changes, weights)
    least = tolerance.common if every else tolerance.drawn if chance else tolerance.certain
    room = max(least, chance.margin(tolerance) if chance else 0.0)
    base, new = (
        math.fsum(weight * getattr(change, side) for weight, change in zip(weights, changes, strict=True))
        for side in ("base", "new")
    )
    whole = Change(quantity, base, new, Verdict.SHOWN)
    return replace(whole, verdict=verdict(whole.loss, room), margin=room, chance=chance)


def _together(changes: list[Change], weights: list[float]) -> Chance | None:
    """The scatter of a weighted mean of differences, by Welch and Satterthwaite; None if no difference scatters.

    A row that by chance scatters little in its seeds weighs more. So the plain sum of variances is too small; it is
    corrected after Meier, "Variance of a weighted mean", Biometrics 9(1), 1953.
    """
    parts = [(w, c.chance.error, c.chance.freedom) for w, c in zip(weights, changes, strict=True) if c.chance]
    squares = [(weight * error) ** 2 for weight, error, _ in parts]
    total = math.fsum(squares)
    if not total:
        return None
    freedom = total**2 / math.fsum(square**2 / free for square, (*_, free) in zip(squares, parts, strict=True))
    chosen = 1 + 4 * math.fsum(weight * (1 - weight) / free for weight, _, free in parts)
    return Chance(math.sqrt(total * chosen), freedom)
