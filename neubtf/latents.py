"""The channels of a neural texture as a picture in colour."""

import math
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from bench.btf import box_filter
from bench.files.atomic import PNG, begins, refuse_other_kind, replacing
from bench.inputs.errors import writable

# Least pixels of a channel's longer side. It has fewer than twice as many, unless that would leave the other side none.
SIDE = 192
GAP = 6  # pixels between channels
WHITE = 255


def display_values(texture: Tensor) -> Tensor:
    """The channels of a texture (H, W, D) from 0 to 1, as the paper draws them.

    Each is brought to mean 0 and variance 1, and its values x become 1 / (e^(1 − x) + 1). A constant one has x = 0.
    """
    flat = texture.double().flatten(0, 1)
    deviation = flat.std(0, correction=0)  # (D,)
    is_constant = deviation <= 1e-6 * flat.abs().amax(0)  # but for rounding
    scaled = (flat - flat.mean(0)) / torch.where(is_constant, torch.inf, deviation)
    return (scaled - 1).sigmoid().reshape(texture.shape).float()


def _cells(texture: Tensor) -> np.ndarray:
    """The channels of a texture (H, W, D), three a picture, as pictures in colour (n, h, w, 3), uint8.

    They are shrunk or enlarged to about `SIDE` pixels. Channels that the last picture lacks are black there.
    """
    channels = display_values(texture).numpy()  # from 0 to 1
    shrink = max(channels.shape[:2]) // SIDE  # texels a side of a pixel
    if 2 <= shrink <= min(channels.shape[:2]):  # a narrower texture would have no texel left on its short side
        channels = box_filter(channels, shrink)
    grow = math.ceil(SIDE / max(channels.shape[:2]))  # pixels a side of a texel, rounded up
    bytes_of_texels = (channels * WHITE).round().astype(np.uint8)
    lacking = -bytes_of_texels.shape[2] % 3
    padded = np.pad(bytes_of_texels, ((0, 0), (0, 0), (0, lacking)))
    enlarged = padded.repeat(grow, 0).repeat(grow, 1)
    height, width, _ = enlarged.shape
    return enlarged.reshape(height, width, -1, 3).transpose(2, 0, 1, 3)


def sheet(texture: Tensor) -> np.ndarray:
    """The contact sheet (h, w, 3) uint8 of a texture (H, W, D): pictures of three channels row by row, about square."""
    cells = _cells(texture)
    count, height, width, _ = cells.shape
    # Each cell has its gap above and at the left. The sheet is about square.
    framed_height, framed_width = height + GAP, width + GAP
    columns = round(np.sqrt(count * framed_height / framed_width))
    columns = min(count, max(1, columns))
    rows = math.ceil(count / columns)
    framed = np.full((rows * columns, framed_height, framed_width, 3), WHITE, np.uint8)
    framed[:count, GAP:, GAP:] = cells
    by_row = framed.reshape(rows, columns, framed_height, framed_width, 3).swapaxes(1, 2)  # (rows, h, columns, w, 3)
    page = by_row.reshape(rows * framed_height, columns * framed_width, 3)
    return np.pad(page, ((0, GAP), (0, GAP), (0, 0)), constant_values=WHITE)


def draw(texture: Tensor, out: Path) -> None:
    """Write the contact sheet of a texture (H, W, D) as a PNG. `InputError` if `out` cannot be written."""
    refuse_other_kind(out, ".png", begins(PNG))
    with writable(out), replacing(out) as partial:
        Image.fromarray(sheet(texture)).save(partial, format="png", optimize=True)
