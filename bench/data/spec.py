"""The specification of a material in a suite or a command, and of its preparation.

The pairs of a rendered material are a product to train on (every view with every light), and random held-out pairs for
validation or test. `validation` pairs are one fixed draw; a codec's defaults, its recipe and when its fit stops are
chosen on them. `test` pairs are only for tables of results; they use another random stream, with another draw for each
material. Every seed of a suite has the same pairs. Pairs of *low light* are one further draw, whose lights are lower
than any of the training pairs; they decide nothing. Pairs *between* texels are some of the held-out ones again, at
half a texel down and to the right of the texel centres, where quality is scored otherwise.

A *provenance* is the part of a BTF that says, in words and numbers, how its values were made.
"""

import dataclasses
import hashlib
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, NamedTuple, get_args, get_type_hints

import numpy as np

from bench.btf import HOLDOUT, Array
from bench.directions.hemisphere import DIRECTION_SETS, thinned_product, uniform
from bench.inputs.errors import InputError, MissingDataError, did_you_mean
from bench.inputs.settings import Natural, Range, converted

Split = Literal["test", "validation"]
Renderer = Literal["builtin", "mitsuba"]
Angles = Literal["checked", "degrees", "radians"]
MOST_NAME = 200  # bytes of a material's name; a run adds words to it, and systems allow 255
LOW_LIGHT_DEG = (75.0, 89.0)  # the least and the largest θ_i of pairs of low light
MOST = 1 << 38  # bytes of the radiance of a rendered material, as float32
Directions = Annotated[int, Range(1, 10_000)]


class Table(NamedTuple):
    """Pairs of one kind."""

    kind: Literal["train", "heldout", "validation", "low_light", "between"]
    words: str  # what a provenance says of them; "" for the product to train on
    pairs: tuple[Array, Array]  # `wo` and `wi` (N, 3)


@dataclass(frozen=True)
class Preparation:
    """How built-in materials and folders of maps are rendered, and how much of measured data is used.

    These are the settings of a suite's table `[data]`. A kind of surface ignores those that are not its own.
    """

    size: Annotated[int, Range(1, 8192)] = 64  # texels a side
    directions: str = "ubo2003"  # the published direction set to thin
    views: Directions = 25
    lights: Directions = 25
    heldout: Annotated[int, Range(0, 100_000)] = 150  # further random pairs, uniform in solid angle up to 75°
    split: Split = "test"  # held-out pairs: "test", or "validation", another draw, to choose settings
    validation: bool = False  # score validation pairs besides test pairs; fits to measured data then exclude them
    low_light: Annotated[int, Range(0, 100_000)] = 0  # further pairs, θ_i of 75° to 89°: scored, but deciding nothing
    between: Annotated[int, Range(0, 100_000)] = 0  # this many held-out pairs are scored between texels, too
    pairs: Natural = 0  # about this many pairs of measured data, spread evenly over views and lights; 0: all
    texels: Natural = 0  # about this many texels a side of measured data, averaged in whole boxes; 0: all
    # The share of the views, and of the lights, of measured data that are held out; 0: none, so all pairs are fitted.
    holdout: Annotated[float, Range(0, 1, below=True)] = HOLDOUT
    # The most training pairs, and pairs of held-out views and lights, that are scored, always the same ones; 0: all.
    scored: Natural = 0
    renderer: Renderer = "builtin"  # for folders of maps: "mitsuba" path-traces them, with inter-reflections
    # What measured data state as degrees: "checked" refuses what seems to be radians; the others say what it is.
    angles: Angles = "checked"
    repair: bool = False  # mask measured values that are not finite by the mean of their pair

    def __post_init__(self) -> None:
        """Raise `InputError` for values that do not go together, or that would fill the machine.

        Scripts make a `Preparation` directly, past the checks of `changed`, so some fields are checked again here.
        """
        if self.directions not in DIRECTION_SETS:
            known = ", ".join(DIRECTION_SETS)
            raise InputError(f"directions: unknown direction set {self.directions!r}: there are {known}")
        most = len(DIRECTION_SETS[self.directions]())
        for key, count in (("views", self.views), ("lights", self.lights)):
            if not 1 <= count <= most:
                raise InputError(f"{key} must be from 1 to the {most} of {self.directions}, not {count}")
        if self.bytes_rendered > MOST:
            further = self._further_pairs
            asked = f"{self.size} × {self.size} texels at {self.views} × {self.lights} + {further} pairs"
            limit = f"the limit is {MOST >> 30}: lower size, views, lights, heldout, low_light or between"
            raise InputError(f"{asked} are {self.bytes_rendered / 2**30:,.0f} GiB, but {limit}")
        for name in ("heldout", "low_light", "between"):
            if getattr(self, name) < 0:
                raise InputError(f"{name} must be at least 0, not {getattr(self, name)}")
        for name, words in (("split", Split), ("renderer", Renderer), ("angles", Angles)):
            if getattr(self, name) not in get_args(words):
                raise InputError(f"{name} must be {' or '.join(get_args(words))}, not {getattr(self, name)!r}")
        if not 0 <= self.holdout < 1:
            raise InputError(f"holdout must be at least 0 and below 1, not {self.holdout}")
        if self.validation and (self.split != "test" or not self.heldout or not self.holdout):
            remedy = 'split = "test", and heldout and holdout above 0'
            raise InputError(f"validation = true scores further pairs: it needs {remedy}")
        if self.split == "validation" and not self.holdout:
            raise InputError('split = "validation" scores pairs by which settings are chosen: it needs holdout above 0')

    @property
    def _further_pairs(self) -> int:
        """The number of pairs to render besides the product; see `tables`."""
        draws = 2 if self.validation else 1  # of held-out pairs
        return draws * self.heldout + self.low_light + min(self.between, self.heldout)

    @property
    def bytes_rendered(self) -> int:
        """The bytes of the radiance of all pairs to render, as float32."""
        bytes_of_a_texel = 3 * 4  # red, green and blue
        return bytes_of_a_texel * self.size**2 * (self.views * self.lights + self._further_pairs)

    def product(self) -> tuple[Array, Array]:
        """`wo` and `wi` (N, 3) float32 of the training pairs: every view with every light, all lights of a view
        together."""
        return thinned_product(DIRECTION_SETS[self.directions](), self.views, self.lights)

    def heldout_pairs(self, material: str, seed: int, draw: int = 0) -> tuple[Array, Array]:
        """`wo` and `wi` (heldout, 3) float32 of the held-out pairs, uniform in solid angle up to 75°.

        Test pairs differ by `draw` and by `material`; validation pairs depend on the seed alone.
        """
        # Each split has a random stream of its own, so that test pairs tell nothing about validation pairs. The numbers
        # in hexadecimal only keep the streams apart.
        stream = [seed, 0x5EED]
        if self.split == "test":
            stream = [seed, 0x7E57, draw, _number_of(material)]
        rng = np.random.default_rng(stream)
        return uniform(rng, self.heldout), uniform(rng, self.heldout)

    def low_light_pairs(self, material: str, seed: int) -> tuple[Array, Array]:
        """`wo` and `wi` (low_light, 3) float32 of the pairs of low light, which differ by `material`: uniform in solid
        angle, views up to 75°, lights in `LOW_LIGHT_DEG`."""
        rng = np.random.default_rng([seed, 0x10FF, _number_of(material)])
        least, largest = LOW_LIGHT_DEG
        return uniform(rng, self.low_light), uniform(rng, self.low_light, largest, least)

    def described(self, draw: int = 0) -> str:
        """The held-out pairs in words, for a provenance: `150 test pairs, draw 0, uniform in solid angle, …`."""
        purpose = f"test pairs, draw {draw}" if self.split == "test" else "validation pairs"
        return f"{self.heldout} {purpose}, uniform in solid angle, theta_deg <= 75"

    def tables(self, material: str, seed: int, draw: int) -> list[Table]:
        """All pairs to render, a table for each kind, the training pairs first.

        They are apart, so that for another `draw` only the table of test pairs is rendered again.
        """
        tables = [Table("train", "", self.product())]
        if self.heldout:
            tables.append(Table("heldout", self.described(draw), self.heldout_pairs(material, seed, draw)))
        if self.validation:
            # `validation` is left out, because it is refused with that split.
            of_validation = dataclasses.replace(self, split="validation", validation=False)
            tables.append(Table("validation", of_validation.described(), of_validation.heldout_pairs(material, seed)))
        if self.low_light:  # the last pairs: without them the BTF is the same as if they had never been
            words = f"{self.low_light} pairs of low light, theta_i_deg {LOW_LIGHT_DEG[0]:g} to {LOW_LIGHT_DEG[1]:g}"
            tables.append(Table("low_light", words, self.low_light_pairs(material, seed)))
        count = min(self.between, self.heldout)
        if count:  # a table of pairs that the BTF has already
            wo, wi = self.heldout_pairs(material, seed, draw)
            evenly = np.linspace(0, self.heldout - 1, count).round().astype(int)
            words = f"{count} of the {self.described(draw)}; half a texel down and to the right"
            tables.append(Table("between", words, (wo[evenly], wi[evenly])))
        return tables

    def all_pairs(self, material: str, seed: int) -> tuple[Array, Array]:
        """`wo` and `wi` (N, 3) of the training pairs, then of the held-out ones; test pairs are those of draw 0."""
        wo, wi = self.product()
        drawn_wo, drawn_wi = self.heldout_pairs(material, seed)
        return np.concatenate([wo, drawn_wo]), np.concatenate([wi, drawn_wi])


def _number_of(material: str) -> int:
    """A number of 32 bits, made of a material's name, that gives its random streams other values."""
    return int.from_bytes(hashlib.sha256(material.encode()).digest()[:4], "big")


@dataclass(frozen=True)
class MaterialSpec:
    """A material of a suite; built in if `path` is empty."""

    name: str
    path: str = ""
    where: str = ""  # where to get the data, in words for a message

    def __post_init__(self) -> None:
        """Raise `InputError` for a name or a path that no record or file name can hold."""
        if not self.name.strip():
            raise InputError(f"materials: name {self.name!r} is blank: give a name, or leave it out beside a path")
        for text in (self.path, self.name):
            # Python holds bytes of a name that are not UTF-8 as single surrogates, which do not encode.
            printable = text.encode("utf-8", "backslashreplace").decode()
            if printable != text:
                raise InputError(f"{printable}: its name is not UTF-8, so no record can hold it: rename it")
        length = len(self.name.encode())
        if length > MOST_NAME:
            raise InputError(
                f"{self.name}: a name of {length} bytes leaves no room for the names of results: rename it"
            )

    def existing_path(self) -> Path | None:
        """The path of a material that is not built in, as it is or under NEUBTF_DATA; None if it is not there."""
        for place in (Path(self.path), Path(os.environ.get("NEUBTF_DATA", "")) / self.path):
            if os.path.exists(place):  # False for a name too long, where Path.exists raises
                return place
        return None

    def required_path(self) -> Path:
        """The path that `existing_path` finds. If it finds none, raises a `MissingDataError` that says where to get the
        data, or an `InputError` if the suite does not say where."""
        path = self.existing_path()
        if path is not None:
            return path
        fault = f"{self.path}: there is no such file"
        if "NEUBTF_DATA" in os.environ and not os.path.isabs(self.path):
            fault += f", nor under NEUBTF_DATA={os.environ['NEUBTF_DATA']}"
        if self.where:
            raise MissingDataError(f"{fault}: {self.where}")
        raise InputError(f"{fault}: check the path")


def named(material: str) -> MaterialSpec:
    """The material that a string such as a command's argument names: a path if it looks like one or exists, else a
    built-in name, which need not exist."""
    # The paths `.` and `..` have names only when they are written out, and / has none. A link keeps its own.
    written_out = os.path.abspath(material) if material else ""
    at_path = MaterialSpec(os.path.basename(written_out) or material, material)
    looks_like_path = os.sep in material or Path(material).suffix != ""
    if looks_like_path or at_path.existing_path():
        return at_path
    return MaterialSpec(material)


def changed(data: Preparation, changes: Mapping[str, object], words: bool = True) -> Preparation:
    """A preparation with some settings changed, as `--set data.KEY=VALUE` does.

    `changes` maps keys, with or without `data.`, to values: texts as on a command line if `words`, else of the field's
    type. `InputError` for an unknown key, or a value that does not fit.
    """
    types = get_type_hints(Preparation, include_extras=True)
    values = {}
    for key, value in changes.items():
        name = key.removeprefix("data.")
        if name not in types:
            raise InputError(f"{key}: no such setting of the data{did_you_mean(name, types)}")
        values[name] = converted(f"{key}:", types[name], value, words)
    return dataclasses.replace(data, **values)
