"""Built-in materials, rendered by the suite: they need no download.

The recipe of such a material, a class with its parameters, makes the maps that are rendered (`bench.data.materials`).
"""

from bench.btf import BTF
from bench.codec import Progress
from bench.data.kinds import OF_MEASURED, Kind, LoadTracer, no_such_setting
from bench.data.spec import MaterialSpec, Preparation


class BuiltIn(Kind):
    """A material that has no path, but a name in `bench.data.materials`."""

    rendered = True

    def knows(self, spec: MaterialSpec) -> bool:
        return not spec.path

    def look_for(self, spec: MaterialSpec) -> None:
        """Raise an `InputError` if no built-in material has this name."""
        from bench.data.materials import refuse_unknown

        refuse_unknown(spec.name)

    def open(
        self, spec: MaterialSpec, data: Preparation, show: Progress, draw: int, path_tracer: LoadTracer | None
    ) -> BTF:
        """The rendering from the cache, or a new one, which is kept there; no path tracer is used."""
        from bench.data.materials import recipe
        from bench.data.materials.store import load_or_render

        return load_or_render(spec.name, recipe(spec.name), data, draw=draw, show=show)

    def ignores(self, spec: MaterialSpec, key: str) -> str:
        if key == "data.renderer":
            return f"mitsuba bakes only folders of maps, and {spec.name} is built in: leave it out"
        return no_such_setting(spec, "rendered", key, OF_MEASURED)


KIND = BuiltIn()
