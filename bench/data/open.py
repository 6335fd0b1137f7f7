"""Opens a material of a suite, built in, measured or given as PBR maps, as a BTF."""

import os
from collections.abc import Callable
from typing import TYPE_CHECKING

from bench.btf import BTF
from bench.codec import Progress, silent
from bench.data.repair import repaired
from bench.data.spec import MaterialSpec, Preparation, changed, named
from bench.data.thinning import shrunk, thinned
from bench.inputs.errors import InputError, MissingDataError

if TYPE_CHECKING:
    from bench.data.bake import PathTracer


def open_material(
    spec: MaterialSpec,
    data: Preparation,
    show: Progress,
    draw: int = 0,
    path_tracer: "Callable[[], PathTracer] | None" = None,
) -> BTF:
    """Open a suite's material as a BTF, without the pairs that `data.split` excludes.

    Its held-out pairs are validation or test pairs. A rendered material draws its test pairs by `draw`. The test pairs
    of a measured material are those that its data declare, or else whole views and lights (`BTF.split`); with
    `split="validation"` the test pairs are left out, and `BTF.split` holds out whole views and lights of the rest. With
    `validation` the BTF has both: these views and lights of the rest are then `BTF.validation`. `path_tracer` loads the
    tracer that bakes folders of maps for `data.renderer = "mitsuba"`. `MissingDataError` says where to get missing
    measured data.
    """
    if not spec.path:
        from bench.data.materials import recipe
        from bench.data.materials.store import load_or_render

        return load_or_render(spec.name, recipe(spec.name), data, draw=draw, show=show)
    path = spec.existing()
    if path is None:
        under = f", nor under NEUBTF_DATA={os.environ['NEUBTF_DATA']}" if "NEUBTF_DATA" in os.environ else ""
        error = MissingDataError if spec.where else InputError
        raise error(f"{spec.path}: there is no such file{under}: {spec.where or 'check the path'}")
    from bench.data.bake.naming import looks_like_maps

    if looks_like_maps(path):
        from bench.data.bake import open_svbrdf

        traced = data.renderer == "mitsuba"
        if traced and path_tracer is None:
            remedy = f"neubtf-bench bake {path} --renderer mitsuba"
            raise InputError(f"data.renderer: only a run bakes with mitsuba; instead: {remedy}")
        return open_svbrdf(path, data, show, draw, path_tracer() if traced and path_tracer else None)
    from bench.data.readers import open_btf

    btf = thinned(open_btf(path), data.pairs)
    if data.split == "validation":
        btf = btf.without_test()
    elif data.validation:
        btf = btf.with_validation()
    return shrunk(repaired(btf, show) if data.repair else btf, data.texels)


def outlined(spec: MaterialSpec, data: Preparation, draw: int = 0) -> BTF:
    """A built-in material as `open_material` opens it, but without values: its fingerprint needs no rendering."""
    from bench.data.materials import recipe
    from bench.data.materials.store import load_or_render

    return load_or_render(spec.name, recipe(spec.name), data, draw=draw, outline=True)


def draw_of(spec: MaterialSpec, data: Preparation, repetition: int) -> int:
    """The draw of test pairs for a repetition; 0 if all repetitions share one."""
    return repetition if spec.rendered and data.split == "test" else 0


def open_named(name: str, changes: dict[str, str], show: Progress = silent) -> BTF:
    """The BTF of a built-in material or a path, with `data.KEY` settings changed. `InputError` if it lacks one."""
    spec = named(name)
    data = changed(Preparation(), {key: value for key, value in changes.items() if key.startswith("data.")})
    for key in changes:
        if reason := spec.ignores(key):
            raise InputError(f"{key}: {reason}")
    return open_material(spec, data, show)
