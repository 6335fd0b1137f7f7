"""Metrics of other packages, by entry point: `neubtf_bench.metrics`, name → "module:OBJECT", a `Metric`.

They are imported when a suite or a record names one that is not built in.
"""

import re
from collections.abc import Collection
from dataclasses import replace
from functools import cache
from importlib.metadata import EntryPoint

from bench.inputs import plugins
from bench.inputs.plugins import PluginError
from bench.metrics.description import PERIODIC, Metric

GROUP, KIND = "neubtf_bench.metrics", "metric"


@cache  # tables ask for every cell
def entries() -> dict[str, EntryPoint]:
    """The entry points of metrics by name. `InputError` if two packages use the same name."""
    return plugins.entries(GROUP, KIND)


def metric_of_entry(entry: EntryPoint, families: Collection[str]) -> Metric:
    """Import the description of a metric. `families` are those of the built-in metrics, which it may not join.

    Raises `PluginError` that names the package, if the description cannot be imported or used.
    """
    described = _imported_or_error(entry)
    if isinstance(described, PluginError):
        raise described
    called = plugins.called(entry, KIND)
    if not isinstance(described, Metric):
        fault = f"{entry.value} is a {type(described).__name__}: it must be a bench.metrics.Metric"
        raise PluginError(f"{called}: {fault}")
    fault = _fault(described, entry, families)
    if fault:
        raise PluginError(f"{called}: {fault}")
    return replace(described, called=called)


@cache  # a package that cannot be imported is tried once
def _imported_or_error(entry: EntryPoint) -> object:
    """The object of an entry point, whatever it is, or the error of its import, so that both are remembered."""
    try:
        return plugins.imported(entry, KIND)
    except PluginError as error:
        return error


def _fault(described: Metric, entry: EntryPoint, families: Collection[str]) -> str:
    """What is wrong with the description of a metric, and the remedy; "" if nothing is."""
    if described.name != entry.name:
        return f"it calls itself {described.name!r}: write {entry.name!r} as the name of its Metric"
    if not re.fullmatch("[a-z][a-z0-9_]*", described.name) or described.name.endswith(PERIODIC):
        return f"its name must have small letters, digits and underscores, and not end with {PERIODIC}: rename it"
    words = (described.unit, described.space, described.label, described.family, described.target)
    if not all(isinstance(word, str) and word.isprintable() for word in words):
        return "its unit, space, label, family and target must be words on one line"
    if described.direction not in ("higher", "lower"):
        return f"its direction is {described.direction!r}: write 'higher' or 'lower', whichever is better"
    if type(described.version) is not int or described.version < 1:
        return f"its version is {described.version!r}: write 1, and raise it when its numbers change"
    if described.default:
        return "only built-in metrics are measured by default: leave out default=True"
    if described.family in families:
        return f"the family {described.family!r} is that of a built-in metric: choose another"
    return ""
