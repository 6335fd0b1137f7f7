"""Folders of PBR maps (albedo, normals, roughness …), which the suite or Mitsuba renders to a BTF.

This is called a bake. It is kept in the cache, and memory-mapped from there the next time.
"""

from bench.btf import BTF
from bench.codec import Progress
from bench.data.kinds import OF_MEASURED, Kind, LoadTracer, no_such_setting
from bench.data.spec import MaterialSpec, Preparation
from bench.inputs.errors import InputError


class PbrMaps(Kind):
    """A folder whose pictures are named as maps."""

    rendered = True

    def knows(self, spec: MaterialSpec) -> bool:
        """Whether its path is there and its pictures are named as maps; False for what is not on this machine."""
        from bench.data.bake.naming import looks_like_maps

        path = spec.existing_path() if spec.path else None
        return path is not None and looks_like_maps(path)

    def open(
        self, spec: MaterialSpec, data: Preparation, show: Progress, draw: int, path_tracer: LoadTracer | None
    ) -> BTF:
        """The bake from the cache, or a new one, which is kept there.

        `InputError` where `data.renderer` asks for Mitsuba and no tracer is given, as by every command but `run`.
        """
        from bench.data.bake import open_svbrdf

        path = spec.required_path()
        if data.renderer == "builtin":
            return open_svbrdf(path, data, show, draw)
        if path_tracer is None:
            remedy = f"neubtf-bench bake {path} --renderer mitsuba"
            raise InputError(f"data.renderer: only a run bakes with mitsuba; instead: {remedy}")
        return open_svbrdf(path, data, show, draw, path_tracer())

    def ignores(self, spec: MaterialSpec, key: str) -> str:
        return no_such_setting(spec, "rendered", key, OF_MEASURED)

    def needs_a_run(self, data: Preparation) -> bool:
        return data.renderer == "mitsuba"


KIND = PbrMaps()
