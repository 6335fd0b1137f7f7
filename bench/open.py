"""Opens a material of a suite, built in, measured or given as PBR maps, as a BTF."""

import math
import os

import numpy as np

from bench.btf import BTF
from bench.codec import Progress
from bench.errors import InputError, MissingDataError
from bench.hemisphere import thin
from bench.suite import Data, MaterialSpec


def open_material(spec: MaterialSpec, data: Data, show: Progress) -> BTF:
    """The BTF of a suite's material. `MissingDataError` says where to get measured data that are not there."""
    if not spec.path:
        from bench.materials import load

        return load(
            spec.name,
            data.size,
            data.views,
            data.lights,
            data.directions,
            data.heldout,
            progress=lambda done, total: show(f"rendering {spec.name}", done, total),
        )
    path = spec.found()
    if path is None:
        under = f" or under NEUBTF_DATA={os.environ['NEUBTF_DATA']}" if "NEUBTF_DATA" in os.environ else ""
        where = f"{spec.where}" if spec.where else "check the path"
        raise (MissingDataError if spec.where else InputError)(f"{spec.path}: not there{under}: {where}")
    from bench.bake.naming import looks_like_maps

    if looks_like_maps(path):
        from bench.bake import open_svbrdf

        return open_svbrdf(path, data, lambda done, total: show(f"baking {spec.name}", done, total))
    from bench.readers import open_btf

    return thinned(open_btf(path), data.pairs)


def thinned(btf: BTF, pairs: int) -> BTF:
    """About `pairs` of a BTF's pairs (0: all), evenly spread, so that a product of views and lights stays one.

    Pairs that form no product are thinned by a seeded draw.
    """
    if not 0 < pairs < len(btf):
        return btf
    layout = btf.layout
    if layout.grid is None:
        return btf.subset(np.sort(np.random.default_rng(0).choice(len(btf), pairs, replace=False)))
    views, lights = len(layout.views), len(layout.lights)
    few = min(views, lights, math.isqrt(pairs))  # a side of few directions keeps them all
    count = (few, min(lights, pairs // few)) if views <= lights else (min(views, pairs // few), few)
    chosen = (thin(side, n) for side, n in zip((layout.views, layout.lights), count, strict=True))
    return btf.subset(layout.grid[np.ix_(*chosen)].reshape(-1))
