"""Opens a material of a suite, built in, measured or given as PBR maps, as a BTF; or makes one of arrays in memory."""

import logging
import os
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from bench.btf import BTF, ArraySource
from bench.codec import Progress, silent
from bench.data.derived import repaired, shrunk, thinned
from bench.data.readers.checks import negative, no_duplicates, radiance_fault, unit_directions, warn_of_radians
from bench.data.spec import MaterialSpec, Preparation, changed, named
from bench.inputs.errors import InputError, MissingDataError
from bench.inputs.settings import Seed, converted

if TYPE_CHECKING:
    from bench.data.bake import PathTracer
log = logging.getLogger(__name__)


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

    btf = thinned(open_btf(path, data.angles), data.pairs)
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
    """The BTF of a built-in material or a path, with `data.KEY` settings changed. `InputError` if it lacks one.

    `data.seed` is the repetition whose test pairs are drawn, as for the seeds of a suite.
    """
    spec = named(name)
    changes = dict(changes)
    repetition = converted("data.seed:", Seed, changes.pop("data.seed", "0"), words=True)
    data = changed(Preparation(), {key: value for key, value in changes.items() if key.startswith("data.")})
    for key in changes:
        if reason := spec.ignores(key):
            raise InputError(f"{key}: {reason}")
    return open_material(spec, data, show, draw_of(spec, data, repetition))


def from_arrays(
    radiance: ArrayLike,
    wo: ArrayLike,
    wi: ArrayLike,
    *,
    heldout: ArrayLike | None = None,
    periodic: bool = False,
    name: str = "arrays",
) -> BTF:
    """The BTF of radiance (N, H, W, 3) at N pairs of unit directions: wo (N, 3) to the camera, wi (N, 3) to the light.

    Radiance is linear Rec. 709 f_r · cos θ_i, used unchanged and not copied. `heldout` is a mask (N,) of the pairs that
    no codec may train on; without it, whole views and lights are held out (`BTF.split`). `periodic` says that the
    picture repeats without a seam. `InputError` names the array and the row of a wrong value.
    """
    values = np.asarray(radiance)
    if fault := radiance_fault(values.shape, values.dtype):
        raise InputError(fault)
    count = len(values)
    views, lights = (_directions(np.asarray(side), word, count) for side, word in ((wo, "wo"), (wi, "wi")))
    no_duplicates(views, lights, lambda row: f"pair {row}")
    mask = None if heldout is None else np.asarray(heldout)
    if mask is not None and (mask.shape != (count,) or mask.dtype.kind != "b" or mask.all()):
        raise InputError(f"heldout must be a mask ({count},) of booleans that leaves pairs to train on")
    for row, picture in enumerate(values):  # one at a time, because the array may be a mapped file
        if bad := int((~np.isfinite(picture)).sum()):
            fault = f"{bad:,} of {picture.size:,} values are not finite (NaN or infinite): mend them"
            remedy = "leave the pair out, or save radiance, wo and wi by numpy.savez and bench.open(path, repair=True)"
            raise InputError(f"radiance[{row}]: {fault}, {remedy}")
    if text := negative(values):
        log.warning("%s: %s", name, text)
    warn_of_radians(views, lights, "wo and wi")
    provenance = {"format": "arrays", "colour": "taken as linear Rec. 709", "cosine": "taken as f_r cos(theta_i)"}
    return BTF(name, views, lights, ArraySource(values), heldout=mask, periodic=periodic, provenance=provenance)


def _directions(vectors: np.ndarray, word: str, count: int) -> np.ndarray:
    if vectors.shape != (count, 3) or vectors.dtype.kind not in "fiu":
        raise InputError(f"{word} is {vectors.shape}: it must be ({count}, 3), a direction for each slice of radiance")
    return unit_directions(vectors, lambda row: f"{word}[{row}]")
