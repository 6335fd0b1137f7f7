"""Decides when a change is a regression, and when two records cannot be compared.

A loss or a gain counts if it exceeds its *margin*. If the seeds of a codec agree, its margin is a small tolerance. If
they differ, it is max(tolerance, t · s · √(1/n + 1/m)). Here s is the standard deviation over the seeds of the base, n
and m are the numbers of seeds in the means of base and new, and t is the value that Student's t, with the degrees of
freedom of s, exceeds by chance as often as the quantity's tolerance says. So a change counts only if it is both larger
than chance and large enough to matter. The margin is the smallest loss that the seeds of this codec can reveal.

If all seeds are scored at the same pairs, the base mean is over all its seeds; otherwise over the seeds that new has
too. A row whose seeds give the numbers of the base again has not changed, whatever the other seeds give.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from statistics import NormalDist, fmean, stdev
from typing import TYPE_CHECKING

from bench.compare.quantities import Quantity, Tolerance
from bench.records import Record, scored_unlike

if TYPE_CHECKING:
    from bench.compare.paired import Interval

AGREE = 0.1  # of the tolerance: seeds of a deterministic codec may differ by this much, from rounding
FEW_SEEDS = 6  # with fewer, the seeds of new help to estimate the scatter of a codec


class Verdict(StrEnum):
    """The verdict on a number, or on a row of numbers."""

    SAME = "same"
    BETTER = "better"
    WORSE = "WORSE"
    GONE = "GONE"
    FAILED = "FAILED"
    UNLIKE = "not comparable"
    NEW = "new"
    SHOWN = ""  # of a number that does not decide


@dataclass(frozen=True)
class Change:
    """One quantity in base and new: means over seeds, and the margin within which they count as the same."""

    quantity: Quantity
    base: float | None
    new: float | None
    verdict: Verdict
    margin: float | None = None
    spread: float | None = None  # standard deviation over the seeds of the base; None where it has one
    why: str = ""
    chance: "Chance | None" = None  # of the difference, where seeds differ
    interval: "Interval | None" = None  # of the difference, over pairs and seeds; of the mean over slices

    @property
    def difference(self) -> float | None:
        """new − base; 0 where both are exact."""
        if self.base is None or self.new is None:
            return None
        return 0.0 if self.base == self.new else self.new - self.base

    @property
    def loss(self) -> float:
        """How much worse new is, in the quantity's unit; negative where it is better."""
        difference = self.difference or 0.0
        return -difference if self.quantity.better == "higher" else difference


@dataclass(frozen=True)
class Chance:
    """The scatter of a difference of two means: its standard error and the degrees of freedom."""

    error: float
    freedom: float

    def margin(self, probability: float) -> float:
        """The value that a difference exceeds by chance with this probability."""
        return quantile(self.freedom, probability) * self.error


def judge(
    quantity: Quantity, base: Sequence[Record], new: Sequence[Record], reference: Sequence[Record], draws: bool = False
) -> Change:
    """The verdict on one quantity of two comparable sets of jobs; `reference` holds all seeds of the base.

    `draws` marks a random codec, even if the seeds of this quantity agree: see `agree`.
    """
    before, after, known = ([quantity.value(job) for job in jobs] for jobs in (base, new, reference))
    if (
        quantity.tolerance is not None
        and not _again(before, after)
        and len({job["score_key"]["btf"] for job in reference}) == 1
    ):
        base, before = reference, known  # the same pairs for every seed: each tells as much as any
    if reason := _obstacle(quantity, base[0], new[0], before, after):
        return Change(quantity, _mean(before), _mean(after), Verdict.UNLIKE, why=reason)
    spread = _spread(known)
    change = Change(quantity, _mean(before), _mean(after), Verdict.SHOWN, spread=spread)
    if quantity.tolerance is None:
        return change
    values = [value for value in known if value is not None]
    chance = None
    if (draws and quantity.metric) or not _agree(quantity.tolerance, known):
        chance = scatter(values, [v for v in after if v is not None], len(base))
    room = margin(quantity.tolerance, values, chance)
    return Change(quantity, change.base, change.new, verdict(change.loss, room), room, spread, chance=chance)


def _again(base: Sequence[float | None], new: Sequence[float | None]) -> bool:
    """Whether the seeds of new gave the numbers of the base again, up to the rounding of a reference."""
    pairs = zip(base, new, strict=False)
    return len(base) == len(new) and all(a == b or (a and b and math.isclose(a, b, rel_tol=1e-5)) for a, b in pairs)


def agree(quantity: Quantity, reference: Sequence[Record]) -> bool:
    """Whether all seeds of the base give the same up to rounding: then the codec is deterministic."""
    return quantity.tolerance is None or _agree(quantity.tolerance, [quantity.value(job) for job in reference])


def _agree(tolerance: Tolerance, known: Sequence[float | None]) -> bool:
    values = [value for value in known if value is not None and math.isfinite(value)]
    if len(values) < 2:
        return True
    unit = abs(fmean(values)) if tolerance.relative else 1.0
    return max(values) - min(values) <= AGREE * unit * tolerance.certain


def scatter(known: Sequence[float], new: Sequence[float], n: int) -> Chance | None:
    """The scatter of the difference between the means of `n` base seeds and of the new seeds; None if unknown.

    `known` holds the values of all seeds of the base.
    """
    finite = [value for value in known if math.isfinite(value)]
    if len(finite) < 2 or not new:
        return None
    groups = [finite]
    if len(finite) < FEW_SEEDS and len(others := [value for value in new if math.isfinite(value)]) > 1:
        groups.append(others)
    freedom = sum(len(group) - 1 for group in groups)
    variance = math.fsum((len(group) - 1) * stdev(group) ** 2 for group in groups) / freedom
    return Chance(math.sqrt(variance * (1 / n + 1 / len(new))), freedom)


def margin(tolerance: Tolerance, known: Sequence[float], chance: Chance | None) -> float:
    """The margin that a change must exceed to count, given the values of all seeds of the base; see the module."""
    finite = [value for value in known if math.isfinite(value)]
    unit = abs(fmean(finite)) if tolerance.relative and finite else 1.0
    if len(known) == 1:
        return unit * tolerance.alone
    return unit * tolerance.certain if chance is None else max(unit * tolerance.drawn, chance.margin(tolerance.chance))


def quantile(freedom: float, probability: float) -> float:
    """The value that Student's t exceeds with that probability; exact for 1 and 2 degrees of freedom, else to 6 %.

    From the normal quantile, by the expansion of Abramowitz and Stegun (1964), 26.7.5.
    """
    if freedom < 1.5:
        return 1 / math.tan(math.pi * probability)
    if freedom < 2.5:
        return (1 - 2 * probability) / math.sqrt(2 * probability * (1 - probability))
    z, f = -NormalDist().inv_cdf(probability), freedom
    return z + sum(
        (
            (z**3 + z) / (4 * f),
            (5 * z**5 + 16 * z**3 + 3 * z) / (96 * f**2),
            (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / (384 * f**3),
            (79 * z**9 + 776 * z**7 + 1482 * z**5 - 1920 * z**3 - 945 * z) / (92160 * f**4),
        )
    )


def fitted_unlike(base: Record, new: Record) -> str:
    """Why the fits of two jobs are not of the same kind: another version of the codec, or other training data."""
    mine, theirs = base["fit_key"], new["fit_key"]
    reasons = []
    if mine["version"] != theirs["version"]:
        reasons.append(f"codec version {theirs['version']} instead of {mine['version']}")
    if mine["training"] != theirs["training"]:
        reasons.append("other training data (their fingerprint differs)")
    return ", ".join(reasons)


def unlike(base: Record, new: Record) -> str:
    """Why no number of two jobs may be compared: unlike fits, other pairs or another exposure; "" where all may."""
    reasons = [fitted] if (fitted := fitted_unlike(base, new)) else []
    if base["fit_key"]["training"] == new["fit_key"]["training"]:  # else that is said, and the rest follows from it
        reasons += scored_unlike(base["score_key"], new["score_key"])
    return ", ".join(reasons)


def other_settings(base: Record, new: Record) -> str:
    """The settings in which two jobs differ, as text; the jobs are compared nevertheless."""
    mine, theirs = base["fit_key"]["settings"], new["fit_key"]["settings"]
    changed = [key for key in sorted({*mine, *theirs}) if mine.get(key) != theirs.get(key)]
    return ", ".join(f"{key} {mine.get(key, '—')} → {theirs.get(key, '—')}" for key in changed)


def _obstacle(quantity: Quantity, base: Record, new: Record, before: Sequence[object], after: Sequence[object]) -> str:
    versions = [quantity.version(job) for job in (base, new)]
    if versions[1] is None and versions[0] is not None:
        return f"{quantity.metric} is not measured any more"
    if versions[0] != versions[1]:
        return f"{quantity.metric} version {versions[1]} instead of {versions[0]}"
    missing = None in before or None in after
    return "no finite number" if missing and before != after else ""


def verdict(loss: float, room: float) -> Verdict:
    """Whether a loss exceeds its margin, or a gain does."""
    if loss > room:
        return Verdict.WORSE
    return Verdict.BETTER if -loss > room else Verdict.SAME


def _mean(values: Sequence[float | None]) -> float | None:
    """The mean of the finite values, infinite if all are exact, so that losing one exact seed shows."""

    numbers = [value for value in values if value is not None]
    if not numbers or len(numbers) < len(values):
        return None
    return fmean([value for value in numbers if math.isfinite(value)] or numbers)


def _spread(values: Sequence[float | None]) -> float | None:
    finite = [value for value in values if value is not None and math.isfinite(value)]
    return None if len(values) < 2 else stdev(finite) if len(finite) > 1 else 0.0
