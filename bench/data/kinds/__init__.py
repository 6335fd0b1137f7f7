"""Kinds of surfaces: built in, PBR maps, measured. Each says how one is opened, and which settings it ignores.

Settings are those of a suite's table `[data]`, here a `Preparation`; a setting's key is written `data.views`. A
material that no other kind `knows` is measured: a reader then opens it by its content (`bench.data.readers`).

To add a kind, write one file here with a class of `Kind` and an instance of it, `KIND`. All these files are imported to
tell the kind of a material, so each imports what opens its surfaces only when it opens one.
"""

import importlib
import pkgutil
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING

from bench.data.spec import MaterialSpec, Preparation

if TYPE_CHECKING:
    from bench.btf import BTF
    from bench.codec import Progress
    from bench.data.bake import PathTracer

LoadTracer = Callable[[], "PathTracer"]  # imports Mitsuba, so it is called only where a bake needs the tracer
OTHERWISE = "measured"  # the module of the kind of all surfaces that no other kind knows

# Keys of settings that only rendered surfaces have, and only measured ones: key → what a user can do instead.
OF_RENDERED = {
    "data.views": "give data.pairs",
    "data.lights": "give data.pairs",
    "data.size": "give data.texels",
    "data.directions": "leave it out",
    "data.heldout": "give data.holdout",
    "data.low_light": "leave it out",
    "data.between": "leave it out",
    "data.renderer": "leave it out",
}
OF_MEASURED = {
    "data.texels": "give data.size",
    "data.pairs": "give data.views and data.lights",
    "data.holdout": "give data.heldout",
    "data.angles": "leave it out",
    "data.repair": "leave it out",
}


class Kind(ABC):
    """A kind of surface."""

    rendered = False  # whether the suite renders it, at pairs that it draws

    @abstractmethod
    def knows(self, spec: MaterialSpec) -> bool:
        """Whether a material is of this kind."""

    def look_for(self, spec: MaterialSpec) -> None:
        """Raise the `InputError` of a material that cannot be found, before anything is opened.

        It is a `MissingDataError` where its entry in a suite says where to get it.
        """
        spec.required_path()

    @abstractmethod
    def open(
        self, spec: MaterialSpec, data: Preparation, show: "Progress", draw: int, path_tracer: LoadTracer | None
    ) -> "BTF":
        """The BTF of a material, prepared as `data` says; its arguments are those of `bench.data.open.open_material`.

        `draw` numbers the draw of test pairs. `path_tracer` is None where the caller offers none.
        """

    def ignores(self, spec: MaterialSpec, key: str) -> str:
        """In words, why the setting `key`, like "data.views", does not affect a material, and what to do instead.

        "" if it does affect it.
        """
        return ""

    def needs_a_run(self, data: Preparation) -> bool:
        """Whether only a run can open it as `data` says, no other command."""
        return False


def no_such_setting(spec: MaterialSpec, made: str, key: str, remedies: dict[str, str]) -> str:
    """A sentence that a material has no setting `key`, and the remedy; "" if `remedies` (key → words) lacks the key.
    `made` is "rendered" or "measured"."""
    if key not in remedies:
        return ""
    return f"{spec.name} is {made}, which has no such setting: {remedies[key]}"


def kind_of(spec: MaterialSpec) -> Kind:
    """The kind of a material; measured, if no other kind knows it."""
    kinds = dict(_kinds())
    measured = kinds.pop(OTHERWISE)  # comes last, because it knows every material that has a path
    for kind in kinds.values():
        if kind.knows(spec):
            return kind
    return measured


@cache
def _kinds() -> dict[str, Kind]:
    """The `KIND` of each module of this package by the module's name, in alphabetical order."""
    names = sorted(info.name for info in pkgutil.iter_modules(__path__))
    return {name: importlib.import_module(f"{__name__}.{name}").KIND for name in names}
