"""A folder of PBR maps becomes a BTF: recognised by name, turned the right way, rendered by `bench.materials.renderer`.

`neubtf-bench bake` writes it where it is told; a suite or `run --material FOLDER` bakes into the cache.
"""

import hashlib
import json
import logging
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from bench.bake.naming import MapFiles, looks_like_maps, recognise
from bench.bake.surface import SUB_POINTS, Surface, read_surface
from bench.btf import BTF, ArraySource
from bench.cache import cache_dir
from bench.convert import check_place, write_btf
from bench.materials.renderer import RENDERER_VERSION, render
from bench.materials.store import sample_pairs
from bench.readers import open_btf
from bench.readers.files import FolderFiles
from bench.suite import Data

__all__ = ["Surface", "bake", "looks_like_maps", "open_svbrdf", "read_surface", "recognise", "table"]
BAKE_VERSION = 1  # raised whenever a map is read otherwise; part of the key of every cached bake
log = logging.getLogger(__name__)


def bake(surface: Surface, data: Data, out: Path, progress: Callable[[int, int], None], seed: int = 0) -> None:
    """Render a surface at the pairs that `data` asks for and write it: `.npz`, or a folder of EXR pictures.

    Pairs are those of the built-in materials (`bench.materials.load`): a product, then held-out pairs drawn by `seed`.
    Values are linear Rec. 709 f_r · cos θ_i. The result appears under its name when it is complete.
    """
    check_place(out)
    wo, wi, grid = sample_pairs(data.directions, (data.views, data.lights), data.heldout, seed)
    scratch = out.with_name(f".{out.name}.{os.getpid()}.values")
    try:
        values = np.lib.format.open_memmap(scratch, "w+", dtype=np.float32, shape=(len(wo), *surface.shape, 3))
        render(surface.maps, wo, wi, surface.shape, SUB_POINTS, values, progress)
        heldout = np.arange(len(wo)) >= grid if data.heldout else None
        source = ArraySource(values)
        described = _described(surface, data, seed)
        write_btf(BTF(surface.name, wo, wi, source, heldout=heldout, periodic=True, provenance=described), out)
    finally:
        scratch.unlink(missing_ok=True)


def open_svbrdf(folder: Path, data: Data, progress: Callable[[int, int], None]) -> BTF:
    """The BTF of a folder of PBR maps, baked once into the cache and then memory-mapped.

    Raises `InputError` for maps that cannot be recognised or read, and for counts out of range.
    """
    found = recognise(folder)
    path = cache_dir() / "materials" / f"{folder.resolve().name}-{data.size}-{_key(found, data)[:24]}.npz"
    if not path.exists():
        surface = read_surface(found, data.size)
        path.parent.mkdir(parents=True, exist_ok=True)
        log.warning("baking %s\n%s", folder, table(surface))
        bake(surface, data, path, progress)
    btf = open_btf(path)
    btf.name = folder.resolve().name
    return btf


def table(surface: Surface) -> str:
    """What was recognised, a line a map or picture."""
    width = max(map(len, surface.notes))
    return "\n".join(f"  {role:<{width}}  {text}" for role, text in surface.notes.items())


def _key(found: MapFiles, data: Data) -> str:
    """Everything that shapes the values of a bake with its defaults."""
    sampling = [data.size, data.directions, data.views, data.lights, data.heldout]
    content = [FolderFiles(found.folder).digest(found.files.values()), sorted(found.files.items())]
    described = json.dumps([BAKE_VERSION, RENDERER_VERSION, SUB_POINTS, sampling, content])
    return hashlib.sha256(described.encode()).hexdigest()


def _described(surface: Surface, data: Data, seed: int) -> dict[str, Any]:
    return {
        "source": "baked from maps by bench.bake",
        "maps": surface.notes,
        "bake_version": BAKE_VERSION,
        "renderer_version": RENDERER_VERSION,
        "sub_points": SUB_POINTS,
        "seed": seed,
        "directions": f"{data.directions}: {data.views} views, {data.lights} lights",
        "heldout": f"{data.heldout} pairs uniform in solid angle, theta_deg <= 75",
        "values": "linear Rec. 709, f_r * cos(theta_i) * visibility, mean over the sub-points, no clamp",
        "reference_plane": "mean height",
        "transport": "direct light, self-shadowing; no inter-reflection",
        "reflectance": "GGX (Walter 2007, Burley 2012), Smith (Heitz 2014), Schlick Fresnel, coupled Lambert",
    }
