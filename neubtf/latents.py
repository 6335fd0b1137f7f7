"""The channels of a neural texture as a picture."""

from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from bench.btf import box_filter
from bench.files.atomic import replacing
from bench.inputs.errors import writable

SIDE = 192  # least pixels of a channel's longer side, which has fewer than twice as many
GAP = 6  # pixels between channels
WHITE = 255


def standardised(texture: Tensor) -> Tensor:
    """A texture (H, W, D) with each channel c at mean 0 and variance 1 or 0, then the paper's 1 / (e^(1 − c) + 1)."""
    flat = texture.double().flatten(0, 1)
    deviation = flat.std(0, correction=0)
    steady = deviation <= 1e-6 * flat.abs().amax(0)
    scaled = (flat - flat.mean(0)) / torch.where(steady, torch.inf, deviation)
    return (scaled - 1).sigmoid().reshape(texture.shape).float()


def sheet(texture: Tensor) -> np.ndarray:
    """The contact sheet (h, w) uint8 of a texture (H, W, D): channels row by row, about square."""
    shown = standardised(texture).numpy()
    longest = max(shown.shape[:2])
    if longest >= 2 * SIDE:
        shown = box_filter(shown, longest // SIDE if min(shown.shape[:2]) >= longest // SIDE else 1)
    grow = -(-SIDE // max(shown.shape[:2]))
    cells = (shown * WHITE).round().astype(np.uint8).repeat(grow, 0).repeat(grow, 1)  # (h, w, D)
    height, width, count = cells.shape
    columns = min(count, max(1, round(np.sqrt(count * (height + GAP) / (width + GAP)))))
    rows = -(-count // columns)
    framed = np.full((rows * columns, height + GAP, width + GAP), WHITE, np.uint8)
    framed[:count, GAP:, GAP:] = cells.transpose(2, 0, 1)
    # (rows, columns, h, w), then (rows, h, columns, w), then (rows · h, columns · w).
    page = framed.reshape(rows, columns, height + GAP, -1).swapaxes(1, 2).reshape(rows * (height + GAP), -1)
    return np.pad(page, ((0, GAP), (0, GAP)), constant_values=WHITE)


def draw(texture: Tensor, out: Path) -> None:
    """Write the contact sheet of a texture (H, W, D) as a PNG. `InputError` if `out` cannot be written."""
    with writable(out), replacing(out) as partial:
        Image.fromarray(sheet(texture)).save(partial, format="png", optimize=True)
