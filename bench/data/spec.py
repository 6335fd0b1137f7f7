"""The specification of a material in a suite or a command: which one, and how it is prepared."""

import dataclasses
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, get_type_hints

from bench.data.pairs import SPLIT, Sampling, Split
from bench.errors import InputError, did_you_mean
from bench.settings import Natural, Range, converted

MOST = 1 << 38  # bytes of the radiance of a rendered material, as float32
Directions = Annotated[int, Range(1, 10_000)]


@dataclass(frozen=True)
class Preparation:
    """How built-in materials and folders of maps are rendered, and how much of measured ones is used."""

    size: Annotated[int, Range(1, 8192)] = 64  # texels a side
    directions: str = "ubo2003"  # the published direction set that is thinned
    views: Directions = 25
    lights: Directions = 25
    heldout: Annotated[int, Range(0, 100_000)] = 150  # further random pairs, uniform in solid angle up to 75°
    split: Split = SPLIT  # held-out pairs: "test", drawn anew for each seed, or "validation", to choose settings by
    pairs: Natural = 0  # about this many pairs of measured data, spread evenly over views and lights; 0: all
    texels: Natural = 0  # about this many texels a side of measured data, averaged in whole boxes; 0: all
    # At most so many training pairs are scored, always the same ones, and of whole held-out views and lights; 0: all.
    scored: Natural = 0
    repair: bool = False  # mask measured values that are not finite by the mean of their pair

    def __post_init__(self) -> None:
        needed = 12 * self.size**2 * max(self.views * self.lights, self.heldout)
        if needed > MOST:
            raise InputError(
                f"{self.size} × {self.size} texels at {self.views} × {self.lights} + {self.heldout} pairs are "
                f"{needed / 2**30:,.0f} GiB, and {MOST >> 30} are the limit: lower size, views, lights or heldout"
            )

    def sampling(self, draw: int = 0) -> Sampling:
        """The pairs of a rendered material; `draw` is of its test pairs."""
        return Sampling(self.directions, self.views, self.lights, self.heldout, self.split, draw)


@dataclass(frozen=True)
class MaterialSpec:
    """A material of a suite: built in where `path` is empty."""

    name: str
    path: str = ""
    where: str = ""  # where to get the data

    def existing(self) -> Path | None:
        """The path of measured data on this machine, or None."""
        places = [Path(self.path)]
        if data := os.environ.get("NEUBTF_DATA"):
            places.append(Path(data) / self.path)
        return next((place for place in places if os.path.exists(place)), None)  # False for a name too long


def named(material: str) -> MaterialSpec:
    """The material of a bare string: a path where it looks like one or exists, else a built-in name."""
    spec = MaterialSpec(Path(material).name or material, material)
    is_path = os.sep in material or bool(Path(material).suffix) or spec.existing()
    return spec if is_path else MaterialSpec(material)


def changed(data: Preparation, changes: dict[str, str]) -> Preparation:
    """Change some keys of a preparation, as `--set data.KEY=VALUE` does."""
    kinds = get_type_hints(Preparation, include_extras=True)
    values: dict[str, Any] = {}
    for key, value in changes.items():
        name = key.removeprefix("data.")
        if name not in kinds:
            raise InputError(f"--set {key}: no such key{did_you_mean(name, kinds)}")
        values[name] = converted(f"--set {key}:", kinds[name], value, words=True)
    return dataclasses.replace(data, **values)
