"""Opens a material of a suite, built in or measured, as a BTF."""

import os

from bench.btf import BTF
from bench.codec import Progress
from bench.errors import InputError, MissingDataError
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
    from bench.readers import open_btf

    path = spec.found()
    if path is None:
        under = f" or under NEUBTF_DATA={os.environ['NEUBTF_DATA']}" if "NEUBTF_DATA" in os.environ else ""
        where = f"{spec.where}" if spec.where else "check the path"
        raise (MissingDataError if spec.where else InputError)(f"{spec.path}: not there{under}: {where}")
    return open_btf(path)
