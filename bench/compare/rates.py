"""Compares the rate–distortion fronts of codecs: each with every other, at equal quality and at equal bytes.

The rate is the bytes of the whole file, without a network that is shared over materials; the quality is the pooled PSNR
in display space of the pairs that decide. Both are means over the seeds. A codec's *front* is what it has been measured
at and is not beaten at by a smaller file of its own, whatever settings made the file; a published recipe is a codec of
its own. Fronts are chosen by the quality that is shown, so scatter lifts that of a codec with more files a little more.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

import numpy as np

from bench.errors import InputError
from bench.metrics.bd import FEWEST, Array, Delta, bd_psnr, bd_rate
from bench.records import PSNR, Record, stats_of


class Deltas(NamedTuple):
    """What a codec is worth against another: Bjøntegaard's deltas, or None where the fronts share nothing."""

    rate: Delta | None
    quality: Delta | None


def fronts(jobs: Iterable[Record]) -> dict[str, Array]:
    """Points (n, 2) of bytes and quality by codec, of one material's jobs, in the order of growing bytes.

    Jobs without a finite quality have no point.
    """
    seeds: dict[str, dict[str, list[tuple[float, float]]]] = defaultdict(lambda: defaultdict(list))
    for job in jobs:
        quality = stats_of(job, PSNR).get("pooled")
        if quality is not None:
            seeds[codec_of(job)][job["label"]].append((job["bytes"]["total"], quality))
    return {
        name: _front(np.array([np.mean(points, 0) for points in labels.values()])) for name, labels in seeds.items()
    }


def deltas(points_by_codec: Mapping[str, Array]) -> dict[tuple[str, str], Deltas]:
    """What each front is worth against each other, by (test, anchor). Fronts of fewer than three points have none."""
    long = {name: points for name, points in points_by_codec.items() if len(points) >= FEWEST}
    return {
        (test, anchor): Deltas(*(_or_none(delta, long[anchor], long[test]) for delta in (bd_rate, bd_psnr)))
        for test in long
        for anchor in long
        if test != anchor
    }


def codec_of(job: Record) -> str:
    """The codec whose front a job is on: its name, with the recipe where that is not ours."""
    recipe = job.get("settings", {}).get("recipe", "ours")
    return str(job["codec"]) if recipe == "ours" else f"{job['codec']} recipe={recipe}"


def _front(points: Array) -> Array:
    """Those of points (n, 2) that are better than every smaller one, by growing bytes."""
    ordered = points[np.lexsort((-points[:, 1], points[:, 0]))]
    best = np.maximum.accumulate(ordered[:, 1])
    return ordered[np.concatenate([[True], ordered[1:, 1] > best[:-1]])]


def _or_none(delta: Callable[[Array, Array], Delta], anchor: Array, test: Array) -> Delta | None:
    try:
        return delta(anchor, test)
    except InputError:  # they share no quality, or no size
        return None
