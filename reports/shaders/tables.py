"""The constants of a program that a shader looks up by number: rows of four floats in two textures."""

import hashlib
from dataclasses import dataclass, field

import numpy as np

Array = np.ndarray

WIDTH = 1024  # texels a row of both textures; WebGL 2 guarantees 2,048 rows, most GPUs allow 16,384
HALF_FROM = 4_096  # tables with at least this many floats are stored in halves
HALF_MOST = 6e4


@dataclass
class Tables:
    """Two textures that grow: `exact`, RGBA32F, for places and small tables; `half`, RGBA16F, for large ones."""

    exact: list[Array] = field(default_factory=list)
    half: list[Array] = field(default_factory=list)
    _placed: dict[tuple[bytes, tuple[int, ...], bool], tuple[str, int]] = field(default_factory=dict)

    def place(self, table: Array, exact: bool = False) -> tuple[str, int, int]:
        """The place of a table (rows, channels): the function that reads it, its first number, and numbers a row.

        `exactRow` and `halfRow` read four floats. `exactOne` reads one float of a table with one channel, which stores
        four rows in a texel; such tables hold positions such as heights, which need more precision than halves.
        """
        rows, channels = table.shape
        single, stride = channels == 1, -(-channels // 4)
        small = exact or single or table.dtype.kind != "f" or table.size < HALF_FROM or np.abs(table).max() > HALF_MOST
        key = (hashlib.sha256(table.tobytes()).digest(), table.shape, small)
        blocks = self.exact if small else self.half
        if key not in self._placed:
            start = sum(map(len, blocks))
            padded = np.zeros((-(-rows // 4), 4) if single else (rows, 4 * stride), np.float32)
            padded.reshape(-1, 1 if single else 4 * stride)[:rows, :channels] = table
            blocks.append(padded.reshape(-1, 4))
            reader = "exactOne" if single else "exactRow" if small else "halfRow"
            self._placed[key] = (reader, 4 * start if single else start)
        return (*self._placed[key], stride)

    def texture(self, half: bool) -> Array:
        """One of the textures, (height, WIDTH, 4), with at least one row."""
        blocks = self.half if half else self.exact
        values = np.concatenate([np.zeros((0, 4), np.float32), *blocks])
        height = max(1, -(-len(values) // WIDTH))
        padded = np.zeros((height * WIDTH, 4), np.float16 if half else np.float32)
        padded[: len(values)] = values
        return padded.reshape(height, WIDTH, 4)
