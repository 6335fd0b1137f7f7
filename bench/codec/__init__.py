"""The interface of a codec: it encodes a BTF to named tensors, and decodes named tensors to a material."""

import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Protocol, TypeVar

import torch
from torch import Tensor

from bench.btf import BTF, periods
from bench.inputs.errors import MissingDataError
from bench.inputs.settings import IF_SET, Setting, convert, descriptions, parse
from bench.machine.threads import processor_seconds
from bench.material import Material

T = TypeVar("T")
SCENE = "scene"  # a boolean setting that every codec has
RECIPE = "recipe"  # the setting that chooses the defaults of others
Progress = Callable[[str, int, int], None]  # label, done, total; the text after REMARK in a label may change
REMARK = " · "
COVERED = 0.999  # share of the demand to cover; the rest may lie outside the kept pairs and levels of detail


def silent(label: str, done: int, total: int) -> None:
    """A `Progress` that shows nothing."""


def followed(show: Progress, items: Iterable[T], label: str, total: int) -> Iterator[T]:
    """Yield the items and tell `show` how many are done."""
    for done, item in enumerate(items):
        show(label, done, total)
        yield item
    show(label, total, total)


@contextmanager
def ended_bars(show: Progress) -> Iterator[Progress]:
    """Yield a `Progress` that shows what `show` does; bars that the block leaves unfinished are ended with it."""
    unfinished: dict[str, int] = {}

    def show_and_note(label: str, done: int, total: int) -> None:
        """Pass progress on to `show`, and note whether its bar is unfinished."""
        bar = label.partition(REMARK)[0]
        if done < total:
            unfinished[bar] = total
        else:
            unfinished.pop(bar, None)
        show(label, done, total)

    try:
        yield show_and_note
    finally:
        for bar, total in unfinished.items():
            show(bar, total, total)


class Terminal(Protocol):
    """What a command of another package speaks to: lines that stay and, while it is entered, progress bars."""

    def __enter__(self) -> "Terminal": ...

    def __exit__(self, *_: object) -> None: ...

    def show(self, label: str, done: int, total: int) -> None:
        """Move the progress bar of a label; a `Progress`."""

    def say(self, text: str) -> None:
        """Print lines, without control characters."""

    def say_file(self, header: Any) -> None:
        """Print what a codec file is, by its header."""


class DrawnSamples(NamedTuple):
    """Random samples: `texel` (n,) is row · W + column, `direction` (n,) the number of a pair or of a query.

    Queries are those of a scene; they are counted after the N pairs, so query q is N + q.
    """

    texel: Tensor
    direction: Tensor


@dataclass(frozen=True)
class Density:
    """A scene's demand over the pairs of one layout and a window of texels.

    A fit draws samples by it and weights pairs with it. A share of it, `uniform`, is spread evenly over all pairs.
    """

    uv: Tensor  # (n, 2) within the window
    footprint: Tensor  # (n,) in units of the window's longer side
    wo: Tensor  # (n, 3)
    wi: Tensor  # (n, 3)
    cumulative: Tensor  # (n,) float64: running sums of the importance of the queries
    pair: Tensor  # (n, k) the pairs around each query
    weight: Tensor  # (n, k) their weights, including cosines
    per_pair: Tensor  # (N,) float64: the share of each pair in the demand
    uniform: float

    def to(self, device: torch.device) -> "Density":
        """The same, whose `around` answers for directions on a device; it still draws on the CPU."""
        return dataclasses.replace(self, pair=self.pair.to(device), weight=self.weight.to(device))

    @property
    def weights(self) -> Tensor:
        """The weight of each pair (N,), float32, 1 on average."""
        even = 1 / len(self.per_pair)
        mixed = self.uniform * even + (1 - self.uniform) * self.per_pair
        return (mixed / even).float()

    def levels(self, side: int) -> int:
        """The number of levels of detail, from the finest, that the demand uses of a texture.

        `side` are the texels of the texture's longer side.
        """
        finest_first = self.footprint.argsort()
        importance = self.cumulative.diff(prepend=self.cumulative.new_zeros(1))
        running = importance[finest_first].cumsum(0)
        place = int(torch.searchsorted(running, COVERED * running[-1]))  # the first with which it is enough
        coarsest = self.footprint[finest_first[place]]
        # A footprint of 2ⁱ texels needs level i, counted from 0.
        texels = max(1.0, float(coarsest) * side)
        return max(0, math.ceil(math.log2(texels))) + 1

    def draw(self, count: int, shape: tuple[int, int], generator: torch.Generator) -> DrawnSamples:
        """`count` random samples of the window at the resolution `shape`, (H, W) texels.

        A texel is drawn at a random place in the footprint of a query, or within half a texel of its centre if that is
        larger, so that the four texels around it are drawn in the proportions of bilinear interpolation.
        """
        height, width = shape
        # Of each sample: which query, where in its footprint along u and v, and whether it is one of the even share.
        chance = torch.rand(count, 4, generator=generator, dtype=torch.float64)
        # A query is drawn by its importance: the first whose running sum reaches a random part of the total.
        query = torch.searchsorted(self.cumulative, chance[:, 0] * self.cumulative[-1]).clamp_max(len(self.uv) - 1)
        side = self.footprint[query, None].clamp_min(1 / max(shape)) * torch.tensor(periods(shape))
        place = self.uv[query] + (chance[:, 1:3].float() - 0.5) * side
        col = (place[:, 0] * width).floor().long().remainder(width)
        row = ((1 - place[:, 1]) * height).floor().long().remainder(height)
        pairs = len(self.per_pair)
        anywhere = torch.randint(math.prod(shape) * pairs, (count,), generator=generator)
        # One number for a texel and a pair: texel · pairs + pair.
        texel = anywhere.div(pairs, rounding_mode="floor")
        pair = anywhere.remainder(pairs)
        even = chance[:, 3] < self.uniform
        return DrawnSamples(torch.where(even, texel, row * width + col), torch.where(even, pair, pairs + query))

    def around(self, direction: Tensor) -> tuple[Tensor, Tensor]:
        """The pairs around directions (n,), which are counted as in `DrawnSamples`, and their weights: (n, k) each.

        The radiance of a direction is the sum of weight × radiance of the pair.
        """
        pairs = len(self.per_pair)
        corners = self.pair.shape[1]
        # A pair itself fills all k places with equal weights, so that both kinds have one shape.
        query = (direction - pairs).clamp_min(0)  # 0 where it is a pair, and then not used
        exact = (direction < pairs)[:, None]
        pair = torch.where(exact, direction[:, None], self.pair[query].long())
        return pair, torch.where(exact, 1 / corners, self.weight[query])


@dataclass(frozen=True)
class Fit:
    """The context of one fit: device, seed, progress callback, checkpoint, curve, scene and shared network."""

    device: torch.device = field(default_factory=lambda: torch.device("cpu"))
    threads: int = 1
    seed: int = 0
    show: Progress = silent
    checkpoint: Path | None = None  # the file that a long fit saves its state to, and resumes from
    history: list[dict[str, float]] = field(default_factory=list)  # the curve of the fit; stored in the record
    faults: list[str] = field(default_factory=list)  # what is wrong with a fit that ended, in words; stored there, too
    density: Density | None = None  # the demand of the scene to fit to; None: uniform
    network: "TrainedNetwork | None" = None  # the network that the codec shares over materials, if any
    started: float = field(default_factory=processor_seconds)  # on the clock of processor time, in s
    unseen: Sequence[BTF] = ()  # materials kept out of a shared network's training, for its curve

    def shared(self, name: str) -> "TrainedNetwork":
        """The network that codec `name` shares over materials. `MissingDataError` if this fit has none."""
        if self.network is None:
            raise MissingDataError(
                f"codec {name} needs the network that it shares over materials: give it as `Fit(network=...)`, from "
                f"`bench.codecs.shared.find_for(codec)`; `neubtf-bench pretrain {name}` makes it"
            )
        return self.network

    def log(self, step: int, **values: float) -> None:
        """Add a point to the curve of this fit: `seconds`, `psnr` and further values of a codec at a step.

        Without `seconds` the processor time since this object was made is added: a curve has both axes.
        """
        stamped = {"seconds": processor_seconds() - self.started} | values
        self.history.append({"step": step, **stamped})

    def progress(self, items: Iterable[T], label: str = "reading", total: int | None = None) -> Iterator[T]:
        """Yield the items with a progress bar; `total` is needed if they have no length."""
        return followed(self.show, items, label, len(items) if total is None else total)  # type: ignore[arg-type]

    @property
    def row_weights(self) -> Tensor | None:
        """The weight of each row (3 · pairs,) of the matrix of ABRDFs, 1 on average; None if all are equal."""
        return None if self.density is None else self.density.weights.repeat_interleave(3)

    def generator(self) -> torch.Generator:
        """A generator on the CPU, seeded by this fit."""
        return torch.Generator().manual_seed(self.seed)


@dataclass(frozen=True)
class Parts:
    """The named tensors of a codec file, grouped by purpose; bytes are reported for each part."""

    decoder: dict[str, Tensor] = field(default_factory=dict)  # the network, read by every query
    texture: dict[str, Tensor] = field(default_factory=dict)  # data that varies over the texels
    encoder: dict[str, Tensor] = field(default_factory=dict)  # makes new textures; no query reads it
    sampling: dict[str, Tensor] = field(default_factory=dict)  # lobes that a renderer draws directions from
    other: dict[str, Tensor] = field(default_factory=dict)  # directions, exposure, other data for decoding
    lowest_light: float = 0.0  # cos θ of the lowest light that was fitted, by the suite: see `Material.faded`
    scene: dict[str, Any] = field(default_factory=dict)  # the scene's demand, if the file was fitted to one
    network: "TrainedNetwork | None" = None  # the shared network that was used; the file stores its hash


@dataclass(frozen=True)
class TrainedNetwork:
    """A shared network after its training, read from its file."""

    path: Path
    codec: str
    settings: dict[str, Any]  # the settings of its training
    sha256: str
    file_bytes: int
    parts: Parts

    @property
    def origins(self) -> set[str]:
        """The `bench.codecs.shared.origin` of each BTF that it was trained on."""
        return {bytes(digest).hex() for digest in self.parts.other["origins"].tolist()}


class Configured:
    """Base class with a `name`, a `version` and `Settings`.

    `Settings` is a frozen dataclass of int, float, bool, str and `Literal` fields, each with a default and a comment
    of one line. The types of `bench.inputs.settings` add a range. If there is a setting `recipe`, `recipes` lists the
    defaults that each of its values changes; a recipe whose fit changed while others did not has a version of its own.
    """

    name: ClassVar[str]
    version: ClassVar[int]
    recipes: ClassVar[Mapping[str, Mapping[str, Any]]] = {}
    recipe_versions: ClassVar[Mapping[str, int]] = {}

    @dataclass(frozen=True)
    class Settings:
        pass

    def __init__(self, *, scene: bool | str = False, **settings: Any):
        """Set the given settings, and the others to the defaults of the recipe or of the class; convert strings. Every
        codec has `scene`. `InputError` for an unknown setting or a wrong value."""
        self.scene: bool = convert(self.name, SCENE, bool, scene)
        recipe = self.recipes.get(settings.get(RECIPE, ""), {})
        self.settings: Any = parse(self.name, self.Settings, {**recipe, **settings})

    @classmethod
    def version_of(cls, settings: Mapping[str, Any]) -> int:
        """The version of files with these settings: that of their recipe, or else of the codec."""
        return cls.recipe_versions.get(str(settings.get(RECIPE, "")), cls.version)


class SharedNetwork(Configured):
    """A network that a codec trains once for all materials, with its name and version: see `bench.codecs.shared`."""

    shipped: ClassVar[Path | None] = None  # the file of a trained network that comes with the codec

    def train(self, btfs: Sequence[BTF], fit: Fit) -> Parts:
        """Fit BTFs with training pairs and held-out ones; returns the tensors of the shared file."""
        raise NotImplementedError


class Codec(Configured):
    """A codec: `name`, `version`, `Settings`, `encode`, `decode`. Its docstring's first line describes it in lists."""

    network: ClassVar[type[SharedNetwork] | None] = None  # if it trains one network for all materials
    interpolates: ClassVar[bool] = False  # between pairs, so that a fit to a scene drops unused pairs
    sizes: ClassVar[tuple[str, ...]] = ()  # whole-number settings that grow the file; the first leads
    physical: ClassVar[bool] = False  # models reflectance, so it cannot represent data of no real surface

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        """Fit the training pairs of a BTF, and return the tensors for the file."""
        raise NotImplementedError

    def decode(self, parts: Parts, device: torch.device) -> Material:
        """Decode a material from the tensors alone."""
        raise NotImplementedError


def settings_dict(codec: Configured) -> dict[str, Any]:
    """The settings of a codec as plain values, for files and records.

    Two kinds are left out at their defaults, so that files and records from before they existed stay the same: settings
    that are marked with `IF_SET`, unless the recipe changes them, and `scene`.
    """
    written = dataclasses.asdict(codec.settings)
    of_recipe = codec.recipes.get(written.get(RECIPE, ""), {})
    for each in dataclasses.fields(codec.settings):
        at_default = written[each.name] == each.default
        if each.metadata == IF_SET and at_default and each.name not in of_recipe:
            del written[each.name]
    if codec.scene:
        written[SCENE] = True
    return written


def setting_names(codec: type[Configured]) -> set[str]:
    """The names of the settings of a codec."""
    return {each.name for each in dataclasses.fields(codec.Settings)} | {SCENE}


def described_settings(codec: type[Configured]) -> list[Setting]:
    """Every setting of a codec: its own first, then `scene`."""
    meaning = "fit to the demand of a scene instead of to the whole BTF (see docs/scenes.md)"
    return [*descriptions(codec.Settings), Setting(SCENE, "false", "true or false", meaning)]
