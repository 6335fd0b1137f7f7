"""The registry of metrics: one line per metric; a metric is imported on first use.

A metric's name fixes everything that its number depends on. Two parts of a name are variables:

- `{ppd}ppd`, the pixels per degree at which FLIP looks: `flip_ldr_67ppd`, `flip_ldr_20ppd`. 67 stands for the
  published default viewing condition, 67.0206; every other number is meant exactly.
- the ending `_periodic`: the filters wrap around the picture instead of meeting a border, which is right only for
  a material that repeats.

docs/metrics.md says how to add a metric: a class derived from `bench.metrics.base.SliceMetric`, and one line below; or
both in another package, which an entry point names (`bench.metrics.outside`).
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from statistics import fmean
from typing import Any

from bench.inputs.errors import InputError, did_you_mean
from bench.inputs.plugins import PluginError, called, remedy
from bench.metrics import outside
from bench.metrics.description import PERIODIC, Metric
from bench.records import (
    FLIP,
    LOW_LIGHT,
    OUTSIDE,
    PSNR,
    RMSE,
    SCENE_HELDOUT,
    SSIM,
    VALIDATION,
    Group,
    Job,
    Statistics,
    deciding_group,
    metrics_of,
)


def _flip(kind: str, space: str, target: str, label: str, default: bool = False) -> Metric:
    """The description of a FLIP, whose name holds its kind and the distance at which it looks."""
    family = f"flip_{kind}"
    return Metric(f"{family}_{{ppd}}ppd", "1", "lower", space, 1, target, label, default, periodic=True, family=family)


def _psnr(space: str, target: str, label: str) -> Metric:
    """The description of a PSNR in one space."""
    return Metric(f"psnr_{space}", "dB", "higher", space, 3, target, label, default=True, decibels=True)


# Name, unit, which end is better, space, version, class, label: the fields of `Metric`, in their order. A name may hold
# `{ppd}`, and `periodic` says whether that variant exists.
REGISTERED = (
    _psnr("display", "bench.metrics.psnr:DisplayPSNR", "PSNR"),
    _psnr("log1p", "bench.metrics.psnr:LogPSNR", "log PSNR"),
    Metric(
        "rmse_linear", "radiance", "lower", "linear", 1, "bench.metrics.psnr:LinearRMSE", "RMSE", True, relative=True
    ),
    Metric("ssim", "1", "higher", "display luma", 1, "bench.metrics.ssim:SSIM", "SSIM", default=True, periodic=True),
    _flip("ldr", "display", "bench.metrics.flip:LDR", "FLIP", default=True),
    _flip("hdr", "HDR, ACES", "bench.metrics.flip:HDR", "HDR FLIP"),
    _flip("hdr_hable", "HDR, Hable", "bench.metrics.flip:Hable", "HDR FLIP, Hable"),
    _flip("hdr_reinhard", "HDR, Reinhard", "bench.metrics.flip:Reinhard", "HDR FLIP, Reinhard"),
)
# The default metrics, as a suite names them: without the periodic ending.
DEFAULTS = tuple(metric.name.replace("{ppd}", "67") for metric in REGISTERED if metric.default)


def get(name: str) -> Metric:
    """The metric of that name, with every variable part filled in.

    `InputError` names the nearest if there is none; `PluginError` if it is of another package and cannot be used.
    """
    metric, variable = _metric_and_parts(name)
    ppd = variable.get("ppd")
    periodic = bool(variable.get("ending"))  # the only ending is the one of a periodic variant
    options: dict[str, Any] = {}
    if ppd and ppd != "67":  # 67 stands for 67.0206, the default of the class
        options["ppd"] = float(ppd)
    options |= metric.options
    if periodic:
        options["periodic"] = True
    return replace(metric, name=name, periodic=periodic, options=options, family=metric.family or metric.name)


def _metric_and_parts(name: str) -> tuple[Metric, dict[str, str | None]]:
    """The metric that a name belongs to, and by name the variable parts, `ppd` and `ending`, of this name.

    Raises as `get` does.
    """
    built_in = _built_in(name)
    if built_in:
        return built_in
    plain = name.removesuffix(PERIODIC)
    outside_entries = outside.entries()
    if plain in outside_entries:
        built_in_families = {metric.family or metric.name for metric in REGISTERED}
        metric = outside.metric_of_entry(outside_entries[plain], built_in_families)
        if metric.periodic or name == plain:
            return metric, {"ending": name.removeprefix(plain)}
    raise InputError(f"no metric is named {name!r}{did_you_mean(name, [*examples(), *outside_entries])}")


def _built_in(name: str) -> tuple[Metric, dict[str, str | None]] | None:
    """As `_metric_and_parts`, of the metrics of this suite alone; None if the name is of none of them."""
    for metric in REGISTERED:
        # Pixels per degree: a number without needless zeros, so that each distance has one name.
        pattern = re.escape(metric.name).replace(re.escape("{ppd}"), r"(?P<ppd>[1-9]\d{0,3}(?:\.\d*[1-9])?)")
        if metric.periodic:
            pattern += f"(?P<ending>{PERIODIC})?"
        match = re.fullmatch(pattern, name)
        if match:
            return metric, match.groupdict()
    return None


def refuse_taken_names() -> None:
    """Raise a `PluginError` if another package has a metric with the name of a built-in one."""
    for entry in outside.entries().values():
        if _built_in(entry.name):
            fault = "has the name of a built-in metric: choose another name"
            raise PluginError(f"{called(entry, outside.KIND)} {fault}; {remedy(entry)}")


def listed() -> dict[str, str]:
    """Name → words on each metric, those of other packages last; what is wrong, for one that cannot be used."""

    def words(metric: Metric) -> str:
        """Unit, better end, space and version of a metric, on one line."""
        return f"{metric.unit}, {metric.direction} is better, {metric.space}, version {metric.version}"

    lines = {metric.name: words(metric) for metric in REGISTERED}
    try:
        others = outside.entries()
        refuse_taken_names()
    except InputError as error:  # a fault of another package must not hide the metrics of this one
        return lines | {"(other packages)": f"FAILS: {error}"}
    for name in sorted(others):
        try:
            lines[name] = words(get(name))
        except InputError as error:
            lines[name] = f"FAILS: {error}"
    return lines


def chosen_names(names: Sequence[str], periodic: bool) -> tuple[str, ...]:
    """The metrics of a suite for a material: the periodic variants if the material repeats. `psnr_display`, the main
    metric, comes first, named or not. `InputError` for an unknown name."""
    for name in names:
        _metric_and_parts(name)  # a periodic ending, too, must be of a metric that has it
    plain = [REGISTERED[0].name, *(name.removesuffix(PERIODIC) for name in names)]
    chosen = []
    for name in dict.fromkeys(plain):
        metric, _ = _metric_and_parts(name)
        chosen.append(name + PERIODIC if metric.periodic and periodic else name)
    return tuple(chosen)


@lru_cache(maxsize=256)  # tables ask for every cell
def find(name: str) -> Metric | None:
    """The metric of that name; None for that of an older record, or of a package that is not installed or fails."""
    try:
        return get(name)
    except InputError:
        return None


def label_of(name: str) -> str:
    """The name of a metric in tables; an unknown name, as in an older record, is returned unchanged."""
    metric = find(name)
    words = name.replace("_", " ")
    if metric is None:
        return words
    label = metric.label or words
    # An option `ppd` of another package's metric need not be the distance of a FLIP.
    ppd = None if metric.called else metric.options.get("ppd")
    return f"{label} {ppd:g}ppd" if ppd else label


def family_of(name: str) -> str:
    """The family of a metric; of an unknown one its name without the periodic ending."""
    metric = find(name)
    return metric.family if metric else name.removesuffix(PERIODIC)


def metric_of(names: Iterable[str], family: str) -> str:
    """Which of these metrics a table shows for a family, or for a metric in any variant (`ssim` → `ssim_periodic`).

    Of several the one of this very name comes first; then one that suites measure by default, so FLIP is that of 67
    pixels per degree; then the first by name. "" if there is none.
    """
    return _member(tuple(names), family)


@lru_cache(maxsize=1024)
def _member(names: tuple[str, ...], family: str) -> str:
    """As `metric_of`, remembered for each tuple of names."""

    def preference(name: str) -> tuple[bool, bool, str]:
        """What sorts names: first the very name, then a default metric, then by name. False sorts before True."""
        is_another = name != family
        is_no_default = name.removesuffix(PERIODIC) not in DEFAULTS
        return is_another, is_no_default, name

    def is_member(name: str) -> bool:
        """Whether a metric is of the family, or is called so itself."""
        return family in (name, name.removesuffix(PERIODIC), family_of(name))

    members = [name for name in names if is_member(name)]
    return min(members, key=preference, default="")


def in_decibels(name: str) -> bool:
    """Whether a metric is a PSNR, whose slices without error count as exact."""
    metric = find(name)
    return metric is not None and metric.decibels


def is_relative(name: str) -> bool:
    """Whether a metric is an error of radiance, which a table of its own shows."""
    metric = find(name)
    return metric is not None and metric.relative


def stats_of(job: Job, family: str, group: str = "") -> Statistics:
    """The statistics of a family's metric over a group, by default the deciding one; empty if there are none."""
    metrics = metrics_of(job, group)
    stats: Statistics = metrics.get(metric_of(metrics, family), {})
    return stats


def all_exact(stats: Mapping[str, Any]) -> bool:
    """Whether statistics say that no slice has an error, so that a PSNR is infinite."""
    return bool(stats.get("exact")) and stats["exact"] == stats.get("slices")  # both are counts of slices


def mean_over(jobs: Iterable[Job], family: str) -> float | None:
    """The mean over jobs, such as those of all seeds, of a metric's mean over the deciding slices; None where none has
    a number."""
    means = [stats_of(job, family).get("mean") for job in jobs]
    measured = [mean for mean in means if mean is not None]
    return fmean(measured) if measured else None


_COUNTS = ("exact", "slices")  # with a mean: whether all its slices are exact, and whether there are any
# What tables, figures and verdicts read of a group of pairs: statistics by family of metrics.
_OF_ALL_OR_FITTED = dict.fromkeys((PSNR, SSIM, FLIP), ("mean", "std", *_COUNTS))
_OF_MEAN_PSNR = {PSNR: ("mean", *_COUNTS)}
_OF_PART = _OF_MEAN_PSNR | {RMSE: ("pooled", "relative")}


def read_scores(scores: Mapping[str, Group]) -> dict[str, Group]:
    """The scores of a job, by group of pairs, that something reads; the rest can be made again from its file.

    Every statistic stays of the deciding group and of that of a scene. Of all pairs, of training and validation pairs,
    of low light, of each part of the deciding group (but of no part of a part), and of those in and out of a scene, a
    few statistics of a few metrics stay. Other groups go, and so does the mean radiance of each.
    """
    deciding = deciding_group(scores)
    groups_read: dict[str, Group] = {}
    for name, group in scores.items():
        parent, *parts = name.split(", ")
        if name in (deciding, "scene"):
            statistics = group["metrics"]
        elif name in ("all", "train"):
            statistics = _chosen_statistics(group, _OF_ALL_OR_FITTED)
        elif name == VALIDATION:  # a trade also reads what is pooled
            statistics = _chosen_statistics(group, {PSNR: ("mean", "pooled", *_COUNTS)})
        elif name in (SCENE_HELDOUT, OUTSIDE):
            statistics = _chosen_statistics(group, _OF_MEAN_PSNR)
        elif name == LOW_LIGHT or (parent == deciding and len(parts) == 1):
            statistics = _chosen_statistics(group, _OF_PART)
        else:
            continue
        groups_read[name] = {"metrics": statistics}
        if "slices" in group:  # in records, the count comes first
            groups_read[name] = {"slices": group["slices"], "metrics": statistics}
    return groups_read


def _chosen_statistics(group: Group, families: Mapping[str, Sequence[str]]) -> dict[str, Statistics]:
    """Of each family the metric of a group that tables show, see `metric_of`, with the statistics named there."""
    chosen: dict[str, Statistics] = {}
    for family, wanted in families.items():
        name = metric_of(group["metrics"], family)
        if name:
            stats = group["metrics"][name]
            chosen[name] = {statistic: stats[statistic] for statistic in wanted if statistic in stats}
    return chosen


def examples() -> list[str]:
    """Every metric of the registry at its usual distance, then the periodic variants."""
    plain = [metric.name.replace("{ppd}", "67") for metric in REGISTERED]
    return plain + [name + PERIODIC for name, metric in zip(plain, REGISTERED, strict=True) if metric.periodic]
