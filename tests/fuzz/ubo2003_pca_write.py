"""Writes a folder of UBO2003's local PCA in PNGs from its codes."""

import json
from pathlib import Path

import numpy as np
from PIL import Image

from bench.data.readers.ubo2003_pca import BLOCKS, COMPONENTS, KNOWN, NOTES, WEIGHTS

Array = np.ndarray


def write_ubo2003_pca(folder: Path, components: Array, weights: Array, singular: Array) -> Path:
    """Write bytes as pictures and `meta.json`; the folder is returned.

    `components` (27, H, W, 8) of each block's texels, `weights` (27, 3 views, 81 lights, 3 colours, 8) and `singular`
    (27, 8, 2), the tens and the tenths of the singular values, are uint8; H = W must be even.
    """
    folder.mkdir(parents=True, exist_ok=True)
    size = components.shape[1]
    for j in range(COMPONENTS):
        save(folder / f"{j}.png", components[..., j].reshape(BLOCKS, -1))
    packed = np.concatenate([weights.reshape(-1), singular.reshape(-1)])
    side = int(np.ceil(np.sqrt(packed.size / 4)))
    save(folder / WEIGHTS, np.resize(np.pad(packed, (0, 4 * side * side - packed.size)), (side, 4 * side)))
    notes = {**KNOWN, "texSize": 2048, "imageSize": size, "RSize": side}
    (folder / NOTES).write_text(json.dumps({key: str(value) for key, value in notes.items()}))
    return folder


def save(path: Path, data: Array) -> None:
    Image.fromarray(data.reshape(len(data), -1, 4), "RGBA").save(path)


def random_codes(size: int, seed: int = 0) -> tuple[Array, Array, Array]:
    """Codes of a made-up material whose values lie mostly in [0, 1]."""
    rng = np.random.default_rng(seed)
    components = rng.integers(0, 256, (BLOCKS, size, size, COMPONENTS), np.uint8)
    weights = rng.integers(100, 156, (BLOCKS, 3, 81, 3, COMPONENTS), np.uint8)
    components[..., 0], weights[..., 0] = 230, rng.integers(180, 220, weights.shape[:-1])  # the mean
    singular = rng.integers(0, 10, (BLOCKS, COMPONENTS, 2), np.uint8) * np.array([0, 1], np.uint8)
    singular[:, 0] = 0, 12
    return components, weights, singular
