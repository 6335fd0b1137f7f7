"""A metric of another package: what it raises becomes a line that names it, and costs the job that asked it."""

from collections.abc import Callable
from typing import Any

import numpy as np

from bench.btf import Array
from bench.inputs.errors import said_by
from bench.inputs.plugins import PluginError
from bench.metrics.base import Picture, SliceMetric


def guarded(make: Callable[[], SliceMetric], called: str) -> "Guarded":
    """Make a metric of another package. `called` names it in errors. `PluginError` if it cannot be made."""
    metric: Guarded = _answer_of(called, "cannot be made", lambda: Guarded(make(), called))
    return metric


def _answer_of(called: str, fails: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """What a function of the metric answers; a `PluginError` says `called`, `fails`, and what it raised."""
    try:
        return function(*arguments)
    except (Exception, SystemExit) as error:
        raise PluginError(f"{called} {fails}: {said_by(error)}") from error


class Guarded(SliceMetric):
    """Asks a metric of another package. Every method raises `PluginError` for what the metric raises."""

    def __init__(self, metric: SliceMetric, called: str):
        """`called` names the metric and its package in errors."""
        self.metric = metric
        self.called = called
        self.perfect = metric.perfect
        self.smallest = metric.smallest
        self.per_material = metric.per_material

    @property
    def title(self) -> str:
        return self.called

    @property
    def module(self) -> str:
        return self.metric.module

    def for_material(self, sample: Array) -> "Guarded":
        return guarded(lambda: self.metric.for_material(sample), self.called)

    def fixed(self) -> dict[str, float]:
        constants: dict[str, float] = self._answer("fixed")
        return constants

    def reference_side(self, reference: Picture) -> Any:
        return self._answer("reference_side", reference)

    def compare(self, side: Any, test: Picture) -> Array:
        """The metric's map, which must be finite: a NaN would count as a slice that the metric does not apply to."""
        differences: Array = self._answer("compare", side, test)
        shape = np.shape(differences)
        if len(shape) < 2 or shape[:-2] != test.shape[:-2]:
            raise PluginError(f"{self.called}: compare returned {shape}, not a map (..., H, W) of {test.shape}")
        if not np.isfinite(differences).all():
            raise PluginError(f"{self.called}: compare returned values that are not finite")
        return differences

    def values(self, raw: Array) -> Array:
        numbers: Array = self._answer("values", raw)
        return numbers

    def pool(self, raw: Array) -> float:
        number: float = _answer_of(self.called, "fails in pool", lambda: float(self.metric.pool(raw)))
        return number

    def _answer(self, method: str, *arguments: Any) -> Any:
        """What a method of the metric answers; `PluginError` for whatever it raises."""
        return _answer_of(self.called, f"fails in {method}", getattr(self.metric, method), *arguments)
