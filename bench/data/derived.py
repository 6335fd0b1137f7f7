"""Thins the pairs of a BTF evenly, or shrinks its pictures, for suites that need only part of a measured material.

Masks radiance that is NaN or infinite by the mean of its picture, for `--repair`.

Pairs are a *product* where every view direction is combined with every light direction. A *scratch file* is a copy of
a BTF's values in the cache, as float16 and ordered for reads of single texels (`bench.btf.scratch`).
"""

import hashlib
import logging
import math
from dataclasses import replace
from functools import cached_property

import numpy as np

from bench.btf import BTF, Array, Layout, NotFiniteError, Source, scratch
from bench.codec import Progress, followed, silent
from bench.directions.hemisphere import thin
from bench.inputs.errors import InputError

MOST_LISTED = 10  # pairs that a note names
log = logging.getLogger(__name__)


def thinned(btf: BTF, pairs: int) -> BTF:
    """About `pairs` of a BTF's pairs (0: all), always the same ones.

    Of a product, evenly spread views with evenly spread lights are kept, which is a product again. Pairs that form no
    product are drawn at random. Of data that declare held-out pairs, some of both kinds are kept: where the above would
    not ensure it, training and held-out pairs are thinned apart, each to its share of `pairs`, the latter at random.
    """
    if not 0 < pairs < len(btf):  # all are wanted, or more than there are
        return btf
    if btf.heldout is None or not _has_both(btf.heldout):
        return btf.subset(_evenly_spread(btf.layout, pairs))
    if btf.layout.grid is not None:
        even = _evenly_spread(btf.layout, pairs)
        if _has_both(btf.heldout[even]):
            return btf.subset(even)
    train, heldout = np.flatnonzero(~btf.heldout), np.flatnonzero(btf.heldout)
    # At least one of each, however few pairs are wanted.
    heldout_pairs = max(1, round(pairs * len(heldout) / len(btf)))
    train_pairs = max(1, pairs - heldout_pairs)
    some_train = train[_evenly_spread(Layout.of(btf.wo[train], btf.wi[train]), train_pairs)]
    some_heldout = heldout[_random_indices(len(heldout), heldout_pairs)]
    return btf.subset(np.concatenate([some_train, some_heldout]))


def _has_both(heldout: Array) -> bool:
    """Whether a mask (n,) of held-out pairs names some, but not all."""
    return bool(heldout.any() and not heldout.all())


class _Chosen(Source):
    """Some pairs of another source, numbered anew: a scratch file holds these alone."""

    def __init__(self, source: Source, pairs: Array):
        """`pairs` (n,) are indices of the source's pairs."""
        self.source = source
        self.pairs = pairs
        self.shape = source.shape
        self.count = len(pairs)
        self.at_once = source.at_once

    def slices(self, pairs: Array) -> list[Array]:
        return self.source.slices(self.pairs[pairs])

    def fingerprint(self) -> str:
        """A hash of the source's fingerprint and the pairs."""
        digest = hashlib.sha256(f"{self.source.digest}, the pairs ".encode())
        digest.update(self.pairs.astype(np.int64).tobytes())
        return digest.hexdigest()


def over_own_pairs(btf: BTF) -> BTF:
    """The BTF over a source of its pairs alone, so that others are neither read nor repaired nor copied."""
    return replace(btf, source=_Chosen(btf.source, btf.pairs), pairs=np.arange(len(btf)))


def reads_slices(source: Source) -> bool:
    """Whether a source has no scattered reads of its own: it copies all its slices into a scratch file for them."""
    return type(source).gather is Source.gather


class _Shrunk(Source):
    """Averages over boxes of texels, kept in a scratch file, so that fits need not read all texels.

    The scratch file is written at the first read.
    """

    at_once = scratch.TOGETHER  # as many pairs as a block of the scratch file holds

    def __init__(self, boxes: Source):
        """`boxes` computes the averages from the pictures at full size."""
        self.boxes = boxes
        self.shape = boxes.shape
        self.count = boxes.count

    @cached_property
    def _scratch(self) -> Array:
        """The memory-mapped scratch file of the averages (blocks, H · W, pairs of a block, 3)."""
        return self.boxes._scratch  # slices, texels and scattered values all come from this one file

    def slices(self, pairs: Array) -> list[Array]:
        """The pictures (H, W, 3) of some pairs, out of the scratch file (blocks, H · W, pairs of a block, 3)."""
        scratch_file = self._scratch
        blocks, places = np.divmod(pairs, scratch_file.shape[2])  # the block of each pair, and its place in it
        # A slice for each pair: one index array for all values takes NumPy three times as long.
        stored = [scratch_file[block, :, place] for block, place in zip(blocks, places, strict=True)]
        return [np.asarray(values, np.float32).reshape(*self.shape, 3) for values in stored]

    def fingerprint(self) -> str:
        """That of the averages, changed, because the scratch file rounds them to halves (float16)."""
        return hashlib.sha256(f"{self.boxes.digest} as halves".encode()).hexdigest()


def shrunk(btf: BTF, texels: int) -> BTF:
    """The BTF averaged in linear light over the largest boxes that leave at least `texels` texels on its shorter side.

    It stays as it is if `texels` is 0, or if even boxes of 2 × 2 leave fewer texels.
    """
    factor = min(btf.shape) // texels if texels else 1
    if factor <= 1:
        return btf
    small = btf.downsample(factor)
    return small.over(_Shrunk(small.source))


def _evenly_spread(layout: Layout, pairs: int) -> Array:
    """Indices of about `pairs` pairs: evenly spread views with evenly spread lights, or random pairs if the layout is
    no product."""
    if layout.grid is None:
        return _random_indices(len(layout.view), pairs)
    views, lights = len(layout.views), len(layout.lights)
    # As many directions on both sides, √pairs; a side that has fewer keeps all of them, and the other one takes more.
    smaller, larger = sorted((views, lights))
    of_smaller = min(smaller, math.isqrt(pairs))
    of_larger = min(larger, pairs // of_smaller)
    some_views, some_lights = of_smaller, of_larger
    if views > lights:
        some_views, some_lights = of_larger, of_smaller
    view_indices = thin(layout.views, some_views)
    light_indices = thin(layout.lights, some_lights)
    # `grid` (views, lights) holds the index of each pair.
    return layout.grid[np.ix_(view_indices, light_indices)].reshape(-1)


def _random_indices(count: int, wanted: int) -> Array:
    """`wanted` different indices below `count`, or all if there are fewer, drawn with a fixed seed and sorted."""
    return np.sort(np.random.default_rng(0).choice(count, min(count, wanted), replace=False))


class Repaired(Source):
    """Wraps a source: values that are not finite become the mean of the finite ones of their pair and channel.

    Scattered reads use the scratch file of `Source`, so every value is repaired only once."""

    def __init__(self, source: Source, name: str):
        """`name` is that of the material, for errors."""
        self.source = source
        self.name = name
        self.shape = source.shape
        self.count = source.count

    def slice(self, pair: int) -> Array:
        picture, _ = self.mended(pair)
        return picture

    def mended(self, pair: int) -> tuple[Array, int]:
        """The slice of a pair (H, W, 3), and the number of its masked values. Raises `InputError` if one of its
        channels has no finite value."""
        try:
            picture = self.source.slice(pair)
        except NotFiniteError as error:  # from a source that checks what it reads; the error holds the values
            picture = error.values
        bad = ~np.isfinite(picture)
        if not bad.any():
            return picture, 0
        if bad.all((0, 1)).any():  # a channel of which no texel is left to take the mean of
            fault = "a channel without finite values cannot be repaired"
            raise InputError(f"{self.name}: pair {self.number(pair)}: {fault}: leave the pair out")
        mean = np.mean(picture, (0, 1), where=~bad, dtype=np.float64)
        return np.where(bad, mean, picture).astype(np.float32), int(bad.sum())

    def number(self, pair: int) -> int:
        """The number of a pair in the file, which may hold more pairs."""
        return int(self.source.pairs[pair]) if isinstance(self.source, _Chosen) else pair

    def fingerprint(self) -> str:
        return hashlib.sha256(f"{self.source.digest} repaired".encode()).hexdigest()


def repaired(btf: BTF, show: Progress = silent) -> BTF:
    """The BTF with values that are not finite masked as by `Repaired`; itself if there are none.

    A warning and `provenance["repaired"]` give their number and pairs. Reads every slice once, and tells `show`.
    `InputError` for a pair of which a channel has no finite value.
    """
    source = Repaired(btf.source, btf.name)
    masked_values: dict[int, int] = {}  # number of a pair in the file → how many of its values are masked
    source_pairs = btf.pairs.tolist()  # the source may hold more pairs than the BTF
    for source_pair in followed(show, source_pairs, "looking for values that are not finite", len(btf)):
        _, count = source.mended(source_pair)
        if count:
            masked_values[source.number(source_pair)] = count
    if not masked_values:
        return btf
    listed = ", ".join(str(number) for number in list(masked_values)[:MOST_LISTED])
    if len(masked_values) > MOST_LISTED:
        listed += ", …"
    total = sum(masked_values.values())
    note = f"{total} values that were not finite, masked by the mean of their pair: pairs {listed}"
    log.warning("%s: %s", btf.name, note)
    return btf.over(source, repaired=note)
