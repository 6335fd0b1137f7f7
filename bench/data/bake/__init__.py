"""Bakes a folder of PBR maps to a BTF: recognises them by name, orients them, renders them with
`bench.data.materials.renderer`, or with inter-reflections by a given path tracer.

`neubtf-bench bake` writes the BTF to a given path; a suite or `run --material FOLDER` bakes into the cache. The pairs
are a product of views and lights, to train on, and held-out ones. `bake` puts both into one file. The cache has a file
for each `Table`, the pairs of one kind, so that another draw of test pairs bakes only that table again.

A *provenance* is what a BTF says of how its values were made; it is stored in the file.
"""

import hashlib
import json
import logging
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from bench.btf import BAKED, BTF, Array, ArraySource
from bench.codec import Progress
from bench.data.bake.naming import MapFiles, looks_like_maps, recognise
from bench.data.bake.surface import SUB_POINTS, Surface, read_surface
from bench.data.convert import check_place, write_btf
from bench.data.joined import joined
from bench.data.materials.maps import Maps
from bench.data.materials.renderer import DESCRIBED, RENDERER_VERSION, half_a_texel_further, render
from bench.data.readers import open_btf
from bench.data.readers.files import FolderFiles
from bench.data.readers.npz import NpzSource
from bench.data.spec import Preparation, Table
from bench.files import atomic
from bench.files.atomic import cache_dir

__all__ = ["PathTracer", "Surface", "bake", "looks_like_maps", "open_svbrdf", "read_surface", "recognise"]
__all__ += ["size_note", "table"]
# Increment when maps are read differently: it is part of the cache key, and so of the fingerprints of published rows.
BAKE_VERSION = 2
log = logging.getLogger(__name__)


class PathTracer(Protocol):
    """A renderer with inter-reflections; `bench.demand.mitsuba.path_tracer` is one.

    It renders the pairs in launches, each of several slices.
    """

    def provenance(self) -> dict[str, Any]:
        """Describe the renderer for a BTF's provenance."""

    def launches(
        self, maps: Maps, wo: Array, wi: Array, size: tuple[int, int], sub_points: int, seed: int
    ) -> Iterator[Array]:
        """Yield the slices of the pairs wo, wi (N, 3) in order, an array (n, H, W, 3) a launch.

        `size` is (H, W), and each texel the mean of sub_points² points, whose random numbers `seed` determines.
        """


def bake(
    surface: Surface, data: Preparation, out: Path, show: Progress, seed: int = 0, path_tracer: PathTracer | None = None
) -> None:
    """Render a surface at the pairs that `data` asks for and write it: `.npz`, or a folder of EXR pictures.

    Pairs are those of the built-in materials (`bench.data.spec`): a product, then held-out pairs, drawn by `seed`.
    Values are linear Rec. 709 f_r · cos θ_i. `show` is told how many pairs are rendered. The result appears under its
    name when it is complete. Without `path_tracer` the suite's renderer renders. Raises `InputError` if `out` cannot be
    written or counts are out of range.
    """
    check_place(out)
    wo, wi = data.all_pairs(surface.name, seed)
    heldout = None
    if data.heldout:  # the held-out pairs come after the product
        heldout = np.arange(len(wo)) >= data.views * data.lights
    pair_notes = _product_notes(data) | {"heldout": data.described()}
    _render_to(out, surface, (wo, wi), heldout, pair_notes, show, seed, path_tracer)


def _render_to(
    out: Path,
    surface: Surface,
    pairs: tuple[Array, Array],
    heldout: Array | None,
    pair_notes: dict[str, Any],
    show: Progress,
    seed: int,
    path_tracer: PathTracer | None,
) -> None:
    """Render a surface at `pairs`, wo and wi (N, 3), and write it as `bake` does.

    `pair_notes` are what the provenance says of the pairs. `heldout` is the mask (N,) of the held-out pairs; None if
    there are none, or if the caller marks them. `seed` is that of the path tracer's random numbers.
    """
    wo, wi = pairs
    label = f"baking {surface.name}"
    provenance = {"source": BAKED, "maps": surface.notes, "bake_version": BAKE_VERSION}
    provenance |= {"renderer_version": RENDERER_VERSION, "sub_points": SUB_POINTS, "seed": seed}
    provenance |= DESCRIBED | pair_notes
    if path_tracer:
        provenance |= path_tracer.provenance()
    # The slices go to a file that is removed at the end, also after an error.
    with atomic.temporary(out) as scratch:
        values = atomic.mapped(scratch, np.float32, (len(wo), *surface.shape, 3))
        if path_tracer:
            done = 0
            show(label, done, len(wo))
            for slices in path_tracer.launches(surface.maps, wo, wi, surface.shape, SUB_POINTS, seed):
                values[done : done + len(slices)] = slices
                done += len(slices)
                show(label, done, len(wo))
        else:
            render(surface.maps, wo, wi, surface.shape, SUB_POINTS, values, show, label)
        source = ArraySource(values)
        write_btf(BTF(surface.name, wo, wi, source, heldout=heldout, periodic=True, provenance=provenance), out)


def open_svbrdf(
    folder: Path, data: Preparation, show: Progress, draw: int = 0, path_tracer: PathTracer | None = None
) -> BTF:
    """The BTF of a folder of PBR maps, baked once into the cache and then memory-mapped; `draw` selects its test pairs.

    Raises `InputError` for maps that cannot be recognised or read, and for counts out of range.
    """
    name = folder.resolve().name  # `.` has no name of its own
    map_files = recognise(folder)

    @cache
    def surface_once() -> Surface:
        """The surface that all tables are rendered from, read and described once."""
        surface = read_surface(map_files, data.size)
        log.warning("baking %s at %s\n%s", folder, size_note(surface), table(surface))
        return surface

    def cached(pair_table: Table) -> BTF:
        """The BTF of one table of pairs, baked into the cache if it is not there."""
        # A table of held-out pairs is described in words, the product by its directions.
        pair_notes: dict[str, Any] = {"heldout": pair_table.words} if pair_table.words else _product_notes(data)
        if path_tracer:
            pair_notes |= path_tracer.provenance()
        key = _cache_key(map_files, data.size, pair_notes)
        path = cache_dir() / "materials" / f"{name}-{data.size}-{key[:24]}.npz"

        def make() -> None:
            surface = surface_once()
            if pair_table.kind == "between":
                moved = half_a_texel_further(surface.maps, surface.shape, SUB_POINTS)
                surface = replace(surface, maps=moved)
            # `joined` marks the held-out pairs.
            _render_to(path, surface, pair_table.pairs, None, pair_notes, show, seed=0, path_tracer=path_tracer)

        atomic.make_once(path, make)
        btf = open_btf(path)
        assert isinstance(btf.source, NpzSource)
        return replace(btf, name=name, source=_Kept(btf.source, key))  # a reader names it by the file in the cache

    return joined(data.tables(name, seed=0, draw=draw), cached)


class _Kept(NpzSource):
    """A bake in the cache. Its fingerprint is its cache key, not a hash of its values: these differ in the last bits
    between processors, which changes no score."""

    def __init__(self, source: NpzSource, key: str):
        super().__init__(source.values, source.path)
        self._key = key

    def fingerprint(self) -> str:
        return self._key


def _cache_key(map_files: MapFiles, size: int, pair_notes: dict[str, Any]) -> str:
    """A hash, in hexadecimal digits, of everything that determines the values of a bake with default options.

    `size` is the longer side of the bake in texels; `pair_notes` are those of `_render_to`, and of a path tracer.
    """
    files_digest = FolderFiles(map_files.folder).digest(map_files.files.values())
    names = sorted(map_files.files.items())
    described = json.dumps([BAKE_VERSION, RENDERER_VERSION, SUB_POINTS, size, pair_notes, files_digest, names])
    return hashlib.sha256(described.encode()).hexdigest()


def table(surface: Surface) -> str:
    """The lines that list the recognised maps and the unused pictures, and how each was used."""
    width = max(map(len, surface.notes))
    return "\n".join(f"  {role:<{width}}  {text}" for role, text in surface.notes.items())


def size_note(surface: Surface) -> str:
    """The texels (H, W) of a bake, and those of its maps if they are more."""
    note = f"{surface.shape[0]} × {surface.shape[1]} texels"
    if max(surface.full_shape) > max(surface.shape):  # both have the same proportion
        note += f", of maps of {surface.full_shape[0]} × {surface.full_shape[1]}"
    return note


def _product_notes(data: Preparation) -> dict[str, Any]:
    """What a BTF's provenance says of the training pairs, which are a product."""
    return {"directions": f"{data.directions}: {data.views} views, {data.lights} lights"}
