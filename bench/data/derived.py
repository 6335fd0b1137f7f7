"""Thins the pairs of a BTF evenly, or shrinks its pictures, for suites that need only part of a measured material.

Masks radiance that is NaN or infinite, for `--repair`.
"""

import hashlib
import logging
import math
from functools import cached_property

import numpy as np

from bench.btf import BTF, Array, Layout, NotFiniteError, Source, scratch
from bench.codec import Progress, followed, silent
from bench.directions.hemisphere import thin
from bench.inputs.errors import InputError

log = logging.getLogger(__name__)


def thinned(btf: BTF, pairs: int) -> BTF:
    """About `pairs` of a BTF's pairs (0: all), evenly spread, so that a product of views and lights stays one.

    If the data declare held-out pairs outside that product, training and held-out pairs keep their shares of all, and
    the held-out ones are a random draw, always the same one. Pairs that form no product are drawn in that way, too.
    """
    if not 0 < pairs < len(btf):
        return btf
    if btf.layout.grid is not None or btf.heldout is None or not btf.heldout.any():
        chosen = _even(btf.layout, pairs)
    else:
        train, heldout = np.flatnonzero(~btf.heldout), np.flatnonzero(btf.heldout)
        share = max(1, round(pairs * len(heldout) / len(btf)))
        layout = Layout.of(btf.wo[train], btf.wi[train])
        some_train = train[_even(layout, max(1, pairs - share))]
        some_heldout = heldout[_drawn(len(heldout), share)]
        chosen = np.concatenate([some_train, some_heldout])
    return btf.subset(chosen)


class _Shrunk(Source):
    """Averages over boxes of texels, kept in a scratch file, so that fits need not read all texels."""

    at_once = scratch.TOGETHER

    def __init__(self, boxes: Source):
        self.boxes = boxes
        self.shape = boxes.shape
        self.count = boxes.count

    @cached_property
    def _scratch(self) -> np.ndarray:
        return self.boxes._scratch  # slices, texels and scattered values all come from this one file

    def slices(self, pairs: np.ndarray) -> list[np.ndarray]:
        """The pictures (H, W, 3) of some pairs, out of the scratch file (blocks, H · W, pairs of a block, 3)."""
        copy = self._scratch  # sliced, because a place for each value takes NumPy three times as long
        blocks, places = np.divmod(pairs, copy.shape[2])
        slices = []
        for block, place in zip(blocks, places, strict=True):
            values = np.asarray(copy[block, :, place], np.float32)
            slices.append(values.reshape(*self.shape, 3))
        return slices

    def fingerprint(self) -> str:
        return hashlib.sha256(f"{self.boxes.digest} as halves".encode()).hexdigest()


def shrunk(btf: BTF, texels: int) -> BTF:
    """The BTF averaged in linear light over the largest boxes that leave at least `texels` texels on its shorter side.

    0 leaves it as it is.
    """
    factor = min(btf.shape) // texels if texels else 1
    if factor <= 1:
        return btf
    small = btf.downsample(factor)
    return small.over(_Shrunk(small.source))


def _even(layout: Layout, pairs: int) -> np.ndarray:
    """Indices of about `pairs` pairs: a product of evenly spread views and lights, or drawn pairs if they form none."""
    if layout.grid is None:
        return _drawn(len(layout.view), pairs)
    views, lights = len(layout.views), len(layout.lights)
    few = min(views, lights, math.isqrt(pairs))  # a side with few directions keeps all of them
    if views <= lights:
        some_views, some_lights = few, min(lights, pairs // few)
    else:
        some_views, some_lights = min(views, pairs // few), few
    chosen = np.ix_(thin(layout.views, some_views), thin(layout.lights, some_lights))
    return layout.grid[chosen].reshape(-1)


def _drawn(count: int, wanted: int) -> np.ndarray:
    """`wanted` different indices below `count`, or all if there are fewer, drawn with a fixed seed and sorted."""
    return np.sort(np.random.default_rng(0).choice(count, min(count, wanted), replace=False))


class Repaired(Source):
    """Wraps a source: values that are not finite become the mean of the finite ones of their pair and channel.
    Scattered reads use the scratch file of `Source`, so every value is repaired only once."""

    def __init__(self, source: Source):
        self.source = source
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
        except NotFiniteError as error:
            picture = error.values
        bad = ~np.isfinite(picture)
        if not bad.any():
            return picture, 0
        if bad.all((0, 1)).any():
            raise InputError(f"pair {pair}: a channel without finite values cannot be repaired: leave the pair out")
        mean = np.mean(picture, (0, 1), where=~bad, dtype=np.float64)
        return np.where(bad, mean, picture).astype(np.float32), int(bad.sum())

    def fingerprint(self) -> str:
        return hashlib.sha256(f"{self.source.digest} repaired".encode()).hexdigest()


def repaired(btf: BTF, show: Progress = silent) -> BTF:
    """Mask values that are not finite; a warning and `provenance["repaired"]` give their number and pairs. Reads every
    slice once. A finite BTF is returned unchanged. `Repaired` describes the replacement."""
    source = Repaired(btf.source)
    masked = {}
    pairs = followed(show, btf.pairs.tolist(), "looking for values that are not finite", len(btf))
    for index, pair in enumerate(pairs):  # the index is the BTF's, the pair its source's
        _, count = source.mended(pair)
        if count:
            masked[index] = count
    if not masked:
        return btf
    listed = ", ".join(str(index) for index in list(masked)[:10])
    if len(masked) > 10:
        listed += ", …"
    note = f"{sum(masked.values())} values that were not finite, masked by the mean of their pair: pairs {listed}"
    log.warning("%s: %s", btf.name, note)
    return btf.over(source, repaired=note)
