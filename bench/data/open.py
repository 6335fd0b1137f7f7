"""Opens a material of a suite, built in, measured or given as PBR maps, as a BTF."""

import os

from bench.btf import BTF
from bench.codec import Progress, silent
from bench.data.repair import repaired
from bench.data.thinning import thinned
from bench.errors import InputError, MissingDataError
from bench.runs.suite import Data, MaterialSpec, Suite, named, with_changes


def open_material(spec: MaterialSpec, data: Data, show: Progress) -> BTF:
    """The BTF of a suite's material. `MissingDataError` says where to get measured data that are not there."""
    if not spec.path:
        from bench.data.materials import load

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
    from bench.data.bake.naming import looks_like_maps

    if looks_like_maps(path):
        from bench.data.bake import open_svbrdf

        return open_svbrdf(path, data, lambda done, total: show(f"baking {spec.name}", done, total))
    from bench.data.readers import open_btf

    btf = thinned(open_btf(path), data.pairs)
    return repaired(btf, show) if data.repair else btf


def open_named(name: str, changes: dict[str, str], show: Progress = silent) -> BTF:
    """The BTF of a built-in material or a path, with `data.KEY` settings changed."""
    data = with_changes(Suite("", ""), [], [], {k: v for k, v in changes.items() if k.startswith("data.")}, None).data
    return open_material(named(name), data, show)
