"""Small materials for the codecs, what they answer of them, and pieces of oracles in NumPy."""

from pathlib import Path
from typing import Any

import numpy as np
import torch

from bench.btf import BTF, ArraySource
from bench.codec import Codec, Fit, Parts
from bench.codecs import container, loading
from bench.conformance.check import tiny_btf
from bench.directions import hemisphere
from bench.material import Material

CPU = torch.device("cpu")


def btf_of(values: np.ndarray, views: int) -> BTF:
    """Values (views · lights, H, W, 3) as a BTF over a product of thinned directions."""
    lights = len(values) // views
    directions = hemisphere.ubo2003()
    wo, wi = (directions[hemisphere.thin(directions, n)] for n in (views, lights))
    return BTF("made", np.repeat(wo, lights, 0), np.tile(wi, (views, 1)), ArraySource(values.astype(np.float32)))


def at_tiny_pairs(values: np.ndarray) -> BTF:
    """Values (81, H, W, 3), or what broadcasts to them, at the pairs of `tiny_btf`."""
    like = tiny_btf()
    values = np.broadcast_to(values, (len(like), *values.shape[1:])).astype(np.float32)
    return BTF("made", like.wo, like.wi, ArraySource(values), periodic=True)


def cropped(height: int, width: int) -> BTF:
    return at_tiny_pairs(np.stack(list(tiny_btf(8)))[:, :height, :width])


def noise(height: int, width: int) -> BTF:
    return at_tiny_pairs(np.random.default_rng(0).uniform(0, 1, (81, height, width, 3)))


def decoded(codec: Codec, btf: BTF, fit: Fit | None = None) -> Any:
    return codec.decode(codec.encode(btf, fit or Fit()), CPU)


def coded(codec: Codec, btf: BTF | None = None, fit: Fit | None = None) -> tuple[Parts, Any]:
    """What a file holds of a BTF, by default the small one, and what it decodes to."""
    parts = codec.encode(btf or tiny_btf(), fit or Fit())
    return parts, codec.decode(parts, CPU)


def stored(codec: Codec, btf: BTF, folder: Path) -> Material:
    """What its file decodes to."""
    container.save(folder / "a.nbtf", codec, codec.encode(btf, Fit()))
    return loading.load(folder / "a.nbtf")[1]


def table(btf: BTF) -> np.ndarray:
    return np.stack(list(btf))


def slices(material: Material, btf: BTF) -> np.ndarray:
    return np.stack([material.slice(wo, wi).numpy() for wo, wi in zip(btf.wo.tolist(), btf.wi.tolist(), strict=True)])


def about(axis: int, angle: float) -> np.ndarray:
    """The rotation matrix about a coordinate axis, right-handed."""
    c, s = np.cos(angle), np.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    out = np.eye(3)
    out[i, i], out[i, j], out[j, i], out[j, j] = c, -s, s, c
    return out


def oracle_difference(wo: np.ndarray, wi: np.ndarray, kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Rotation matrices instead of closed forms: the shortest turn goes about z × h."""
    h = (wo + wi) / np.linalg.norm(wo + wi)
    theta, phi = np.arccos(np.clip(h[2], -1, 1)), np.arctan2(h[1], h[0])
    turn = about(1, -theta) @ about(2, -phi)
    return h, (turn if kind == "rusinkiewicz" else about(2, phi) @ turn) @ wi


def fetch(plane: np.ndarray, x: float, y: float) -> np.ndarray:
    """Bilinear between texels whose first and last centres are −1 and 1; y grows upwards, rows downwards."""
    side = len(plane)
    col, row = (x + 1) / 2 * (side - 1), (1 - y) / 2 * (side - 1)
    i, j = min(int(row), side - 2), min(int(col), side - 2)
    a, b = row - i, col - j
    top = (1 - b) * plane[i, j] + b * plane[i, j + 1]
    return (1 - a) * top + a * ((1 - b) * plane[i + 1, j] + b * plane[i + 1, j + 1])


def bilinear(texture: np.ndarray, u: float, v: float) -> np.ndarray:
    """A periodic texture (H, W, C) between its four texels around (u, v), v upwards."""
    height, width = texture.shape[:2]
    y, x = (1 - v) * height - 0.5, u * width - 0.5
    top, left = int(np.floor(y)), int(np.floor(x))
    b, a = y - top, x - left
    corners = [[texture[(top + i) % height, (left + j) % width] for j in (0, 1)] for i in (0, 1)]
    upper, lower = ((1 - a) * near + a * far for near, far in corners)
    mixed: np.ndarray = (1 - b) * upper + b * lower
    return mixed


def split(vector: Any, *shapes: tuple[int, ...]) -> list[np.ndarray]:
    """Consecutive arrays of these shapes; they take the whole vector."""
    parts = np.split(np.asarray(vector, np.float64), np.cumsum([np.prod(shape) for shape in shapes]))
    assert len(parts.pop()) == 0
    return [part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)]


def dense(*sizes: tuple[int, int]) -> list[tuple[int, ...]]:
    """The shapes of layers with their biases, of so many outputs and inputs each."""
    return [shape for rows, cols in sizes for shape in ((rows, cols), (rows,))]


def leaky(x: np.ndarray) -> np.ndarray:
    return np.where(x > 0, x, 0.01 * x)


def normed_sines(x: np.ndarray, weights: Any, *sizes: tuple[int, int]) -> np.ndarray:
    """Layers of which all but the last give the sine of twice a layer norm; from the second on the input is added."""
    inner = len(sizes) - 1
    arrays = split(weights, *dense(*sizes), *((rows,) for rows, _ in sizes[:-1] for _ in "go"))
    layers, norms = arrays[: 2 * len(sizes)], arrays[2 * len(sizes) :]
    for depth in range(inner):
        y = layers[2 * depth] @ x + layers[2 * depth + 1]
        y = np.sin(2 * ((y - y.mean()) / np.sqrt(y.var() + 1e-5) * norms[2 * depth] + norms[2 * depth + 1]))
        x = y + x if depth else y
    last: np.ndarray = layers[-2] @ x + layers[-1]
    return last
