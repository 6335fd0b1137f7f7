"""Measured surfaces in a file or folder: BTFs, RTI sets, arrays. A reader opens them by their content."""

import logging
from dataclasses import replace

from bench.btf import BTF, HOLDOUT
from bench.codec import Progress
from bench.data.derived import over_own_pairs, reads_slices, repaired, shrunk, thinned
from bench.data.kinds import OF_RENDERED, Kind, LoadTracer, no_such_setting
from bench.data.spec import MaterialSpec, Preparation

log = logging.getLogger(__name__)


class Measured(Kind):
    """Everything that has a path, and is of no other kind."""

    def knows(self, spec: MaterialSpec) -> bool:
        return bool(spec.path)

    def open(
        self, spec: MaterialSpec, data: Preparation, show: Progress, draw: int, path_tracer: LoadTracer | None
    ) -> BTF:
        """What a reader opens, thinned, repaired and shrunk as `data` says; `draw` and `path_tracer` are not used.

        Pairs are left out first, so that only pairs that are used are repaired and shrunk.
        """
        from bench.data.readers import open_btf

        named_unit = "" if data.angles == "checked" else data.angles
        whole = replace(open_btf(spec.required_path(), named_unit), holdout=data.holdout)
        if whole.heldout is not None and data.holdout != HOLDOUT:
            log.warning("%s: its data declare their test pairs, which data.holdout does not change", spec.name)
        btf = thinned(whole, data.pairs)
        is_copied = data.repair or data.texels or reads_slices(whole.source)
        if len(btf) < len(whole) and is_copied:
            btf = over_own_pairs(btf)
        if data.split == "validation":
            btf = btf.without_test()  # its own split then holds out pairs to choose settings by
        elif data.validation:
            btf = btf.with_validation()  # test pairs, and besides them validation pairs
        if data.repair:  # before averages are taken, which one value that is not finite would spoil
            btf = repaired(btf, show)
        return shrunk(btf, data.texels)

    def ignores(self, spec: MaterialSpec, key: str) -> str:
        if not spec.existing_path():
            return ""  # what is not on this machine may be a folder of maps, which has other settings
        return no_such_setting(spec, "measured", key, OF_RENDERED)


KIND = Measured()
