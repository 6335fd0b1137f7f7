"""Opens a material of a suite, of whatever kind, as a BTF; or makes one of arrays in memory.

Kinds are built in, a folder of PBR maps, or measured (`bench.data.kinds`); the first two are rendered.
"""

import logging
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from bench.btf import BTF, Array, ArraySource
from bench.codec import Progress, silent
from bench.data.kinds import LoadTracer, kind_of
from bench.data.readers.checks import negative_fault, no_duplicates, radiance_fault, unit_directions, warn_of_radians
from bench.data.spec import MaterialSpec, Preparation, changed, named
from bench.inputs.errors import InputError
from bench.inputs.settings import Seed, converted

log = logging.getLogger(__name__)


def open_material(
    spec: MaterialSpec, data: Preparation, show: Progress, draw: int = 0, path_tracer: LoadTracer | None = None
) -> BTF:
    """Open a suite's material as a BTF, prepared as `data` says.

    - A rendered material draws its held-out pairs at random: test pairs by the number `draw`, or with
      `data.split="validation"` validation pairs.
    - The test pairs of a measured material are those that its data declare, or else whole views and lights
      (`BTF.split`), the share `data.holdout` of each. With `data.split="validation"` they are left out, and whole views
      and lights of the rest are held out in their place. With `data.validation` the BTF has both; the latter are then
      `BTF.validation`.

    `show` is told the progress. `path_tracer` loads the tracer that bakes folders of maps for
    `data.renderer="mitsuba"`; without one such a bake is refused. `MissingDataError` says where to get missing measured
    data.
    """
    return kind_of(spec).open(spec, data, show, draw, path_tracer)


def open_named(name: str, changes: Mapping[str, object], show: Progress = silent, words: bool = True) -> BTF:
    """The BTF of a built-in material or a path, with some settings of `Preparation` changed.

    `changes` maps keys such as `data.size` to values: texts as on a command line if `words`, else of the setting's
    type. The further key `data.seed` is the number of another draw of test pairs than that of runs, 0, where these are
    drawn. Keys without `data.`, such as a codec's settings, are passed over. `InputError` if a setting does not affect
    this material.
    """
    spec = named(name)
    changes = dict(changes)
    draw = converted("data.seed:", Seed, changes.pop("data.seed", 0), words)
    data_changes = {key: value for key, value in changes.items() if key.startswith("data.")}
    data = changed(Preparation(), data_changes, words)
    kind = kind_of(spec)
    for key in data_changes:
        reason = kind.ignores(spec, key)
        if reason:
            raise InputError(f"{key}: {reason}")
    return open_material(spec, data, show, draw)


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
    fault = radiance_fault(values.shape, values.dtype)
    if fault:
        raise InputError(fault)
    count = len(values)
    views = _directions(np.asarray(wo), "wo", count)
    lights = _directions(np.asarray(wi), "wi", count)
    no_duplicates(views, lights, lambda row: f"pair {row}")
    mask = None if heldout is None else np.asarray(heldout)
    if mask is not None and (mask.shape != (count,) or mask.dtype.kind != "b" or mask.all()):
        raise InputError(f"heldout must be a mask ({count},) of booleans that leaves pairs to train on")
    _refuse_not_finite(values)
    warning = negative_fault(values)
    if warning:
        log.warning("%s: %s", name, warning)
    warn_of_radians(views, lights, "wo and wi")
    provenance = {"format": "arrays", "colour": "taken as linear Rec. 709", "cosine": "taken as f_r cos(theta_i)"}
    return BTF(name, views, lights, ArraySource(values), heldout=mask, periodic=periodic, provenance=provenance)


def _refuse_not_finite(values: Array) -> None:
    """Raise an `InputError` that names the first slice of radiance (N, H, W, 3) with a value that is not finite."""
    for row, picture in enumerate(values):  # one at a time, because the array may be a mapped file
        bad = int((~np.isfinite(picture)).sum())
        if bad:
            fault = f"{bad:,} of {picture.size:,} values are not finite (NaN or infinite): mend them"
            remedy = "leave the pair out, or save radiance, wo and wi by numpy.savez and bench.open(path, repair=True)"
            raise InputError(f"radiance[{row}]: {fault}, {remedy}")


def _directions(vectors: Array, name: str, count: int) -> Array:
    """Unit vectors (count, 3) float32 of the array `wo` or `wi`; `name` is what an `InputError` calls it."""
    if vectors.shape != (count, 3) or vectors.dtype.kind not in "fiu":
        raise InputError(f"{name} is {vectors.shape} {vectors.dtype}: it must be ({count}, 3) numbers, a row a slice")
    return unit_directions(vectors, lambda row: f"{name}[{row}]")
