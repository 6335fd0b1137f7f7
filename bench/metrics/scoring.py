"""Scores a decoded material against its BTF, slice by slice, with few slices in memory and on every core.

Statistics of a metric have the `mean` over slices in its unit, and the `pooled` number, which is of all slices
together.

The reference's part of each metric is kept up to a byte limit, so that many codecs compared with one BTF share it.
Decoded slices arrive as NumPy arrays; the decoder runs in the calling thread, the metrics in others.
"""

import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench import metrics as registry
from bench.btf import BTF, Array, box_filter
from bench.inputs.errors import InputError
from bench.machine.threads import cores
from bench.metrics.angular import as_number, grazing, polar_map
from bench.metrics.base import Picture, SliceMetric, as_metric, check_radiance
from bench.metrics.description import PERIODIC, Metric
from bench.metrics.display import display_error, exposure_of, sample
from bench.metrics.psnr import DisplayPSNR, squared_error
from bench.records import PSNR, Group, Statistics

Decode = Callable[[int], Array]

FOOTPRINTS_VERSION = 2  # version of `footprint_errors` and of the query positions in a box
_STACK_TEXELS = 1 << 16  # slices are scored in stacks of about this size: Python's overhead dominates small ones


@dataclass(frozen=True)
class Scores:
    """The measured numbers, one per slice, before any mean.

    `raw[name][k]` is the metric's raw number of pair `pairs[k]`: the squared error for PSNR and RMSE; NaN if the metric
    does not apply. `radiance` is the mean linear radiance of each reference slice. `abrdf` is the error of each texel's
    ABRDF, (H, W): the squared error of log1p(8 · exposure · radiance), mean over channels and pairs. `fixed` holds the
    constants that a metric fixed for the material, such as the exposures of HDR FLIP.
    """

    pairs: Array
    raw: dict[str, Array]
    radiance: Array
    abrdf: Array
    exposure: float
    fixed: dict[str, dict[str, float]]


@dataclass(frozen=True)
class _Reference:
    """The reference's part of a stack of n slices."""

    sides: dict[str, Any]  # what each metric prepared, by its name
    log1p: Array  # (3, n, H, W)
    radiance: Array  # (n,), the mean linear radiance of each slice

    @property
    def bytes(self) -> int:
        """The memory that keeping it takes."""
        arrays = [self.log1p, *_arrays(tuple(self.sides.values()))]
        different = {id(array): array.nbytes for array in arrays}  # metrics may share one
        return sum(different.values())


@dataclass(frozen=True)
class _Stack:
    """The numbers of a stack of n slices."""

    pairs: tuple[int, ...]  # (n,)
    reference: _Reference
    means: dict[str, Array]  # the raw numbers (n,) by name of metric
    abrdf: Array  # (H, W), the error of each texel's ABRDF, summed over the pairs


class Scorer:
    """Scores any number of codecs against one BTF.

    `names` are metrics of the registry, by default `bench.metrics.DEFAULTS`, or their periodic variants for a periodic
    BTF. `exposure` is that of the material, by default measured of `sampled` (None: of the BTF itself), as are the
    constants that metrics fix. `threads` compute metrics, by default one on each core. `cache_bytes` limits the cache
    of the reference between codecs.

    Raises `InputError` for an unknown metric, and for a periodic one if the BTF is not periodic.
    """

    def __init__(
        self,
        btf: BTF,
        names: Sequence[str] | None = None,
        *,
        exposure: float | None = None,
        sampled: BTF | None = None,
        threads: int | None = None,
        cache_bytes: int = 512 << 20,
    ):
        """Load the metrics, and measure the exposure and what they fix of the material, if anything."""
        self.btf = btf
        self.threads = threads or cores()
        self.cache_bytes = cache_bytes
        if names is None:
            names = registry.chosen_names(registry.DEFAULTS, btf.periodic)
        self.names = tuple(names)
        self.described = {name: registry.get(name) for name in self.names}
        for name, metric in self.described.items():
            if metric.periodic and not btf.periodic:
                plain = name.removesuffix(PERIODIC)
                raise InputError(f"{name} is only for materials that repeat, and {btf.name} does not: choose {plain}")
        self.metrics = {name: metric.load() for name, metric in self.described.items()}
        # Sampling reads slices, so it is done only if something is measured of them: the exposure, or constants of a
        # metric.
        if exposure is None or any(metric.per_material for metric in self.metrics.values()):
            values = sample(btf if sampled is None else sampled)
            for name, description in self.described.items():
                with description.asked("for_material"):
                    self.metrics[name] = as_metric(self.metrics[name].for_material(values.reshape(-1, 3)))
            if exposure is None:
                exposure = exposure_of(values)
        self.exposure = exposure
        # The metrics whose window fits into the picture; the others give NaN.
        self._applicable = {name: metric for name, metric in self.metrics.items() if min(btf.shape) >= metric.smallest}
        self._cached: dict[tuple[int, ...], _Reference] = {}  # by the pairs of a stack
        self._cached_bytes = 0

    def score(self, pairs: Sequence[int] | Array, decode_slice: Decode) -> Scores:
        """Score the slices of some pairs. `decode_slice(i)` gives that of pair i, (H, W, 3) linear radiance.

        Negative values count as 0. Raises `InputError`, with the pair, if a decoded slice is not a finite float picture
        of the BTF's size.
        """
        pairs = np.asarray(pairs, np.int64)
        raw = {name: np.full(len(pairs), np.nan) for name in self.names}
        radiance = np.empty(len(pairs))
        abrdf = np.zeros(self.btf.shape)
        done = 0
        for stack in self._stacks(pairs, decode_slice):
            block = slice(done, done + len(stack.pairs))
            for name, values in stack.means.items():
                raw[name][block] = values
            radiance[block] = stack.reference.radiance
            abrdf += stack.abrdf
            done = block.stop
        fixed = {}
        for name, metric in self.metrics.items():
            with self.described[name].asked("fixed"):
                constants = metric.fixed()
            if constants:
                fixed[name] = constants
        return Scores(pairs, raw, radiance, abrdf / max(1, len(pairs)), self.exposure, fixed)

    def _stacks(self, pairs: Array, decode_slice: Decode) -> Iterator[_Stack]:
        """The numbers of consecutive stacks of pairs, in order, with few of them under way."""
        shape = (*self.btf.shape, 3)
        step = max(1, _STACK_TEXELS // (self.btf.shape[0] * self.btf.shape[1]))
        waiting: deque[Future[_Stack]] = deque()
        with ThreadPoolExecutor(self.threads) as pool:
            try:
                for start in range(0, len(pairs), step):
                    of_stack = tuple(pairs[start : start + step].tolist())
                    test = np.stack([_decoded(decode_slice(pair), shape, f"pair {pair}") for pair in of_stack])
                    # A cached reference stays, so the worker will find it.
                    truth = None if of_stack in self._cached else np.stack([self.btf[pair] for pair in of_stack])
                    waiting.append(pool.submit(self._compare, of_stack, truth, test))
                    # One stack more than workers may wait; then the oldest is waited for.
                    if len(waiting) > self.threads:
                        yield self._finish(waiting.popleft())
                while waiting:
                    yield self._finish(waiting.popleft())
            finally:
                for future in waiting:
                    future.cancel()

    def _compare(self, pairs: tuple[int, ...], truth: Array | None, test: Array) -> _Stack:
        """In a worker: compute the numbers of a stack, and the reference if it is not cached.

        `truth` and `test` are the slices (n, H, W, 3) of its pairs; `truth` is None if the reference is cached.
        """
        if truth is None:
            reference = self._cached[pairs]
        else:
            true_picture = Picture(truth, self.exposure, f"reference slices of pairs {pairs[0]} to {pairs[-1]}")
            sides = {}
            for name, metric in self._applicable.items():
                with self.described[name].asked("reference_side"):
                    sides[name] = metric.reference_side(true_picture)
            # Pictures are planar, (3, n, H, W): the mean over all axes but that of the slices.
            reference = _Reference(sides, true_picture.log1p, true_picture.linear.mean((0, -2, -1)))
        test_picture = Picture(test, self.exposure, "test")
        means = {}
        for name, metric in self._applicable.items():
            with self.described[name].asked("compare"):
                differences = metric.compare(reference.sides[name], test_picture)
                if self.described[name].called:
                    _check_map(differences, len(pairs))
                means[name] = differences.mean((-2, -1))  # (n,), over the texels
        abrdf = squared_error(reference.log1p, test_picture.log1p).sum(0)  # of (n, H, W)
        return _Stack(pairs, reference, means, abrdf)

    def _finish(self, future: Future[_Stack]) -> _Stack:
        """The numbers of a stack, whose reference is kept for later codecs if there is room for it."""
        stack = future.result()
        size = stack.reference.bytes
        if stack.pairs not in self._cached and self._cached_bytes + size <= self.cache_bytes:
            self._cached[stack.pairs] = stack.reference
            self._cached_bytes += size
        return stack


def _check_map(differences: Array, count: int) -> None:
    """Raise `ValueError` unless what a metric of another package returned is a finite map (n, H, W) of `count` slices.

    A NaN would count as a slice that the metric does not apply to.
    """
    shape = np.shape(differences)
    if len(shape) != 3 or shape[0] != count:
        raise ValueError(f"it returned {shape}, not a map (..., H, W) of {count} slices")
    if not np.isfinite(differences).all():
        raise ValueError("it returned values that are not finite")


def _decoded(picture: Array, shape: tuple[int, ...], what: str) -> Array:
    """Return a decoded slice if it is a finite float picture of that shape; else an `InputError` names `what`."""
    picture = check_radiance(picture, f"decoded slice of {what}")
    if picture.shape != shape:
        raise InputError(f"decoded slice of {what} is {picture.shape}, not {shape}")
    return picture


def summarise(scores: Scores, wo: Array, wi: Array, groups: dict[str, Array]) -> dict[str, Group]:
    """Statistics of groups of pairs, ready for JSON.

    `wo` and `wi` are the BTF's directions (N, 3), `groups` indices of its pairs by name; pairs that were not scored
    are left out. The groups `grazing view` (θ_o > 60°) and `grazing light` (θ_i > 60°) of all scored pairs are added,
    and those of each group as `NAME, grazing view` and `NAME, grazing light`. Each group gives

    - `slices` and `radiance`, the mean linear radiance of its references;
    - `metrics`: by name, `mean` and `std` over the slices, `pooled` over all of them, `exact`, the number of slices
      without any error, and `slices`, the number that the metric applies to; `relative` for an error of radiance:
      `pooled` divided by the group's `radiance`; `worst` for a PSNR: its mean over the worst tenth of the slices.

    None stands for no slice to measure.
    """
    descriptions = {name: registry.get(name) for name in scores.raw}
    loaded = {name: (description, description.load()) for name, description in descriptions.items()}  # with its metric
    # Masks (n,) of the scored pairs.
    view = grazing(wo[scores.pairs])
    light = grazing(wi[scores.pairs])
    masks = {"grazing view": view, "grazing light": light}
    for name, members in groups.items():
        chosen = np.isin(scores.pairs, members)
        masks |= {name: chosen, f"{name}, grazing view": chosen & view, f"{name}, grazing light": chosen & light}
    return {name: _group(scores, chosen, loaded) for name, chosen in masks.items()}


def weighted(scores: Scores, share: Array) -> Group:
    """Statistics of all scored pairs, weighted by their shares (N,), by pair of the BTF; ready for JSON. As a group of
    `summarise`, without `worst`; `slices` and `exact` count pairs with a share."""
    shares = share[scores.pairs]  # (n,), of the scored pairs
    radiance = as_number(np.average(scores.radiance, weights=shares)) if shares.any() else None
    result: Group = {"slices": int((shares > 0).sum()), "radiance": radiance, "metrics": {}}
    for name, raw in scores.raw.items():
        description = registry.get(name)
        counting = ~np.isnan(raw) & (shares > 0)  # mask (n,)
        metric = description.load()
        with description.asked("values"):
            stats = _weighted(metric, raw[counting], shares[counting])
        if description.relative:
            stats["relative"] = _relative(stats["pooled"], radiance)
        result["metrics"][name] = stats
    return result


def _relative(error: float | None, radiance: float | None) -> float | None:
    """An error of radiance over the mean radiance; None without either."""
    if error is None or not radiance:
        return None
    return error / radiance


def _weighted(metric: SliceMetric, raw: Array, share: Array) -> Statistics:
    """As `_statistics`, with means weighted by the shares (n,) of raw numbers (n,), which have no NaN.

    `pooled` is of their weighted mean, also for a metric whose `pool` does otherwise: that knows no shares.
    """
    values = metric.values(raw)
    finite = np.isfinite(values)
    mean = None
    deviation = None
    if finite.any():
        mean = float(np.average(values[finite], weights=share[finite]))
        variance = float(np.average((values[finite] - mean) ** 2, weights=share[finite]))
        deviation = variance**0.5
    pooled = as_number(float(metric.values(np.average(raw, weights=share)))) if len(raw) else None
    return {"mean": mean, "std": deviation, "pooled": pooled} | _counts(metric, raw)


def polar_maps(scores: Scores, wo: Array, wi: Array) -> dict[str, dict[str, Any]]:
    """For each metric, polar maps of its pooled number over the `view` and over the `light` hemisphere, for JSON. `wo`,
    `wi` are the BTF's directions (N, 3). See `bench.metrics.angular.polar_map`."""
    sides = {"view": wo[scores.pairs], "light": wi[scores.pairs]}
    maps = {}
    for name, raw in scores.raw.items():
        description = registry.get(name)
        metric = description.load()
        with description.asked("pool"):
            maps[name] = {side: polar_map(directions, raw, metric.pool) for side, directions in sides.items()}
    return maps


def footprint_errors(
    btf: BTF,
    pairs: Sequence[int] | Array,
    decode: Callable[[int, Sequence[int]], Mapping[int, Array]],
    exposure: float,
    factors: Sequence[int] = (1, 2, 4, 8),
) -> dict[int, Array]:
    """The squared display error (n,) of the n pairs, by footprint in texels a side, against box-filtered truth.

    `decode(i, factors)` gives pair i at each of these footprints, linear radiance (H // factor, W // factor, 3): one
    answer for each whole box of factor × factor texels, asked at the centre of that box (`bench.material.box_centres`).
    A factor that exceeds the picture is left out. Raises `InputError` as `Scorer.score` does.
    """
    errors: dict[int, list[float]] = {factor: [] for factor in factors if factor <= min(btf.shape)}
    if not errors:  # a picture smaller than every box
        return {}
    for pair in np.asarray(pairs).tolist():
        truth = btf[pair]
        decoded = decode(pair, list(errors))
        for factor, errors_of_factor in errors.items():
            coarse_truth = box_filter(truth, factor)
            test = _decoded(decoded[factor], coarse_truth.shape, f"pair {pair} at footprint {factor}")
            errors_of_factor.append(display_error(coarse_truth, test, exposure))
    return {factor: np.array(errors_of_factor) for factor, errors_of_factor in errors.items()}


def summarise_footprints(errors: dict[int, Array]) -> dict[str, Statistics]:
    """The display PSNR at each footprint, for a record, by the footprint's side in texels as text.

    `errors` are of `footprint_errors`: by side in texels, the mean squared error (n,) of each of n slices. The answer
    is {"1": {"psnr_display": …, "mean": …, "exact": …, "slices": n}, …}: the PSNR of the mean error, the mean PSNR of
    slices, and the number of slices without an error. The pooled number stands under the metric's name, as in every
    committed record.
    """
    summary: dict[str, Statistics] = {}
    for factor, raw in errors.items():
        stats = _statistics(DisplayPSNR(), raw)
        others = {name: stats[name] for name in ("mean", "exact", "slices")}
        summary[str(factor)] = {PSNR: stats["pooled"]} | others
    return summary


def _group(scores: Scores, chosen: Array, loaded: dict[str, tuple[Metric, SliceMetric]]) -> Group:
    """The statistics of the scored pairs that a mask (n,) chooses; see `summarise`."""
    count = int(chosen.sum())
    radiance = as_number(scores.radiance[chosen].mean()) if count else None
    result: Group = {"slices": count, "radiance": radiance, "metrics": {}}
    for name, (description, metric) in loaded.items():
        raw = scores.raw[name][chosen]
        measured = raw[~np.isnan(raw)]
        with description.asked("values or pool"):
            stats = _statistics(metric, measured)
            if description.decibels:
                stats["worst"] = worst(metric.values(measured))
        if description.relative:
            stats["relative"] = _relative(stats["pooled"], radiance)
        result["metrics"][name] = stats
    return result


def worst(values: Array) -> float | None:
    """The mean of the least tenth of some values (n,), at least of one; None if there are none."""
    if not len(values):
        return None
    tenth = math.ceil(len(values) / 10)
    return float(np.sort(values)[:tenth].mean())


def _statistics(metric: SliceMetric, raw: Array) -> Statistics:
    """What a record holds of a metric's raw values (n,) of n slices, which have no NaN.

    A raw value can be averaged, such as the mean squared error of a slice. `metric.values` makes of each the value that
    is shown, such as dB; `metric.pool` makes that of their average.

    `mean` and `std` are of the finite numbers (a metric of another package may have others), `pooled` is of all; each
    is None where there is nothing to measure.
    """
    values = metric.values(raw)
    finite = values[np.isfinite(values)]
    mean = float(finite.mean()) if len(finite) else None
    deviation = float(finite.std()) if len(finite) else None
    pooled = as_number(metric.pool(raw)) if len(raw) else None
    return {"mean": mean, "std": deviation, "pooled": pooled} | _counts(metric, raw)


def _counts(metric: SliceMetric, raw: Array) -> Statistics:
    """How many raw numbers (n,) are those of no error, and how many there are."""
    return {"exact": int((raw == metric.perfect).sum()), "slices": len(raw)}


def _arrays(side: Any) -> Iterator[Array]:
    """Every array of a reference side, however its tuples nest."""
    if isinstance(side, np.ndarray):
        yield side
    else:
        for part in side:
            yield from _arrays(part)
