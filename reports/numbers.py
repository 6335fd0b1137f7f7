"""How numbers are written in tables. None is never a number: it is exact, not applicable, or not there."""

from typing import Any

NONE, EXACT, NOT_APPLICABLE, NOT_COMPARABLE = "—", "exact", "n/a", "n/c"


def integer(value: int | None) -> str:
    """With separators: 15,375,476."""
    return NONE if value is None else f"{value:,}"


def fixed(value: float | None, digits: int) -> str:
    """With that many decimals."""
    return NONE if value is None else f"{value:,.{digits}f}"


def significant(value: float | None, digits: int = 3) -> str:
    """About that many digits, without an exponent for what tables hold: 0.00123, 12.3, 1,230."""
    if value is None:
        return NONE
    if value == 0 or not 1e-5 <= abs(value) < 1e7:
        return f"{value:.{digits - 1}e}" if value else "0"
    decimals = digits - 1 - _exponent(value)
    return f"{value:,.{max(0, decimals)}f}"


def _exponent(value: float) -> int:
    return int(f"{abs(value):e}".rpartition("e")[2])


def pooled(stats: dict[str, Any], digits: int) -> str:
    """The pooled number of a metric's statistics; `exact` where no slice has an error, `n/a` where none applies."""
    if not stats:
        return NONE
    if stats["pooled"] is not None:
        return fixed(stats["pooled"], digits)
    return _without(stats)


def spread(stats: dict[str, Any], digits: int) -> str:
    """Mean ± standard deviation over slices."""
    if not stats:
        return NONE
    if stats["mean"] is not None:
        return f"{fixed(stats['mean'], digits)} ± {fixed(stats['std'], digits)}"
    return _without(stats)


def _without(stats: dict[str, Any]) -> str:
    return EXACT if stats["exact"] and stats["exact"] == stats["slices"] else NOT_APPLICABLE
