"""Mitsuba 3: its scenes, codec files as BSDFs, and a path tracer for baking. Imports Mitsuba only on demand.

A BSDF is what Mitsuba calls a material. Its code runs in *variants*, such as `llvm_ad_rgb`, which compile the same
source for CPUs or GPUs: values are then arrays of Dr.Jit, one number for each ray.
"""

from typing import TYPE_CHECKING

from bench.inputs.errors import MissingDataError

if TYPE_CHECKING:
    from bench.data.bake import PathTracer


def load_path_tracer() -> "PathTracer":
    """The path tracer, for `bench.data.bake`. `MissingDataError` if Mitsuba is not installed."""
    try:
        from bench.demand.mitsuba import path_tracer
    except ImportError as error:
        fault = f"the renderer mitsuba needs Mitsuba 3, which cannot be imported ({error})"
        raise MissingDataError(f'{fault}: pip install "neubtf-bench[mitsuba]"') from error
    return path_tracer
