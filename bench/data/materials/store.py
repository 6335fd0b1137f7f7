"""Renderings on disk: rendered once, then memory-mapped. A rendering exists when its description (.json) does.

The description is written last and both files are renamed into place, so readers never accept an interrupted rendering.
Values are float16 (half the bytes, 5e-4 relative), or float32 if a highlight would overflow.

There is a rendering for each `Table`, the pairs of one kind (to train on, for test, for validation, of low light,
between texels), so that another draw of test pairs renders only its tables again.
"""

import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.btf import BTF, RENDERED, Array, ArraySource
from bench.data.joined import joined
from bench.data.materials.maps import Maps, Recipe
from bench.data.materials.renderer import DESCRIBED, RENDERER_VERSION, SUB_POINTS, half_a_texel_further, render
from bench.data.spec import Preparation, Table
from bench.files import atomic
from bench.files.atomic import cache_dir
from bench.inputs.errors import InputError

if TYPE_CHECKING:
    from bench.codec import Progress


class StoredSource(ArraySource):
    """A rendering (N, H, W, 3) whose fingerprint is its cache key, so that opening it reads no values."""

    def __init__(self, values: Array, key: str):
        super().__init__(values)
        self._key = key

    def fingerprint(self) -> str:
        return self._key


def load_or_render(
    name: str, recipe: Recipe, data: Preparation, seed: int = 0, draw: int = 0, show: "Progress | None" = None
) -> BTF:
    """The BTF of a recipe, from the cache or rendered into it; see `bench.data.materials.load`.

    `seed` is that of the random structure and of the held-out pairs, `draw` numbers the draw of test pairs.
    """
    if data.size < 1:
        raise InputError(f"size must be at least 1, not {data.size}")
    directions: dict[str, Any] = {"directions": data.directions, "views": data.views, "lights": data.lights}

    def of_table(table: Table) -> BTF:
        """The rendering of a table."""
        described = _described(name, recipe, seed, data.size)
        # A table of held-out pairs is described in words, the product by its directions.
        described |= {"heldout": table.words} if table.words else directions
        key = hashlib.sha256(json.dumps(described, sort_keys=True).encode()).hexdigest()
        path = cache_dir() / "materials" / f"{name}-{data.size}-{key[:24]}.npy"
        wo, wi = table.pairs
        shape = (len(wo), data.size, data.size, 3)
        values = _read(path, shape)
        if values is None:
            with atomic.locked(path):
                values = _read(path, shape)  # another process may have rendered it meanwhile
                if values is None:
                    _write(path, recipe.maps(seed), table, described, show)
                    values = _read(path, shape)
        assert values is not None  # what cannot be written is an error before
        no_heldout = np.zeros(len(values), bool)  # `joined` marks the held-out pairs
        return BTF(name, wo, wi, StoredSource(values, key), heldout=no_heldout, periodic=True, provenance=described)

    return joined(data.tables(name, seed, draw), of_table)


def _described(name: str, recipe: Recipe, seed: int, size: int) -> dict[str, Any]:
    """Everything that determines the values, by name, except the directions, which the caller adds.

    With them it is the provenance of the BTF, and its hash is the cache key. So no key or value may change.
    """
    described: dict[str, Any] = {"source": RENDERED, "renderer_version": RENDERER_VERSION, "material": name}
    described |= {"recipe": type(recipe).__name__, "parameters": asdict(recipe)}  # type: ignore[call-overload]
    return described | {"seed": seed, "size": size, "sub_points": SUB_POINTS} | DESCRIBED


def _read(path: Path, shape: tuple[int, ...]) -> Array | None:
    """The stored values, memory-mapped; None if there is no finished rendering of that shape."""
    if not path.with_suffix(".json").exists():
        return None
    try:
        values: Array = np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError, EOFError):
        return None
    return values if values.shape == shape else None


def _write(path: Path, maps: Maps, table: Table, described: dict[str, Any], show: "Progress | None") -> None:
    """Render the slices of a table into `path` as float16, or again as float32 if one overflows; then write their
    description `described` beside it, as the same name with the ending `.json`."""
    size = described["size"]
    wo, wi = table.pairs
    label = f"rendering {described['material']}"
    if table.kind == "between":
        maps = half_a_texel_further(maps, (size, size), SUB_POINTS)
    with atomic.replacing(path) as partial:
        # Highlights that overflow become infinite.
        for dtype in (np.float16, np.float32):
            values = atomic.mapped(partial, dtype, (len(wo), size, size, 3))
            render(maps, wo, wi, (size, size), SUB_POINTS, values, show, label)
            if all(np.isfinite(picture).all() for picture in values):
                break
        values.flush()  # to the disk, before a description says that it is there
    atomic.write(path.with_suffix(".json"), json.dumps(described, indent=1, sort_keys=True).encode())
