"""The description of a metric: what a record and a table need to know of it, without importing what computes it.

Importing takes long, and a metric of another package may fail.
"""

import importlib
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from bench.inputs.plugins import naming

if TYPE_CHECKING:
    from bench.metrics.base import SliceMetric

PERIODIC = "_periodic"


@dataclass(frozen=True)
class Metric:
    """The description of a metric, available without importing it.

    `direction` is "higher" or "lower", whichever is better; `space` is the space in which pictures are compared. A
    change of `version` makes older records not comparable. `target` is "module:Class"; `options` go to its constructor.
    `label` is its name in tables. Nothing follows from the words of `name` and `unit`: what a table or a record does
    differently for some metrics, a field says.
    """

    name: str
    unit: str
    direction: Literal["higher", "lower"]
    space: str
    version: int
    target: str
    label: str = ""
    default: bool = False  # whether it is measured if a suite chooses no metrics
    periodic: bool = False  # whether `name` + "_periodic" exists; in a variant, whether it is that variant
    options: dict[str, Any] = field(default_factory=dict, hash=False)
    family: str = ""  # metrics of which a table shows one, such as FLIP at several distances; "": its name
    decibels: bool = False  # a PSNR: two digits, "exact" for no error, and a record of the mean of the worst tenth
    relative: bool = False  # an error of radiance: also recorded over the mean radiance; it has a table of its own
    called: str = ""  # of a metric of another package: its name in errors, with the package; the registry sets it

    def load(self) -> "SliceMetric":
        """Import the metric and make it. `PluginError` if it is of another package and that fails."""
        from bench.metrics.base import as_metric

        with self.asked("import or constructor"):
            module, _, name = self.target.partition(":")
            return as_metric(getattr(importlib.import_module(module), name)(**self.options))

    def asked(self, method: str) -> AbstractContextManager[None]:
        """The context in which a method of the metric is called: whatever one of another package raises there becomes
        a `PluginError` that names the metric, its package and the method."""
        return naming(f"{self.called} fails in {method}") if self.called else nullcontext()
