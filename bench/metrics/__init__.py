"""The registry of metrics: one line per metric; a metric is imported on first use.

A metric's name fixes everything that its number depends on. Two parts of a name are variables:

- `{ppd}ppd`, the pixels per degree at which FLIP looks: `flip_ldr_67ppd`, `flip_ldr_20ppd`. 67 stands for the
  published default viewing condition, 67.0206; every other number is meant exactly.
- the ending `_periodic`: the filters wrap around the picture instead of meeting a border, which is right only for
  a material that repeats.

docs/metrics.md says how to add a metric: a class derived from `bench.metrics.base.SliceMetric`, and one line below.
"""

import importlib
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from bench.inputs.errors import InputError, did_you_mean

if TYPE_CHECKING:
    from bench.metrics.base import SliceMetric

PERIODIC = "_periodic"


@dataclass(frozen=True)
class Metric:
    """The description of a metric, available without importing it.

    `direction` is "higher" or "lower", whichever is better; `space` is the space in which pictures are compared. A
    change of `version` makes older records not comparable. `target` is "module:Class"; `options` go to its constructor.
    `label` is its name in tables.
    """

    name: str
    unit: str
    direction: str
    space: str
    version: int
    target: str
    label: str = ""
    default: bool = False  # whether it is measured if a suite chooses no metrics
    periodic: bool = False  # whether `name` + "_periodic" exists; in a variant, whether it is that variant
    options: dict[str, Any] = field(default_factory=dict, hash=False)

    def load(self) -> "SliceMetric":
        """Import the metric and make it."""
        module, _, name = self.target.partition(":")
        instance: SliceMetric = getattr(importlib.import_module(module), name)(**self.options)
        return instance


def _flip(name: str, space: str, target: str, label: str, default: bool = False) -> Metric:
    return Metric(name, "1", "lower", space, 1, target, label, default, periodic=True)


# A name may hold `{ppd}`, and `periodic` says whether that variant exists.
REGISTERED = (
    Metric("psnr_display", "dB", "higher", "display", 2, "bench.metrics.psnr:DisplayPSNR", "PSNR", default=True),
    Metric("psnr_log1p", "dB", "higher", "log1p", 2, "bench.metrics.psnr:LogPSNR", "log PSNR", default=True),
    Metric("rmse_linear", "radiance", "lower", "linear", 1, "bench.metrics.psnr:LinearRMSE", "RMSE", default=True),
    Metric("ssim", "1", "higher", "display luma", 1, "bench.metrics.ssim:SSIM", "SSIM", default=True, periodic=True),
    _flip("flip_ldr_{ppd}ppd", "display", "bench.metrics.flip:LDR", "FLIP", default=True),
    _flip("flip_hdr_{ppd}ppd", "HDR, ACES", "bench.metrics.flip:HDR", "HDR FLIP"),
    _flip("flip_hdr_hable_{ppd}ppd", "HDR, Hable", "bench.metrics.flip:Hable", "HDR FLIP, Hable"),
    _flip("flip_hdr_reinhard_{ppd}ppd", "HDR, Reinhard", "bench.metrics.flip:Reinhard", "HDR FLIP, Reinhard"),
)
# The default metrics, as a suite names them: without the periodic ending.
DEFAULTS = tuple(metric.name.replace("{ppd}", "67") for metric in REGISTERED if metric.default)


def get(name: str) -> Metric:
    """The metric of that name, with every variable part filled in. `InputError` names the nearest if there is none."""
    metric, variable = _found(name)
    ppd, periodic = variable.get("ppd"), bool(variable.get("ending"))
    options: dict[str, Any] = {"ppd": float(ppd)} if ppd and ppd != "67" else {}  # the class knows the exact default
    options |= {"periodic": True} if periodic else {}
    return replace(metric, name=name, periodic=periodic, options=options)


def _found(name: str) -> tuple[Metric, dict[str, str | None]]:
    """The registered metric that a name belongs to, and the variable parts of the name, `ppd` and `ending`."""
    for metric in REGISTERED:
        pattern = re.escape(metric.name).replace(re.escape("{ppd}"), r"(?P<ppd>[1-9]\d{0,3}(?:\.\d*[1-9])?)")
        if match := re.fullmatch(pattern + f"(?P<ending>{PERIODIC})?" * metric.periodic, name):
            return metric, match.groupdict()
    raise InputError(f"no metric is named {name!r}{did_you_mean(name, examples())}")


def chosen_names(names: Sequence[str], periodic: bool) -> tuple[str, ...]:
    """The metrics of a suite for a material: the periodic variants if the material repeats. `psnr_display`, the main
    metric, comes first, named or not. `InputError` for an unknown name."""
    plain = [REGISTERED[0].name, *(name.removesuffix(PERIODIC) for name in names)]
    ending = {name: PERIODIC if _found(name)[0].periodic and periodic else "" for name in plain}
    return tuple(f"{name}{end}" for name, end in ending.items())


def label_of(name: str) -> str:
    """The name of a metric in tables; an unknown name, as in an older record, is returned unchanged."""
    try:
        ppd, label = get(name).options.get("ppd"), _found(name)[0].label
    except InputError:
        return name.replace("_", " ")
    return (label or name.replace("_", " ")) + (f" {ppd:g}ppd" if ppd else "")


def examples() -> list[str]:
    """Every metric of the registry at its usual distance, then the periodic variants."""
    plain = [metric.name.replace("{ppd}", "67") for metric in REGISTERED]
    return plain + [name + PERIODIC for name, metric in zip(plain, REGISTERED, strict=True) if metric.periodic]
