"""A copy of slices on disk, for scattered reads: the values of a texel at some pairs lie together.

It holds halves, or float32 where halves lose more than their rounding: beyond their range, or for dim data.
"""

import logging
from collections.abc import Callable
from pathlib import Path

import numpy as np

from bench.files import atomic

log = logging.getLogger(__name__)
Array = np.ndarray
TOGETHER = 64  # pairs of a block, at most
BLOCK = 256 << 20  # bytes of a block, at most, where it holds more than one pair
LARGEST = float(np.finfo(np.float16).max)
LEAST = float(np.finfo(np.float16).smallest_normal)  # below it, halves round to less than 11 bits
DIM = 0.01  # the most that may lie below `LEAST`, as a share: of measurements with values around 1, 0.0004 do at most


def opened(path: Path, read: Callable[[int], Array], count: int, shape: tuple[int, int]) -> Array:
    """The copy (blocks, H · W, pairs of a block, 3) at `path`, memory-mapped, in float16 or float32.

    Where it is not there, it is made of the slices (H, W, 3) that `read` gives for 0 to `count` - 1; `shape` is (H, W).
    """

    def make() -> None:
        with atomic.replacing(path) as partial:
            if not _write_copy(path, partial, read, count, shape, np.float16):
                _write_copy(path, partial, read, count, shape, np.float32)  # halves would lose too much

    atomic.make_once(path, make)  # else each of a dozen workers would write its own, of many gigabytes
    copy: Array = np.load(path, mmap_mode="r", allow_pickle=False)
    return copy


def scattered(copy: Array, pair: Array, texel: Array) -> Array:
    """Values (..., 3) float32 from a copy (blocks, H · W, pairs of a block, 3).

    `pair` and `texel`, row · W + column, are whole numbers of shapes that broadcast to (...).
    """
    block, place = np.divmod(pair, copy.shape[2])
    return np.asarray(copy[block, texel, place], np.float32)


def _write_copy(
    path: Path, partial: Path, read: Callable[[int], Array], count: int, shape: tuple[int, int], dtype: type
) -> bool:
    """Write the copy (blocks, H · W, pairs of a block, 3) to `partial`, in a dtype; False if halves lose too much.

    They do if a value is beyond their range, or if more than the share `DIM` of the values is too small for their
    precision. `path`, its later name, is for the log. Blocks are written from front to back: each slice is read once,
    and one block is in memory. Written slice by slice, a whole measurement would bring every page back into memory
    hundreds of times.
    """
    texels = shape[0] * shape[1]
    together = max(1, min(TOGETHER, count, BLOCK // (3 * texels * np.dtype(dtype).itemsize)))
    starts = range(0, count, together)
    block: Array = np.zeros((texels, together, 3), dtype)
    log.warning(
        "writing a scratch file of %.1f MB for scattered reads, with %.1f MB of memory: %s",
        block.nbytes * len(starts) / 1e6,
        block.nbytes / 1e6,
        path,
    )
    out = atomic.mapped(partial, dtype, (len(starts), *block.shape))
    too_dim = 0  # values so far that are too small for halves
    for number, start in enumerate(starts):
        for place in range(min(together, count - start)):
            picture = read(start + place)
            if dtype is np.float16:
                size = np.abs(picture)
                too_dim += int(((size > 0) & (size < LEAST)).sum())
                if size.max(initial=0) > LARGEST or too_dim > DIM * count * 3 * texels:
                    return False
            block[:, place] = picture.reshape(-1, 3)
        out[number] = block
    return True
