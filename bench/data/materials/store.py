"""Renderings on disk: rendered once, then memory-mapped. A rendering exists when its description (.json) does.

The description is written last and both files are renamed into place, so that an interrupted rendering leaves nothing
that could be read. Values are float16 (half the bytes, 5e-4 relative), float32 where a highlight would overflow.
"""

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from bench import atomic
from bench.btf import BTF, ArraySource
from bench.cache import cache_dir
from bench.data.materials.maps import Recipe
from bench.data.materials.renderer import RENDERER_VERSION, SUB_POINTS, render
from bench.errors import InputError
from bench.hemisphere import DIRECTION_SETS, thin, uniform

Array = np.ndarray
Progress = Callable[[int, int], None]


class StoredSource(ArraySource):
    """A rendering whose fingerprint is the key it was rendered under, so that opening it reads no values."""

    def __init__(self, values: Array, key: str):
        super().__init__(values)
        self._key = key

    def fingerprint(self) -> str:
        return self._key


def load_or_render(
    name: str,
    recipe: Recipe,
    size: int,
    counts: tuple[int, int],
    directions: str,
    heldout: int,
    seed: int,
    progress: Progress | None = None,
) -> BTF:
    """The BTF of a recipe, from the cache or rendered into it. See `bench.data.materials.load`."""
    if size < 1 or heldout < 0:
        raise InputError(f"size must be at least 1 and heldout at least 0, not {size}, {heldout}")
    wo, wi, grid = sample_pairs(directions, counts, heldout, seed)
    described = _describe(name, recipe, size, counts, directions, heldout, seed)
    key = hashlib.sha256(json.dumps(described, sort_keys=True).encode()).hexdigest()
    path = cache_dir() / "materials" / f"{name}-{size}-{key[:24]}.npy"
    shape = (len(wo), size, size, 3)
    values = _read(path, shape)
    if values is None:
        with atomic.alone(path):
            values = _read(path, shape)
            if values is None:
                _write(path, recipe, wo, wi, shape, seed, described, progress)
                values = _read(path, shape)
    if values is None:
        raise InputError(f"{path}: cannot be read back after writing it; is the disk full?")
    source = StoredSource(values, key)
    return BTF(name, wo, wi, source, heldout=np.arange(len(wo)) >= grid, periodic=True, provenance=described)


def sample_pairs(directions: str, counts: tuple[int, int], heldout: int, seed: int) -> tuple[Array, Array, int]:
    """`wo` and `wi` (N, 3) float32: a product grid, view-major, then random pairs; and the number of the former."""
    if directions not in DIRECTION_SETS:
        raise InputError(f"unknown direction set {directions!r}: there are {', '.join(DIRECTION_SETS)}")
    everything = DIRECTION_SETS[directions]()
    if not all(1 <= count <= len(everything) for count in counts):
        raise InputError(f"views and lights must be between 1 and the {len(everything)} of {directions}, not {counts}")
    views, lights = (everything[thin(everything, count)] for count in counts)
    rng = np.random.default_rng([seed, 0x5EED])
    random_wo, random_wi = uniform(rng, heldout), uniform(rng, heldout)
    wo = np.concatenate([np.repeat(views, len(lights), 0), random_wo])
    wi = np.concatenate([np.tile(lights, (len(views), 1)), random_wi])
    return wo, wi, len(views) * len(lights)


def _describe(
    name: str, recipe: Recipe, size: int, counts: tuple[int, int], directions: str, heldout: int, seed: int
) -> dict[str, Any]:
    """Everything that shapes the values: the cache key is its hash, and `BTF.provenance` holds it."""
    return {
        "source": "rendered by bench.materials",
        "renderer_version": RENDERER_VERSION,
        "material": name,
        "recipe": type(recipe).__name__,
        "parameters": asdict(recipe),  # type: ignore[call-overload]
        "seed": seed,
        "size": size,
        "sub_points": SUB_POINTS,
        "directions": directions,
        "views": counts[0],
        "lights": counts[1],
        "heldout": f"{heldout} pairs uniform in solid angle, theta_deg <= 75",
        "values": "linear Rec. 709, f_r * cos(theta_i) * visibility, mean over the sub-points, no clamp",
        "reference_plane": "mean height",
        "transport": "direct light, self-shadowing; no inter-reflection",
        "reflectance": "GGX (Walter 2007, Burley 2012), Smith (Heitz 2014), Schlick Fresnel, coupled Lambert",
    }


def _read(path: Path, shape: tuple[int, ...]) -> Array | None:
    """The stored values, memory-mapped; None where there is no finished rendering of that shape."""
    if not path.with_suffix(".json").exists():
        return None
    try:
        values: Array = np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError, EOFError):
        return None
    return values if values.shape == shape else None


def _write(
    path: Path,
    recipe: Recipe,
    wo: Array,
    wi: Array,
    shape: tuple[int, ...],
    seed: int,
    described: dict[str, Any],
    progress: Progress | None,
) -> None:
    maps = recipe.maps(seed)
    with atomic.replacing(path) as partial:
        for dtype in (np.float16, np.float32):
            values = atomic.mapped(partial, dtype, shape)
            render(maps, wo, wi, (shape[1], shape[2]), SUB_POINTS, values, progress)
            if all(np.isfinite(picture).all() for picture in values):
                break
    atomic.write(path.with_suffix(".json"), json.dumps(described, indent=1, sort_keys=True).encode())
