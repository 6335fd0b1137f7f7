"""The part of a texture that a file fitted to a scene holds: a window of texels, and maps of demanded directions."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from bench.btf import BTF, Array

CELLS = 16  # cells per side of the map of demanded directions, over the stereographic plane


@dataclass(frozen=True)
class Window:
    """A window of a periodic texture of `size` texels, from (top, left), stored in boxes of factor × factor.

    All numbers count texels of the whole texture; `size` is (H, W).
    """

    size: tuple[int, int]
    top: int
    left: int
    height: int
    width: int
    factor: int = 1

    @classmethod
    def whole(cls, size: tuple[int, int], factor: int = 1) -> "Window":
        """The window of the whole texture, without texels that do not fill a box."""
        # Each side rounded down to a multiple of `factor`.
        height = size[0] // factor * factor
        width = size[1] // factor * factor
        return cls(size, top=0, left=0, height=height, width=width, factor=factor)

    @property
    def full(self) -> bool:
        """Whether it is the whole texture, without texels that do not fill a box."""
        return self.sides == Window.whole(self.size, self.factor).sides

    @property
    def stretch(self) -> float:
        """The factor that converts a footprint, as a share of the texture's longer side, to one of the window's."""
        return max(self.size) / max(self.height, self.width)

    def cut(self, btf: BTF) -> BTF:
        """The part of a BTF in the window, as means over its boxes of factor × factor texels."""
        part = btf if self.full else btf.crop(self.top, self.left, self.height, self.width)
        return part.downsample(self.factor)

    @property
    def sides(self) -> tuple[int, int]:
        """Height and width in texels of the whole texture."""
        return self.height, self.width

    def within(self, uv: Tensor) -> Tensor:
        """uv (n, 2) of the whole texture in units of the window; beyond its border, the nearest texel."""
        # v points up, but rows count down from the top.
        u = self._share_of_window(uv[:, 0], self.left, self.width, self.size[1])
        v = self._share_of_window(1 - uv[:, 1], self.top, self.height, self.size[0])
        return torch.stack([u, 1 - v], 1)

    def _share_of_window(self, place: Tensor, start: int, length: int, side: int) -> Tensor:
        """Places (n,) along one axis, from shares of the texture's side to shares of the window's side.

        The texture's side has `side` texels, of which the window has `length` from texel `start` on.
        """
        if length == side:  # the window has the whole axis
            return place
        texels = (place * side - start).remainder(side)  # after the window's start, around the texture's border
        half = self.factor / 2
        # Those beyond the middle of the gap, from `length` to `side`, are nearer to the window's start than to its
        # end. As negative places they are clamped to the start.
        texels = torch.where(texels > (length + side) / 2, texels - side, texels)
        # Between centres of boxes, because a look-up nearer to a border would mix in the opposite one.
        return texels.clamp(half, length - half) / length

    def holds(self, uv: Tensor) -> Tensor:
        """Mask (n,) of the uv (n, 2) that lie in the window."""
        whole = Window.whole(self.size, self.factor)  # texels that do not fill a box do not count as left out
        inside = torch.ones(len(uv), dtype=torch.bool, device=uv.device)
        # Texels after the window's start, around the texture's border, are in it up to its width or height.
        if self.width != whole.width:
            inside &= (uv[:, 0] * self.size[1] - self.left).remainder(self.size[1]) <= self.width
        if self.height != whole.height:
            inside &= ((1 - uv[:, 1]) * self.size[0] - self.top).remainder(self.size[0]) <= self.height
        return inside


def cell_of(directions: Tensor) -> Tensor:
    """The number row · CELLS + column (n,) int32 of directions (n, 3) in a map of the stereographic plane."""
    # (x, y) / (1 + z) maps the upper hemisphere onto the unit disc; scaled and shifted, it spans 0 to CELLS.
    scale = CELLS / 2 / (1 + directions[:, 2])
    # At the horizon an end of an axis would begin a cell beyond the map.
    column = (directions[:, 0] * scale + CELLS / 2).int().clamp_(0, CELLS - 1)
    row = (directions[:, 1] * scale + CELLS / 2).int().clamp_(0, CELLS - 1)
    return row * CELLS + column


def to_hex(cells: Array) -> str:
    """A map (CELLS, CELLS) bool as a file records it: one bit a cell, row by row, in hexadecimal digits."""
    return np.packbits(cells).tobytes().hex()


def from_hex(text: str) -> Array:
    """The map (CELLS, CELLS) that a file records. `ValueError` if it is invalid."""
    packed = np.frombuffer(bytes.fromhex(text), np.uint8)
    return np.unpackbits(packed).reshape(CELLS, CELLS).astype(bool)
