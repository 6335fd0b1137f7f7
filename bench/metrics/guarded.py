"""A metric of another package, watched: what it raises, or returns wrongly, is one line that names it."""

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from bench.btf import Array
from bench.inputs.errors import said_by
from bench.inputs.plugins import PluginError
from bench.metrics.base import Picture, SliceMetric

Answer = TypeVar("Answer")


def guarded(make: Callable[[], SliceMetric], called: str) -> "Guarded":
    """Make a metric of another package, and watch it. `called` is its name in errors."""
    metric = _asked(called, "cannot be made", make)
    if not isinstance(metric, SliceMetric):
        fault = f"is a {type(metric).__name__}"
        raise PluginError(f"{called} {fault}: derive its class from bench.metrics.base.SliceMetric")
    return Guarded(metric, called)


def _asked(called: str, fails: str, function: Callable[..., Answer], *given: Any) -> Answer:
    """What a function of the metric answers; what it raises becomes a `PluginError`: `called`, `fails`, its words."""
    try:
        return function(*given)
    except MemoryError:  # no fault of the metric's author
        raise
    except (Exception, SystemExit) as error:
        raise PluginError(f"{called} {fails}: {said_by(error)}") from error


class Guarded(SliceMetric):
    """Asks a metric of another package, and checks its answers. Every method raises `PluginError` for a wrong one."""

    def __init__(self, metric: SliceMetric, called: str):
        """`called` names the metric and its package in errors."""
        self.metric = metric
        self.called = called
        self.perfect = metric.perfect
        self.smallest = metric.smallest
        self.per_material = metric.per_material

    @property
    def module(self) -> str:
        return self.metric.module

    def for_material(self, sample: Array) -> "Guarded":
        return guarded(lambda: self._answer("for_material", sample), self.called)

    def fixed(self) -> dict[str, float]:
        """The metric's constants, which must be finite numbers by name."""
        constants: dict[str, float] = self._answer("fixed")
        if not isinstance(constants, dict) or not all(_is_finite(value) for value in constants.values()):
            raise self._wrong("fixed", "finite numbers by name", constants)
        return constants

    def reference_side(self, reference: Picture) -> Any:
        """The metric's side, which must be an array or a tuple of arrays: others could not be kept."""
        side = self._answer("reference_side", reference)
        if not _is_side(side):
            raise self._wrong("reference_side", "an array, or a tuple of arrays", side)
        return side

    def compare(self, side: Any, test: Picture) -> Array:
        """The metric's map, which must be finite and of the shape of its pictures, apart from their border."""
        differences: Array = self._answer("compare", side, test)
        if not _is_map(differences, test.shape):
            raise self._wrong("compare", f"a map of numbers of shape {test.shape}", differences)
        if not np.isfinite(differences).all():
            count = f"{int((~np.isfinite(differences)).sum())} of {differences.size}"
            raise PluginError(f"{self.called}: compare returned {count} values that are not finite")
        return differences

    def values(self, raw: Array) -> Array:
        """The metric's numbers, one for each raw number."""
        numbers: Array = self._answer("values", raw)
        if np.shape(numbers) != np.shape(raw) or not _are_numbers(numbers):
            raise self._wrong("values", f"numbers of shape {np.shape(raw)}", numbers)
        return numbers

    def pool(self, raw: Array) -> float:
        """The metric's one number for several slices."""
        number = self._answer("pool", raw)
        if np.shape(number) != () or not _are_numbers(number):
            raise self._wrong("pool", "one number", number)
        return float(number)

    def _answer(self, method: str, *arguments: Any) -> Any:
        """What a method of the metric answers; `PluginError` for whatever it raises."""
        return _asked(self.called, f"fails in {method}", getattr(self.metric, method), *arguments)

    def _wrong(self, method: str, due: str, answer: Any) -> PluginError:
        """The error, to be raised, of a method that returned an answer other than is `due`."""
        if isinstance(answer, np.ndarray):
            what = f"an array of shape {answer.shape}"
        else:
            what = f"a {type(answer).__name__}"
        if isinstance(answer, np.ndarray | float) and not _are_numbers(answer):
            what += " with NaN"
        return PluginError(f"{self.called}: {method} returned {what}, but must return {due}")


def _is_side(side: Any) -> bool:
    """Whether the scorer can keep a reference side and count its bytes: arrays, however their tuples nest."""
    return isinstance(side, np.ndarray) or (isinstance(side, tuple) and all(map(_is_side, side)))


def _is_map(differences: Any, shape: tuple[int, ...]) -> bool:
    """Whether a map has the slices of its pictures; a metric with a window may leave out their border."""
    if not isinstance(differences, np.ndarray) or differences.dtype.kind not in "fiu" or differences.ndim != len(shape):
        return False
    height, width = shape[-2:]
    rows, columns = differences.shape[-2:]
    fits = 0 < rows <= height and 0 < columns <= width
    return fits and differences.shape[:-2] == shape[:-2]


def _are_numbers(values: Any) -> bool:
    """Whether there is a number everywhere. It may be infinite: a record holds no number then."""
    numbers = np.asarray(values)
    return numbers.dtype.kind in "fiu" and not np.isnan(numbers).any()


def _is_finite(value: Any) -> bool:
    """Whether a value is one finite number."""
    return np.shape(value) == () and _are_numbers(value) and bool(np.isfinite(value))
