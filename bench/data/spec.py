"""The specification of a material in a suite or a command: which one, and how it is prepared."""

import dataclasses
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.data.pairs import SPLITS, Sampling
from bench.errors import InputError, did_you_mean


@dataclass(frozen=True)
class Preparation:
    """How built-in materials and folders of maps are rendered, and how much of measured ones is used."""

    size: int = 64  # texels a side
    directions: str = "ubo2003"  # the published direction set that is thinned
    views: int = 25
    lights: int = 25
    heldout: int = 150  # further random pairs, uniform in solid angle up to 75°
    split: str = "test"  # held-out pairs: "test", drawn anew for each seed, or "validation", to choose settings by
    pairs: int = 0  # about this many pairs of measured data, spread evenly over views and lights; 0: all
    repair: bool = False  # mask measured values that are not finite by the mean of their pair

    def sampling(self, draw: int = 0) -> Sampling:
        """The pairs of a rendered material; `draw` is of its test pairs."""
        return Sampling(self.directions, self.views, self.lights, self.heldout, self.split, draw)


@dataclass(frozen=True)
class MaterialSpec:
    """A material of a suite: built in where `path` is empty."""

    name: str
    path: str = ""
    where: str = ""  # where to get the data

    def found(self) -> Path | None:
        """The path of measured data on this machine, or None."""
        places = [Path(self.path)]
        if data := os.environ.get("NEUBTF_DATA"):
            places.append(Path(data) / self.path)
        return next((place for place in places if place.exists()), None)


def named(material: str) -> MaterialSpec:
    """The material of a bare string: a path where it looks like one or exists, else a built-in name."""
    spec = MaterialSpec(Path(material).name or material, material)
    is_path = os.sep in material or bool(Path(material).suffix) or spec.found()
    return spec if is_path else MaterialSpec(material)


def changed(data: Preparation, changes: dict[str, str]) -> Preparation:
    """Change some keys of a preparation, as `--set data.KEY=VALUE` does."""
    kinds = {field.name: field.type for field in dataclasses.fields(Preparation)}
    converted: dict[str, Any] = {}
    for key, value in changes.items():
        name = key.removeprefix("data.")
        if name not in kinds:
            raise InputError(f"--set {key}: no such key{did_you_mean(name, kinds)}")
        if kinds[name] is int and not value.isdecimal():
            raise InputError(f"--set {key}: must be a whole number, not {value!r}")
        if kinds[name] is bool and value not in ("true", "false"):
            raise InputError(f"--set {key}: must be true or false, not {value!r}")
        if name == "split":
            check_split(f"--set {key}", value)
        converted[name] = int(value) if kinds[name] is int else value == "true" if kinds[name] is bool else value
    return dataclasses.replace(data, **converted)


def check_split(key: str, value: str) -> None:
    """Raise an `InputError` for an unknown split; `key` names it in the error."""
    if value not in SPLITS:
        raise InputError(f"{key} must be {' or '.join(SPLITS)}, not {value!r}{did_you_mean(value, SPLITS)}")
