"""The rules of a comparison: when a change is a regression, and when two records cannot be compared.

A loss counts where it exceeds its *margin*, and a gain likewise. The margin of a codec whose seeds agree is a small
tolerance. That of a codec whose seeds differ is max(tolerance, 3 · s · √(1/n + 1/m)): s is the standard deviation over
all seeds of the base, n and m are how many seeds of base and new the two means are of. With three each that is
3 · s · √(2/3), three standard deviations of the difference of the means. So a change counts only when it is both
larger than chance and large enough to matter.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from statistics import fmean, stdev

from bench.compare.quantities import Quantity, Tolerance
from bench.records import Record

SPREADS = 3.0  # standard deviations of the difference of two means
SAME_EXPOSURE = 1e-4  # relative: 0.0004 dB of a gain; renderings may differ in a last bit from machine to machine


class Verdict(StrEnum):
    """What became of a number, or of a row of numbers."""

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


def judge(quantity: Quantity, base: Sequence[Record], new: Sequence[Record], reference: Sequence[Record]) -> Change:
    """The verdict on one quantity of two sets of jobs that may be compared; `reference` are all seeds of the base."""
    before, after, known = ([quantity.value(job) for job in jobs] for jobs in (base, new, reference))
    if reason := _obstacle(quantity, base[0], new[0], before, after):
        return Change(quantity, _mean(before), _mean(after), Verdict.UNLIKE, why=reason)
    spread = _spread(known)
    change = Change(quantity, _mean(before), _mean(after), Verdict.SHOWN, spread=spread)
    if quantity.tolerance is None:
        return change
    room = margin(quantity.tolerance, [v for v in known if v is not None], len(base), len(new))
    return Change(quantity, change.base, change.new, _verdict(change.loss, room), room, spread)


def margin(tolerance: Tolerance, known: Sequence[float], n: int, m: int) -> float:
    """The margin for means of `n` and `m` seeds, given the values of all seeds of the base; see the module."""
    finite = [value for value in known if math.isfinite(value)]
    unit = abs(fmean(finite)) if tolerance.relative and finite else 1.0
    if len(known) == 1:
        return unit * tolerance.alone
    if len(finite) < 2 or max(finite) - min(finite) <= unit * tolerance.certain:
        return unit * tolerance.certain
    return max(unit * tolerance.drawn, SPREADS * stdev(finite) * math.sqrt(1 / n + 1 / m))


def unlike(base: Record, new: Record) -> str:
    """Why no number of two jobs may be compared: another version of the codec, or other data; "" where all may."""
    mine, theirs = base["fit_key"], new["fit_key"]
    reasons = []
    if mine["version"] != theirs["version"]:
        reasons.append(f"codec version {theirs['version']} instead of {mine['version']}")
    if mine["training"] != theirs["training"]:
        reasons.append("other training data (their fingerprint differs)")
    elif base["score_key"]["btf"] != new["score_key"]["btf"]:
        reasons.append("other data (their fingerprint differs)")
    elif not math.isclose(base["score_key"]["exposure"], new["score_key"]["exposure"], rel_tol=SAME_EXPOSURE):
        reasons.append("another exposure")
    return ", ".join(reasons)


def other_settings(base: Record, new: Record) -> str:
    """In words, the settings in which two jobs differ; they are compared all the same."""
    mine, theirs = base["fit_key"]["settings"], new["fit_key"]["settings"]
    changed = [key for key in sorted({*mine, *theirs}) if mine.get(key) != theirs.get(key)]
    return ", ".join(f"{key} {mine.get(key, '—')} → {theirs.get(key, '—')}" for key in changed)


def _obstacle(quantity: Quantity, base: Record, new: Record, before: Sequence[object], after: Sequence[object]) -> str:
    if quantity.metric:
        versions = [job["metrics"].get(quantity.metric, {}).get("version") for job in (base, new)]
        if versions[1] is None:
            return f"{quantity.metric} is not measured any more"
        if versions[0] != versions[1]:
            return f"{quantity.metric} version {versions[1]} instead of {versions[0]}"
    missing = None in before or None in after
    return "no finite number" if missing and before != after else ""


def _verdict(loss: float, room: float) -> Verdict:
    if loss > room:
        return Verdict.WORSE
    return Verdict.BETTER if -loss > room else Verdict.SAME


def _mean(values: Sequence[float | None]) -> float | None:
    """The mean; of those that are not exact where some are, so that one seed less that is exact does show."""
    numbers = [value for value in values if value is not None]
    if not numbers or len(numbers) < len(values):
        return None
    return fmean([value for value in numbers if math.isfinite(value)] or numbers)


def _spread(values: Sequence[float | None]) -> float | None:
    finite = [value for value in values if value is not None and math.isfinite(value)]
    return None if len(values) < 2 else stdev(finite) if len(finite) > 1 else 0.0
