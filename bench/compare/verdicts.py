"""Decides when a change is a regression, and when two records cannot be compared.

A base, which is an older run or a reference, is compared with a new run, row by row.

A loss or a gain counts if it exceeds its *margin*, so is larger than chance and large enough to matter. If the seeds of
a codec agree, its margin is a small tolerance. If they differ, it is max(tolerance, t · s · √(1/n + 1/m)): s is the
standard deviation over the seeds of the base, n and m are the numbers of seeds in the means of base and new, and t is
what Student's t, with the degrees of freedom of s, exceeds by chance as often as the quantity's tolerance says.

All seeds are scored at the same pairs, so the mean of the base is over all its seeds, also those that new lacks. But a
row whose seeds give the numbers of the base again did not change, whatever the other seeds give. Where new wrote the
files of the base again, the margin is the small tolerance: no fit scattered, so a change of a score is one of the
decoder or of the metric.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from statistics import fmean, stdev

from bench.compare.paired import Interval
from bench.compare.quantities import Quantity, Tolerance
from bench.compare.statistics import average
from bench.records import Job, scored_unlike

Values = Sequence[float | None]  # a number a seed; None where it was not measured
AGREE = 0.1  # share of the tolerance: rounding may make the seeds of a deterministic codec differ by this much
# With fewer seeds, those of new help to estimate the scatter of a codec, and `Chance.margin` has a limit. With three
# seeds, one deviation in five (1 − e^−¼) is less than half the true one; with six seeds, one in sixteen.
FEW_SEEDS = 6


class Verdict(StrEnum):
    """The verdict on a number, or on a row of numbers."""

    SAME = "same"
    BETTER = "better"
    WORSE = "WORSE"
    GONE = "GONE"
    FAILED = "FAILED"
    UNLIKE = "not comparable"
    NEW = "new"
    SHOWN = ""  # for a number that does not decide


DECIDED = (Verdict.SAME, Verdict.BETTER, Verdict.WORSE)


@dataclass(frozen=True)
class Change:
    """One quantity in base and new: means over seeds, and the margin within which they count as the same."""

    quantity: Quantity
    base: float | None
    new: float | None
    verdict: Verdict
    margin: float | None = None
    spread: float | None = None  # standard deviation over the seeds that measure scatter; None if there is only one
    why: str = ""  # why base and new cannot be compared; "" if they can
    chance: "Chance | None" = None  # scatter of the difference, if seeds differ
    interval: Interval | None = None  # for PSNR: of the difference, over pairs and seeds
    weighted: float | None = None  # of a mean of rows: the mean difference in which rows that scatter more count less

    @property
    def difference(self) -> float | None:
        """new − base, or their weighted mean over rows; 0 if both are exact, None if one was not measured."""
        if self.weighted is not None:
            return self.weighted
        return _difference(self.base, self.new)

    @property
    def loss(self) -> float:
        """How much worse new is, in the quantity's unit; negative if it is better, 0 if one was not measured."""
        difference = self.difference
        if difference is None:
            return 0.0
        if self.quantity.better == "higher":
            return -difference
        return difference


@dataclass(frozen=True)
class Chance:
    """The scatter of a difference of two means: its standard error and the degrees of freedom."""

    error: float
    freedom: float

    def margin(self, tolerance: Tolerance, unit: float = 1.0) -> float:
        """The value that a difference exceeds by chance as seldom as the tolerance says.

        With two seeds it would be hundreds of standard errors, and hide any loss. So it is at most the value that the
        same error from `FEW_SEEDS` seeds would give, or the guess for one seed if that is larger.
        """
        of_these_seeds = quantile(self.freedom, tolerance.chance) * self.error
        of_enough_seeds = quantile(max(self.freedom, FEW_SEEDS - 1), tolerance.chance) * self.error
        limit = max(unit * tolerance.one_seed, of_enough_seeds)
        return min(of_these_seeds, limit)


def judge(
    quantity: Quantity, base: Sequence[Job], new: Sequence[Job], reference: Sequence[Job], draws: bool = False
) -> Change:
    """The verdict on one quantity of the jobs of base and new, one a seed, that are comparable.

    `reference` holds all seeds of the base, of which `base` are those to compare. `draws` says that the codec is
    random, even if the seeds agree in this quantity; sizes, which have no metric, are judged by their own seeds.
    """
    after = [quantity.value(job) for job in new]
    same_files = bool(quantity.metric) and _wrote_same_files(base, new)
    in_mean = _jobs_in_mean(quantity, base, after, reference, same_files)
    before = [quantity.value(job) for job in in_mean]
    obstacle = _obstacle(quantity, in_mean[0], new[0], before, after)
    if obstacle:
        return Change(quantity, average(before), average(after), Verdict.UNLIKE, why=obstacle)
    values = [quantity.value(job) for job in reference]
    spread = 0.0 if same_files else _spread(values)  # no chance is in the difference of a file and itself
    change = Change(quantity, average(before), average(after), Verdict.SHOWN, spread=spread)
    if quantity.tolerance is None:  # it does not decide
        return change
    # Sizes have no metric. Their scatter is judged by their own numbers, a metric's by whether files are the same.
    scatters = draws and not same_files if quantity.metric else not agree(quantity, reference)
    chance = scatter(values, after, len(in_mean)) if scatters else None
    allowed = quantity.tolerance.certain if same_files else margin(quantity.tolerance, values, chance)
    return replace(change, verdict=verdict(change.loss, allowed), margin=allowed, chance=chance)


def _jobs_in_mean(
    quantity: Quantity, base: Sequence[Job], after: Values, reference: Sequence[Job], same_files: bool
) -> Sequence[Job]:
    """The jobs of the base over which its mean is: `base`, the compared ones, or all of its row, `reference`.

    `after` are the numbers of new; `same_files` says that new wrote the base's files again.
    """
    if quantity.tolerance is None or same_files:
        return base
    if _gave_same_numbers([quantity.value(job) for job in base], after):
        return base
    return reference


def _gave_same_numbers(base: Values, new: Values) -> bool:
    """Whether the seeds of new gave the numbers of the base again, up to the rounding of a reference."""
    if len(base) != len(new):
        return False
    for before, after in zip(base, new, strict=True):
        if before == after:  # also if neither was measured
            continue
        if before is None or after is None or not math.isclose(before, after, rel_tol=1e-5):
            return False
    return True


def _wrote_same_files(base: Sequence[Job], new: Sequence[Job]) -> bool:
    """Whether new wrote the base's file again with each of its seeds, byte for byte."""
    before = {job["seed"]: job["score_key"].get("sha256") for job in base}
    after = {job["seed"]: job["score_key"].get("sha256") for job in new}
    return before == after and None not in after.values()


def _difference(base: float | None, new: float | None) -> float | None:
    """new − base; 0 if both are infinite, and None if one was not measured."""
    if base is None or new is None:
        return None
    if base == new:
        return 0.0
    return new - base


def is_random(quantities: Sequence[Quantity], reference: Sequence[Job]) -> bool:
    """Whether a codec's fits are random: one of the scores shows it, even where the seeds of another agree.

    `reference` holds all jobs of the base's row.
    """
    return not all(agree(quantity, reference) for quantity in quantities if quantity.metric)


def agree(quantity: Quantity, reference: Sequence[Job]) -> bool:
    """Whether the seeds of the base agree up to rounding: then the codec is deterministic.

    True also for fewer than two seeds, which show no scatter, and for a quantity without a tolerance.
    """
    tolerance = quantity.tolerance
    values = _finite([quantity.value(job) for job in reference])
    if tolerance is None or len(values) < 2:
        return True
    return max(values) - min(values) <= AGREE * _unit(tolerance, values) * tolerance.certain


def scatter(of_base: Values, new: Values, count: int) -> Chance | None:
    """The scatter of a difference: the mean of the numbers `new`, one a seed, minus that of `count` seeds of the base.

    `of_base` are the numbers of all seeds of the base, from which the scatter of one seed is estimated; None if fewer
    than two of them are finite. If they are few, those of new help.
    """
    finite = _finite(of_base)
    finite_new = _finite(new)
    if len(finite) < 2 or not new:
        return None
    groups = [finite]  # each a list of numbers, one a seed, that scatter alike
    if len(finite) < FEW_SEEDS and len(finite_new) > 1:
        groups.append(finite_new)
    # The pooled variance: each group about its own mean, weighted by its degrees of freedom.
    freedom = sum(len(group) - 1 for group in groups)
    variance = math.fsum((len(group) - 1) * stdev(group) ** 2 for group in groups) / freedom
    return Chance(math.sqrt(variance * (1 / count + 1 / len(new))), freedom)


def _finite(values: Values) -> list[float]:
    """The values that were measured and are finite."""
    return [value for value in values if value is not None and math.isfinite(value)]


def _unit(tolerance: Tolerance, finite: list[float]) -> float:
    """What a tolerance is counted in: if it is relative, the mean of these numbers, unless there are none; else 1."""
    if tolerance.relative and finite:
        return abs(fmean(finite))
    return 1.0


def margin(tolerance: Tolerance, values: Values, chance: Chance | None) -> float:
    """The margin that a change must exceed to count; see the module.

    `values` are the numbers that measure the scatter, one a seed; `chance` is that scatter, None where seeds agree, so
    that the codec counts as deterministic.
    """
    unit = _unit(tolerance, _finite(values))
    if len(values) < 2:  # one seed, so the scatter is unknown
        return unit * tolerance.one_seed
    if chance is None:
        return unit * tolerance.certain
    return max(unit * tolerance.drawn, chance.margin(tolerance, unit))


def smallest_loss(quantity: Quantity, jobs: Sequence[Job], count: int, draws: bool) -> float:
    """The margin of `count` new seeds against these jobs of a base, before there are new jobs.

    `draws` says that the codec is random, so that its seeds scatter; new seeds are taken to scatter as the base's do.
    """
    assert quantity.tolerance is not None, "a deciding quantity has a tolerance"
    values = [quantity.value(job) for job in jobs]
    chance = None
    if draws:
        in_place_of_new = values[:count]  # there are none yet; what matters is how many they are, and their scatter
        chance = scatter(values, in_place_of_new, len(values))
    return margin(quantity.tolerance, values, chance)


def quantile(freedom: float, probability: float) -> float:
    """The value that Student's t exceeds with that probability."""
    from scipy.special import stdtrit  # as slow to import as everything else together, and rarely needed

    return -float(stdtrit(freedom, probability))


def why_unlike(base: Job, new: Job) -> str:
    """Why no numbers of two jobs may be compared: another version of the codec, other training data, other pairs or
    another exposure; "" if they may."""
    base_key, new_key = base["fit_key"], new["fit_key"]
    reasons = []
    if base_key["version"] != new_key["version"]:
        reasons.append(f"codec version {new_key['version']} instead of {base_key['version']}")
    if base_key.get("store") != new_key.get("store"):
        reasons.append(f"store of textures of version {new_key.get('store')} instead of {base_key.get('store')}")
    if base_key["training"] != new_key["training"]:  # other data have other pairs and exposure as well
        reasons.append("other training data (their fingerprint differs)")
    else:
        reasons += scored_unlike(base["score_key"], new["score_key"])
    return ", ".join(reasons)


def other_settings(base: Job, new: Job) -> str:
    """The settings in which two jobs differ, as text such as "bits 8 → 6"; the jobs are compared nevertheless."""
    before, after = base["fit_key"]["settings"], new["fit_key"]["settings"]
    changed = [key for key in sorted({*before, *after}) if before.get(key) != after.get(key)]
    return ", ".join(f"{key} {before.get(key, '—')} → {after.get(key, '—')}" for key in changed)


def _obstacle(quantity: Quantity, base: Job, new: Job, before: Sequence[object], after: Sequence[object]) -> str:
    """Why a quantity of two jobs cannot be compared; "" if it can. `before` and `after` are the values of all seeds."""
    base_version = quantity.version(base)
    new_version = quantity.version(new)
    if new_version is None and base_version is not None:
        return f"{quantity.metric} is not measured any more"
    if base_version is None and new_version is not None:
        return f"{quantity.metric} was not measured before"
    if base_version != new_version:
        return f"{quantity.metric} version {new_version} instead of {base_version}"
    is_missing = None in before or None in after
    both_lack_all = {*before, *after} == {None}  # also of different numbers of seeds
    if is_missing and before != after and not both_lack_all:  # where both lack the same, nothing got worse
        return "no finite number"
    return ""


def verdict(loss: float, margin: float) -> Verdict:
    """Whether a loss exceeds its margin, or a gain does, which is a negative loss."""
    if loss > margin:
        return Verdict.WORSE
    return Verdict.BETTER if -loss > margin else Verdict.SAME


def _spread(values: Values) -> float | None:
    """The standard deviation over seeds; None for one seed, from which nothing is known of the scatter.

    0 where fewer than two of several are finite numbers: exact ones do not scatter, and None was not measured.
    """
    if len(values) < 2:
        return None
    finite = _finite(values)
    if len(finite) < 2:
        return 0.0
    return stdev(finite)
