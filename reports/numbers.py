"""Formats numbers for tables, and reads them from the statistics of a record.

A cell without a number says why: “exact” (no slice, that is no picture of the material at a pair of directions, has an
error, so that a PSNR is infinite), `n/a` (the metric does not apply), `n/c` (it must not be compared) or, for anything
that is missing, a dash.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bench.compare.paired import Interval
    from bench.records import Statistics

NONE, EXACT, NOT_APPLICABLE, NOT_COMPARABLE = "—", "exact", "n/a", "n/c"


def integer(value: int | None) -> str:
    """An integer with separators: 15,375,476."""
    return NONE if value is None else f"{value:,}"


def fixed(value: float | None, digits: int) -> str:
    """A number with `digits` decimals and with separators: 1,234.50."""
    return NONE if value is None else f"{value:,.{digits}f}"


def significant(value: float | None, digits: int = 3) -> str:
    """A number with `digits` significant digits, and all of those before its point: 0.00123, 12.3, 1,230, 12,346.

    Below 0.00001 and from 10,000,000 on it has an exponent, 1.23e+07; None is a dash.
    """
    if value is None:
        return NONE
    if value == 0:
        return "0"
    if not 1e-5 <= abs(value) < 1e7:
        return f"{value:.{digits - 1}e}"
    exponent = int(f"{value:e}".rpartition("e")[2])  # of ten, after rounding: 9.9999999 is 1e1
    decimals = max(0, digits - 1 - exponent)
    return f"{value:,.{decimals}f}"


def stated(stats: "Statistics", *names: str) -> Any:
    """The number that a metric's statistics over slices hold under a name, such as `mean`; for several names a tuple.

    The tuple has the numbers in the order of the names, without those that are missing, such as the std of one slice.
    In place of a number: `EXACT` if no slice has an error, `NOT_APPLICABLE` if none of the names has a number, None
    without statistics.
    """
    if not stats:
        return None
    if stats.get("exact") and stats["exact"] == stats.get("slices"):  # both are counts of slices
        return EXACT
    numbers = tuple(stats[name] for name in names if stats.get(name) is not None)
    if not numbers:
        return NOT_APPLICABLE
    return numbers if len(names) > 1 else numbers[0]


def plus_minus(numbers: tuple[float, ...], digits: int) -> str:
    """Of (mean, standard deviation): mean ± deviation. Of a mean alone: the mean."""
    return " ± ".join(fixed(number, digits) for number in numbers)


def signed(difference: float, digits: int = 2) -> str:
    """A number with a sign and `digits` decimals: +0.31, −1.50; its minus is as wide as the plus."""
    return f"{difference:+.{digits}f}".replace("-", "−")


def interval(delta: "Interval") -> str:
    """A mean difference with its 95 % interval, and a star if the codecs are told apart: −1.50 (−1.62 to −1.41) *."""
    mark = " *" if delta.apart else ""
    return f"{signed(delta.mean)} ({signed(delta.low)} to {signed(delta.high)}){mark}"
