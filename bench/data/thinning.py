"""Thins the pairs of a BTF evenly, or shrinks its pictures, for suites that need only part of a measured material."""

import hashlib
import math
from functools import cached_property

import numpy as np

from bench.btf import BTF, Layout, Source, scratch
from bench.directions.hemisphere import thin


def thinned(btf: BTF, pairs: int) -> BTF:
    """About `pairs` of a BTF's pairs (0: all), evenly spread, so that a product of views and lights stays one.

    If the data declare held-out pairs outside that product, training and held-out pairs keep their shares, and the
    held-out ones are drawn by seed. Pairs that form no product are drawn by seed, too.
    """
    if not 0 < pairs < len(btf):
        return btf
    if btf.layout.grid is not None or btf.heldout is None or not btf.heldout.any():
        chosen = _even(btf.layout, pairs)
    else:
        train, heldout = np.flatnonzero(~btf.heldout), np.flatnonzero(btf.heldout)
        share = max(1, round(pairs * len(heldout) / len(btf)))
        some = train[_even(Layout.of(btf.wo[train], btf.wi[train]), max(1, pairs - share))]
        chosen = np.concatenate([some, heldout[_drawn(len(heldout), share)]])
    return btf.subset(chosen)


class _Shrunk(Source):
    """Averages over boxes of texels, kept as halves in a scratch file, so that fits need not read all texels."""

    at_once = scratch.TOGETHER

    def __init__(self, boxes: Source):
        self.boxes, self.shape, self.count = boxes, boxes.shape, boxes.count

    @cached_property
    def _scratch(self) -> np.ndarray:
        return self.boxes._scratch

    def slices(self, pairs: np.ndarray) -> list[np.ndarray]:
        copy = self._scratch  # sliced, because a place for each value takes NumPy three times as long
        places = zip(*np.divmod(pairs, copy.shape[2]), strict=True)
        return [np.asarray(copy[block, :, place], np.float32).reshape(*self.shape, 3) for block, place in places]

    def fingerprint(self) -> str:
        return hashlib.sha256(f"{self.boxes.digest} as halves".encode()).hexdigest()


def shrunk(btf: BTF, texels: int) -> BTF:
    """The BTF averaged in linear light over the largest boxes that leave `texels` of its shorter side; 0: as it is."""
    factor = min(btf.shape) // texels if texels else 1
    if factor <= 1:
        return btf
    small = btf.downsample(factor)
    return small.over(_Shrunk(small.source))


def _even(layout: Layout, pairs: int) -> np.ndarray:
    if layout.grid is None:
        return _drawn(len(layout.view), pairs)
    views, lights = len(layout.views), len(layout.lights)
    few = min(views, lights, math.isqrt(pairs))  # a side with few directions keeps all of them
    count = (few, min(lights, pairs // few)) if views <= lights else (min(views, pairs // few), few)
    chosen = (thin(side, n) for side, n in zip((layout.views, layout.lights), count, strict=True))
    return layout.grid[np.ix_(*chosen)].reshape(-1)


def _drawn(count: int, wanted: int) -> np.ndarray:
    return np.sort(np.random.default_rng(0).choice(count, min(count, wanted), replace=False))
