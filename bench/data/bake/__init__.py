"""Bakes a folder of PBR maps to a BTF: recognises them by name, orients them, renders them with
`bench.data.materials.renderer`, or with inter-reflections by a given path tracer.

`neubtf-bench bake` writes the BTF to a given path; a suite or `run --material FOLDER` bakes into the cache.
"""

import hashlib
import json
import logging
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from bench.btf import BAKED, BTF, Array, ArraySource
from bench.codec import Progress
from bench.data.bake.naming import MapFiles, looks_like_maps, recognise
from bench.data.bake.partial import Partial
from bench.data.bake.surface import SUB_POINTS, Surface, read_surface
from bench.data.convert import check_place, write_btf
from bench.data.joined import prepared
from bench.data.materials.maps import Maps
from bench.data.materials.renderer import DESCRIBED, RENDERER_VERSION, render
from bench.data.readers import open_btf
from bench.data.readers.files import FolderFiles
from bench.data.spec import Preparation
from bench.files import atomic
from bench.files.atomic import cache_dir

__all__ = ["PathTracer", "Surface", "bake", "looks_like_maps", "open_svbrdf", "read_surface", "recognise", "table"]
BAKE_VERSION = 2  # increment when maps are read differently; part of the key of every cached bake
log = logging.getLogger(__name__)


class PathTracer(Protocol):
    """A renderer with inter-reflections; `bench.demand.mitsuba.path_tracer` is one."""

    def described(self) -> dict[str, Any]:
        """Describe the renderer for a BTF's provenance."""

    def launches(
        self, maps: Maps, wo: Array, wi: Array, size: tuple[int, int], sub_points: int, seed: int, *, start: int
    ) -> Iterator[Array]:
        """Yield slices (n, H, W, 3) of the pairs wo, wi (N, 3) in order, from pair `start` on."""


def bake(
    surface: Surface, data: Preparation, out: Path, show: Progress, seed: int = 0, path_tracer: PathTracer | None = None
) -> None:
    """Render a surface at the pairs that `data` asks for and write it: `.npz`, or a folder of EXR pictures.

    Pairs are those of the built-in materials (`bench.data.spec`): a product, then held-out pairs, drawn by `seed`.
    Values are linear Rec. 709 f_r · cos θ_i. The result appears under its name when it is complete. If a path tracer is
    killed, its finished slices stay beside `out`, and the same call resumes from them. Raises `InputError` if `out`
    cannot be written or counts are out of range.
    """
    wo, wi = data.everything(surface.name, seed)
    heldout = np.arange(len(wo)) >= data.views * data.lights if data.heldout else None
    _bake(surface, (wo, wi), heldout, _sampled(data) | {"heldout": data.described()}, out, show, seed, path_tracer)


def _bake(
    surface: Surface,
    pairs: tuple[Array, Array],
    heldout: Array | None,
    sampled: dict[str, Any],
    out: Path,
    show: Progress,
    seed: int,
    path_tracer: PathTracer | None,
) -> None:
    """Render a surface at some pairs, which `sampled` describes, into a file or folder; see `bake`."""
    check_place(out)
    (wo, wi), label = pairs, f"baking {surface.name}"
    described = {"source": BAKED, "maps": surface.notes, "bake_version": BAKE_VERSION}
    described |= {"renderer_version": RENDERER_VERSION, "sub_points": SUB_POINTS, "seed": seed} | DESCRIBED | sampled
    described |= path_tracer.described() if path_tracer else {}

    def write(values: Array) -> None:
        source = ArraySource(values)
        write_btf(BTF(surface.name, wo, wi, source, heldout=heldout, periodic=True, provenance=described), out)

    if path_tracer:
        kept = Partial(out, _digest(surface, wo, wi, described), (len(wo), *surface.shape, 3))
        show(label, kept.done, len(wo))
        for slices in path_tracer.launches(surface.maps, wo, wi, surface.shape, SUB_POINTS, seed, start=kept.done):
            kept.add(slices)
            show(label, kept.done, len(wo))
        write(kept.values)
        kept.remove()
        return
    with atomic.temporary(out) as scratch:
        values = atomic.mapped(scratch, np.float32, (len(wo), *surface.shape, 3))
        render(surface.maps, wo, wi, surface.shape, SUB_POINTS, values, show, label)
        write(values)


def _digest(surface: Surface, wo: Array, wi: Array, described: dict[str, Any]) -> str:
    """A hash of everything that determines the values of a surface at the pairs `wo`, `wi`."""
    hashed = hashlib.sha256(json.dumps(described, sort_keys=True, default=str).encode())
    maps = (getattr(surface.maps, f.name) for f in fields(surface.maps))
    for array in (wo, wi, *(m for m in maps if m is not None)):
        hashed.update(str(array.shape).encode() + np.ascontiguousarray(array).tobytes())
    return hashed.hexdigest()


def open_svbrdf(
    folder: Path, data: Preparation, show: Progress, draw: int = 0, path_tracer: PathTracer | None = None
) -> BTF:
    """The BTF of a folder of PBR maps, baked once into the cache and then memory-mapped; `draw` selects its test pairs.

    If a path tracer is killed, its finished slices stay beside the files, and the next call resumes from them. Raises
    `InputError` for maps that cannot be recognised or read, and for counts out of range.
    """
    name = folder.resolve().name

    def cached(pairs: tuple[Array, Array], sampled: dict[str, Any]) -> BTF:
        maps, sampled = recognise(folder), sampled | (path_tracer.described() if path_tracer else {})
        path = cache_dir() / "materials" / f"{name}-{data.size}-{_key(maps, data.size, sampled)[:24]}.npz"
        if not path.exists():
            with atomic.locked(path):  # two processes must not both resume from the slices of a killed one
                if not path.exists():
                    surface = read_surface(maps, data.size)
                    log.warning("baking %s\n%s", folder, table(surface))
                    _bake(surface, pairs, None, sampled, path, show, 0, path_tracer)
        return replace(open_btf(path), name=name)

    return prepared(data, name, 0, draw, _sampled(data), cached)


def table(surface: Surface) -> str:
    """List the recognised maps, one line per map or picture."""
    width = max(map(len, surface.notes))
    return "\n".join(f"  {role:<{width}}  {text}" for role, text in surface.notes.items())


def _key(maps: MapFiles, size: int, sampled: dict[str, Any]) -> str:
    """A hash of everything that determines the values of a bake with default options."""
    content = [FolderFiles(maps.folder).digest(maps.files.values()), sorted(maps.files.items())]
    described = json.dumps([BAKE_VERSION, RENDERER_VERSION, SUB_POINTS, size, sampled, content])
    return hashlib.sha256(described.encode()).hexdigest()


def _sampled(data: Preparation) -> dict[str, Any]:
    return {"directions": f"{data.directions}: {data.views} views, {data.lights} lights"}
