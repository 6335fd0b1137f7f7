"""Formats numbers for tables.

A cell without a number says why: “exact” (no slice has an error, so that a PSNR is infinite), `n/a` (the metric does
not apply), `n/c` (it must not be compared) or, for anything that is missing, a dash.
"""

from math import isfinite
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bench.compare.paired import Interval

NONE, EXACT, NOT_APPLICABLE, NOT_COMPARABLE = "—", "exact", "n/a", "n/c"


def integer(value: int | None) -> str:
    """An integer with separators: 15,375,476."""
    return NONE if value is None else f"{value:,}"


def fixed(value: float | None, digits: int) -> str:
    """A number with `digits` decimals and with separators: 1,234.50, −0.04."""
    return NONE if value is None else f"{value:,.{digits}f}".replace("-", "−")


def significant(value: float | None, digits: int = 3) -> str:
    """A finite number with `digits` significant digits, and all before its point: 0.00123, 12.3, 1,230, 12,346.

    Below 0.00001 and from 10,000,000 on it has an exponent, 1.23e+07; None is a dash.
    """
    if value is None:
        return NONE
    if value == 0:
        return "0"
    if not 1e-5 <= abs(value) < 1e7:
        return f"{value:.{digits - 1}e}"
    return f"{value:,.{_decimals(value, digits)}f}"


def _decimals(value: float, digits: int) -> int:
    """The decimals with which a finite number has so many significant digits: at least 0 below 10,000,000, where
    `significant` writes all digits before the point."""
    exponent = int(f"{value:.{digits - 1}e}".rpartition("e")[2])  # of ten, after rounding: 9.996 to 3 digits is 1e1
    return digits - 1 - exponent if abs(value) >= 1e7 else max(0, digits - 1 - exponent)


def as_read(value: float, digits: int) -> float:
    """A number as it reads with `digits` decimals or, of −n, as `significant` with n digits, so that what reads the
    same counts as the same."""
    if not isfinite(value):
        return value
    return round(float(value), digits if digits >= 0 else _decimals(value, -digits))


def signed(difference: float, digits: int = 2) -> str:
    """A number with a sign and `digits` decimals: +0.31, −1.50; its minus is as wide as the plus."""
    return f"{difference:+.{digits}f}".replace("-", "−")


def interval(delta: "Interval") -> str:
    """A mean difference with its 95 % interval, and a star if the codecs are told apart: −1.50 (−1.62 to −1.41) *."""
    mark = " *" if delta.apart else ""
    return f"{signed(delta.mean)} ({signed(delta.low)} to {signed(delta.high)}){mark}"
