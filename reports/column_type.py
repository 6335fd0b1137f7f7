"""One column of a table of codecs: finds its number in a record, and writes one seed or several."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import fmean, stdev
from typing import Any

from bench.records import Record
from reports.numbers import EXACT, NONE
from reports.rows import Row

Value = float | tuple[float, ...] | str | None  # a number, several numbers of one cell, a word, or nothing


def elementwise(several: Sequence[tuple[float, ...]]) -> tuple[float, ...]:
    """The mean of each element of several tuples, such as (mean, deviation over slices)."""
    return tuple(map(fmean, zip(*several, strict=True)))


def hull(several: Sequence[tuple[float, ...]]) -> tuple[float, ...]:
    """The interval that contains all of them."""
    return min(low for low, _ in several), max(high for _, high in several)


@dataclass(frozen=True)
class Column:
    """A column: its name, its unit with an arrow to the better end, and its number for a measured row.

    `value` finds the number and `write` formats it. If it is a tuple, `pool` combines those of several seeds into one.
    `native` fills the cell of the measured data's own file, from any record of the material. A `sparse` column is left
    out if no row has a number for it. A `starred` number has a star, and is never the best.
    """

    name: str
    unit: str
    value: Callable[[Row], Value]
    write: Callable[[Any], str]
    native: Callable[[Record], str] | None = None
    sparse: bool = False
    pool: Callable[[Sequence[tuple[float, ...]]], tuple[float, ...]] = elementwise
    starred: Callable[[Row], bool] = lambda row: False  # whether its number was measured apart from those of other rows
    deviation: bool = True  # whether to show the deviation over seeds beside their mean
    over: str = "seeds"  # what the deviation of a cell is over, which its header says

    def cell(self, seeds: Sequence[Row]) -> str:
        """The text of one codec's cell: the number if its seeds agree, else mean ± std over them."""
        return f"{self._text(seeds)}{self.star(seeds)}"

    def star(self, seeds: Sequence[Row]) -> str:
        """A star if a number of these seeds is starred."""
        return "*" if any(self.starred(row) and self.value(row) is not None for row in seeds) else ""

    def _text(self, seeds: Sequence[Row]) -> str:
        values = [self.value(row) for row in seeds]
        texts = [self._written(value) for value in values]
        if len(set(texts)) < 2:
            return texts[0] if texts else NONE
        if together := [value for value in values if isinstance(value, tuple)]:
            return self.write(self.pool(together))
        numbers = [value for value in values if isinstance(value, int | float)]
        if not numbers:
            return texts[0]
        if len(numbers) == 1 or not self.deviation:  # a single number: other seeds are exact or were not measured
            return self.write(fmean(numbers))
        return f"{self.write(fmean(numbers))} ± {self.write(stdev(numbers))}"

    @property
    def sign(self) -> int:
        """1 if more is better, −1 if less is, 0 if neither."""
        return 1 if "↑" in self.unit else -1 if "↓" in self.unit else 0

    def mean(self, seeds: Sequence[Row]) -> float | None:
        """The mean over seeds of the number, or of the first number of a tuple; None if there is none."""
        values = [self.value(row) for row in seeds]
        firsts = [value[0] if isinstance(value, tuple) else value for value in values]
        numbers = [value for value in firsts if isinstance(value, int | float)]
        return fmean(numbers) if numbers else None

    def score(self, seeds: Sequence[Row]) -> float | None:
        """How good the cell is, more is better; None if it is not a number, or if no end of the scale is better."""
        if not self.sign or not seeds or self.star(seeds):
            return None
        if all(self.value(row) == EXACT for row in seeds):
            return float("inf")
        mean = self.mean(seeds)
        return None if mean is None else self.sign * mean

    def _written(self, value: Value) -> str:
        if value is None:
            return NONE
        return value if isinstance(value, str) else self.write(value)
