"""What a codec must do: turn a BTF into named tensors, and named tensors into a material."""

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

import torch
from torch import Tensor

from bench.btf import BTF
from bench.errors import MissingDataError
from bench.material import Material
from bench.settings import Setting, convert, described, parse

if TYPE_CHECKING:
    from bench.density import Density

T = TypeVar("T")
ZSTD, SCENE = COMMON = ("zstd", "scene")  # the settings of every codec, true or false
COMMON_MEANINGS = {
    ZSTD: "store each part compressed by Zstandard, without loss (extra neubtf-bench[zstd])",
    SCENE: "fit to the demand of a scene instead of to the whole BTF (see docs/scenes.md)",
}
Progress = Callable[[str, int, int], None]  # label, done, total


def silent(label: str, done: int, total: int) -> None:
    """The progress of what nobody watches."""


def followed(show: Progress, items: Iterable[T], label: str, total: int) -> Iterator[T]:
    """The same items, telling `show` how many are done."""
    for done, item in enumerate(items):
        show(label, done, total)
        yield item
    show(label, total, total)


@dataclass(frozen=True)
class Fit:
    """What one fit is given besides its data: where it runs, its seed, and whom it tells how far it is."""

    device: torch.device = field(default_factory=lambda: torch.device("cpu"))
    threads: int = 1
    seed: int = 0
    show: Progress = silent
    checkpoint: Path | None = None  # where a long fit keeps its state, to go on from it when it is started again
    history: list[dict[str, float]] = field(default_factory=list)  # the curve of the fit; goes into the record
    density: "Density | None" = None  # where the scene that is fitted to looks; without one, everywhere alike
    network: "TrainedNetwork | None" = None  # the one that the codec shares over materials, where it has one

    def shared(self, name: str) -> "TrainedNetwork":
        """The network that codec `name` shares over materials. `MissingDataError` where this fit was given none."""
        if self.network is None:
            raise MissingDataError(
                f"codec {name} needs the network that it shares over materials: give it as `Fit(network=...)`, from "
                f"`bench.codecs.shared.find({name!r})`; `neubtf-bench pretrain {name}` makes it"
            )
        return self.network

    def log(self, step: int, **values: float) -> None:
        """Add a point to the curve of this fit: `seconds`, `psnr` and what else a codec has to say at a step."""
        self.history.append({"step": step, **values})

    def progress(self, items: Iterable[T], label: str = "reading", total: int | None = None) -> Iterator[T]:
        """The same items, while a progress bar follows; `total` where they have no length."""
        return followed(self.show, items, label, len(items) if total is None else total)  # type: ignore[arg-type]

    @property
    def row_weights(self) -> Tensor | None:
        """How much each row (3 · pairs,) of the matrix of ABRDFs counts, 1 on average; None where all count alike."""
        return None if self.density is None else self.density.weights.repeat_interleave(3)

    def generator(self) -> torch.Generator:
        """A generator on the CPU, seeded by this fit."""
        return torch.Generator().manual_seed(self.seed)


@dataclass(frozen=True)
class Parts:
    """The named tensors of a codec file, by what they are for: bytes are reported for each part."""

    decoder: dict[str, Tensor] = field(default_factory=dict)  # what every query needs: the network
    texture: dict[str, Tensor] = field(default_factory=dict)  # what varies over the texels
    encoder: dict[str, Tensor] = field(default_factory=dict)  # what makes new textures; no query needs it
    other: dict[str, Tensor] = field(default_factory=dict)  # directions, exposure, what else decoding needs
    scene: dict[str, Any] = field(default_factory=dict)  # what was fitted to, where it was one scene's demand
    network: "TrainedNetwork | None" = None  # the shared network that was used: the file names it by its hash


@dataclass(frozen=True)
class TrainedNetwork:
    """A shared network after its training, read from its file."""

    path: Path
    codec: str
    settings: dict[str, Any]  # of its training
    sha256: str
    file_bytes: int
    parts: Parts

    @property
    def origins(self) -> set[str]:
        """The `bench.codecs.shared.origin` of each BTF that it was trained on."""
        return {bytes(digest).hex() for digest in self.parts.other["origins"].tolist()}


class Configured:
    """What has a `name`, a `version` and `Settings`.

    `Settings` is a frozen dataclass of int, float, bool, str and `Literal` fields, each with a default and a comment
    of one line. The types of `bench.settings` say a range, too. Where there is a setting `recipe`, `recipes` says which
    defaults each of its values changes.
    """

    name: ClassVar[str]
    version: ClassVar[int]
    recipes: ClassVar[Mapping[str, Mapping[str, Any]]] = {}

    @dataclass(frozen=True)
    class Settings:
        pass

    def __init__(self, *, zstd: bool | str = False, scene: bool | str = False, **settings: Any):
        """With the default settings, those of the recipe if one is named, but for those named; strings are converted.

        Two has every codec: `zstd`, its file is compressed by Zstandard, without loss, and `scene`, it is fitted to
        the demand of a scene instead of to the whole BTF.
        """
        self.zstd: bool = convert(self.name, ZSTD, bool, zstd)
        self.scene: bool = convert(self.name, SCENE, bool, scene)
        recipe = self.recipes.get(settings.get("recipe", ""), {})
        self.settings: Any = parse(self.name, self.Settings, {**recipe, **settings})


class SharedNetwork(Configured):
    """A network that a codec trains once for all materials: see `bench.codecs.shared`.

    `name` and `version` are the codec's.
    """

    def train(self, btfs: Sequence[BTF], fit: Fit) -> Parts:
        """Fit some BTFs, training pairs and held-out ones; the tensors that the shared file will hold."""
        raise NotImplementedError

    def brief(self) -> "SharedNetwork":
        """The same with so short a training that `neubtf-bench check` takes seconds."""
        raise NotImplementedError


class Codec(Configured):
    """A codec: `name`, `version`, `Settings`, `encode`, `decode`. Its docstring's first line describes it in lists."""

    network: ClassVar[type[SharedNetwork] | None] = None  # where it trains one for all materials
    interpolates: ClassVar[bool] = False  # between the pairs of the BTF: those no query lies between are not needed
    sizes: ClassVar[tuple[str, ...]] = ()  # the settings, whole numbers ≥ 1, that its bytes grow with; the first leads

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        """Fit a BTF, training pairs only; the tensors that the file will hold."""
        raise NotImplementedError

    def decode(self, parts: Parts, device: torch.device) -> Material:
        """The material that the tensors describe, without any other source."""
        raise NotImplementedError


def settings_dict(codec: Configured) -> dict[str, Any]:
    """The settings of a codec as plain values, for files and records."""
    return dataclasses.asdict(codec.settings) | {name: True for name in COMMON if getattr(codec, name)}


def setting_names(codec: type[Configured]) -> set[str]:
    """The names of the settings of a codec."""
    return {field.name for field in dataclasses.fields(codec.Settings)} | set(COMMON)


def described_settings(codec: type[Configured]) -> list[Setting]:
    """Every setting of a codec, its own first, then those that every codec has."""
    common = [Setting(name, "false", "true or false", COMMON_MEANINGS[name]) for name in COMMON]
    return described(codec.Settings) + common
