"""Defines the numbers that a comparison reads from records: how to find and write each, which way is better.

A record has scores of each group of pairs: of training pairs (`train`), of held-out pairs, and of parts of these, such
as pairs with a grazing view. A group has for each metric a mean over its slices (`mean`) and a number of all texels
together (`pooled`). A *quantity* is such a number of a job, or its bytes or time. A *deciding* one has a tolerance, and
can make a job worse.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, cast

from bench.compare.statistics import average
from bench.metrics import PERIODIC, all_exact, in_decibels, metric_of
from bench.records import FLIP, MOST_DB, PSNR, Job, deciding_group, metrics_of

FOOTPRINTS = "footprints"  # in place of a metric's name: PSNR of averages over squares of 2, 4 and 8 texels
MAIN = "PSNR"  # the mean over slices, which tables rank by


@dataclass(frozen=True)
class Tolerance:
    """The loss that a change must exceed to matter, in the quantity's unit or, for `relative`, as a share of it."""

    certain: float = 0.0  # if the seeds of the base agree: the codec is deterministic
    drawn: float = 0.0  # if they differ
    one_seed: float = 0.0  # if the base has one seed, so that the scatter is unknown
    common: float = 0.0  # in the mean over all codecs
    relative: bool = False
    chance: float = 0.00025  # how often seeds alone may seem to exceed it, although nothing got worse


@dataclass(frozen=True)
class Quantity:
    """A number of a record: `value` finds it (None: not measured); it decides if it has a `tolerance`."""

    name: str
    unit: str
    better: str  # "higher" or "lower"
    digits: int
    value: Callable[[Job], float | None]
    tolerance: Tolerance | None = None
    metric: str = ""  # the full name of the metric whose version must agree
    decibels: bool = False  # whether `MOST_DB` and more is written as "exact"

    def version(self, job: Job) -> object:
        """The version of the metric that measured this in a job; None if it was not measured."""
        if self.metric == FOOTPRINTS:
            if self.value(job) is None:
                return None
            return job["score_key"].get(FOOTPRINTS, 1)  # without a version it is of the first
        if not self.metric:
            return 0  # sizes have no version, so any two agree
        described = job["metrics"].get(self.metric)
        return described["version"] if described is not None else None

    @property
    def scale(self) -> str:
        """The unit, with an arrow that says whether higher or lower is better."""
        arrow = "↑" if self.better == "higher" else "↓"
        return f"{self.unit} {arrow}".strip()

    def written(self, value: float | None) -> str:
        """A value as tables show it."""
        if value is None:
            return "—"
        if self.decibels and value >= MOST_DB:
            return "exact"
        return f"{value:,.{self.digits}f}"

    def shows(self, change: float) -> bool:
        """Whether a change does not round to zero at these digits."""
        return round(change, self.digits) != 0

    def difference(self, change: float) -> str:
        """A change with its sign; "=" where it does not show."""
        if not math.isfinite(change):
            got_worse = (change < 0) == (self.better == "higher")
            return "not exact" if got_worse else "exact now"
        if not self.shows(change):  # instead of "+0.00" or "−0.00"
            return "="
        return f"{change:+,.{self.digits}f}".replace("-", "−")


DECIBELS = Tolerance(certain=0.02, drawn=0.1, one_seed=0.25, common=0.05)
# It scatters least and detects most, so it may raise as many false alarms as the other four of quality together.
BY_SLICE = replace(DECIBELS, chance=0.001)
DIFFERENCE = Tolerance(certain=0.0005, drawn=0.003, one_seed=0.005, common=0.0015)  # of FLIP


def deciding(job: Job) -> list[Quantity]:
    """The quantities of a job that decide a verdict: parameters, bytes, and PSNR and FLIP of the deciding pairs.

    A job has those that its suite measured.

    PSNR is a mean over slices: of all deciding pairs, of those at grazing directions, and over footprints; and of
    training pairs, which hardly scatters over seeds, so it shows a worse fit where held-out pairs are too hard to tell.
    FLIP is pooled over the deciding pairs.
    """
    quantities = [
        _count("parameters", lambda job: job["parameters"], Tolerance()),
        _count("bytes", lambda job: job["bytes"]["total"], Tolerance(drawn=0.01, relative=True)),
    ]
    group = deciding_group(job["scores"])
    names = metrics_of(job)
    psnr, flip = metric_of(names, PSNR), metric_of(names, FLIP)
    if psnr:
        # Means over slices: a few slices do not dominate these, so they scatter less.
        quantities.append(_of_metric(MAIN, job, psnr, [group], "mean", 2, BY_SLICE))
        if "train" in job["scores"]:
            quantities.append(_of_metric("train", job, psnr, ["train"], "mean", 2, DECIBELS))
        grazing = [name for name in (f"{group}, grazing view", f"{group}, grazing light") if name in job["scores"]]
        if grazing:
            quantities.append(_of_metric("grazing", job, psnr, grazing, "mean", 2, DECIBELS))
    coarse = [side for side in job.get("footprints", {}) if side != "1"]
    if coarse:
        quantities.append(_at_footprints("footprints", coarse, "mean", DECIBELS, FOOTPRINTS))
    if flip:
        quantities.append(_of_metric("FLIP", job, flip, [group], "pooled", 4, DIFFERENCE))
    return quantities


def undeciding(job: Job) -> list[Quantity]:
    """The other numbers of quality and size in a record, which are shown and do not decide."""
    group = deciding_group(job["scores"])
    names = metrics_of(job)
    psnr, flip = metric_of(names, PSNR), metric_of(names, FLIP)
    quantities = []
    if psnr:  # "" if it was not measured
        quantities.append(_of_metric("PSNR pooled", job, psnr, [group], "pooled", 2))
    for name in names:
        if name not in (psnr, flip):
            digits = 2 if in_decibels(name) else 4
            quantities.append(_of_metric(name.removesuffix(PERIODIC), job, name, [group], "pooled", digits))
    quantities += [_at_footprints(f"{side} texels", [side], PSNR) for side in job.get("footprints", {}) if side != "1"]
    quantities += [_bytes_of_part(part) for part in ("decoder", "texture") if part in job["bytes"]]
    return quantities


def _count(name: str, value: Callable[[Job], float | None], tolerance: Tolerance | None = None) -> Quantity:
    """A whole number without a unit, of which fewer is better."""
    return Quantity(name, unit="", better="lower", digits=0, value=value, tolerance=tolerance)


def _of_metric(
    name: str,
    job: Job,
    metric: str,
    groups: Sequence[str],
    statistic: str,
    digits: int,
    tolerance: Tolerance | None = None,
) -> Quantity:
    """A statistic of a metric, "mean" or "pooled" over slices, averaged over groups of pairs; `job` describes it."""
    described = job["metrics"][metric]
    unit = "" if described["unit"] == "1" else described["unit"]  # tables show a plain number without a unit
    decibels = in_decibels(metric)
    places = [("scores", group, "metrics", metric) for group in groups]
    value = partial(_average, places, statistic, decibels)
    return Quantity(name, unit, described["direction"], digits, value, tolerance, metric, decibels)


def _at_footprints(
    name: str, sides: Sequence[str], statistic: str, tolerance: Tolerance | None = None, metric: str = ""
) -> Quantity:
    """A statistic of the PSNR at footprints of so many texels a side, averaged over these."""
    places = [("footprints", side) for side in sides]
    value = partial(_average, places, statistic, True)
    return Quantity(name, "dB", "higher", 2, value, tolerance, metric, decibels=True)


def _average(places: Sequence[tuple[str, ...]], statistic: str, decibels: bool, job: Job) -> float | None:
    """The mean of a statistic over places of a job's record, each a path of keys; those without slices do not count.

    A record cannot hold infinite decibels, of slices without an error, and has None for these, too. None if one of the
    places has no number, or if none has slices.
    """
    numbers = []
    for place in places:
        stats: Any = job
        for key in place:
            stats = stats.get(key, {})
        if not stats or not stats.get("slices", 1):  # records without a count of slices have some
            continue
        number = stats.get(statistic)
        if number is None and decibels and all_exact(stats):
            number = math.inf
        numbers.append(number)
    return average(numbers)


def _bytes_of_part(part: str) -> Quantity:
    """The bytes of a part of the file, such as `decoder` or `texture`."""

    def value(job: Job) -> float | None:
        """The bytes of the part in a job's file; None if it has no such part."""
        sizes = dict(job["bytes"])
        return cast(int | None, sizes.get(part))

    return _count(f"{part} bytes", value)
