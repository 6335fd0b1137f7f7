"""A case of the catalogue of extremes, the codec that it is tried on (its subject), and its result."""

import dataclasses
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor

from bench.btf import BTF, Array
from bench.codec import Codec, Configured, Fit, Parts, settings_dict
from bench.codecs import container, loading
from bench.codecs.encoding import error_in_words, fit_to_file
from bench.conformance.check import CheckError, CodecUnderTest, NotApplicable
from bench.machine.threads import torch_threads
from bench.material import Material

# Fits of the catalogue are short: those of these settings that a codec has are lowered to these values. `check` fits
# with the settings that it is given.
SHORT = {"steps": 200, "batch": 256, "texels": 16}


@dataclass(frozen=True)
class Measured:
    """The result of a test that passed: a figure for the cell, the used share of the bound, and where it is used."""

    figure: str = ""
    used: float | None = None
    detail: str = ""


Test = Callable[["Subject"], Measured | None]


@dataclass(frozen=True)
class Case:
    """One row: its name, one sentence that says what must hold, and the test.

    The test raises `CheckError` with the wrong figure, or `NotApplicable` with a reason; otherwise the case passed.
    """

    group: str
    name: str
    holds: str
    test: Test
    cheap: bool = False  # quick enough for `neubtf-bench check`
    unphysical: bool = False  # no real surface gives such data, so it does not apply to a codec that models reflectance


@dataclass(frozen=True)
class CaseVerdict:
    """The verdict on a case: the figure in its cell, the detail or the reason; for `used` see `Measured`."""

    verdict: Literal["pass", "fail", "n/a"]
    figure: str = ""
    detail: str = ""
    used: float | None = None
    seconds: float = 0.0  # duration of the test


@dataclass(frozen=True)
class Encoded:
    """A BTF that went through a codec file, and the decoded result."""

    btf: BTF
    decoded: Array  # slices (N, H, W, 3)

    @cached_property
    def truth(self) -> Array:
        """The slices (N, H, W, 3), negative radiance counting as 0."""
        return np.maximum(np.stack(list(self.btf)), 0)


@dataclass
class Subject:
    """A codec under stress: `tested` holds the ordinary material, encoded once."""

    tested: CodecUnderTest
    stored: Parts | None = None  # tensors to use instead of those of the ordinary material's file

    @property
    def has_steps(self) -> bool:
        """Whether the codec is fitted in steps."""
        return "steps" in vars(self.tested.codec.settings)

    def codec(self, **changes: Any) -> Codec:
        """The codec with some settings changed, given by name and value."""
        tested = self.tested.codec
        return type(tested)(**settings_dict(tested) | changes)

    def answers(self, queries: Iterable[Tensor]) -> Tensor:
        """The answers (n, 3) of the ordinary material to uv, ω_o, ω_i and footprints."""
        return self.tested.material.query(*queries)

    def fit(self) -> Fit:
        """A new `Fit`, with the same values for each fit."""
        return Fit(seed=1, network=self.tested.network)

    def encode(self, btf: BTF, stretch: int = 1, **changes: Any) -> Encoded:
        """Encode with the codec's fit, or with `stretch` times its steps, then write, read and decode."""
        if stretch > 1 and self.has_steps:
            changes = {"steps": stretch * self.tested.codec.settings.steps} | changes
        codec = self.codec(**changes)
        path = self.tested.folder / f"stress{container.SUFFIX}"
        fit_to_file(codec, btf, self.fit(), path)
        material = loading.load(path, network=self.tested.network).material
        pairs = zip(btf.wo.tolist(), btf.wi.tolist(), strict=True)
        return Encoded(btf, torch.stack([material.slice(wo, wi) for wo, wi in pairs]).numpy())

    @cached_property
    def usual(self) -> Encoded:
        """The ordinary material, encoded as the extremes are."""
        return self.encode(self.tested.btf)

    @cached_property
    def brightest(self) -> float:
        """The largest sample of the ordinary material."""
        return float(max(picture.max() for picture in self.tested.btf))

    @cached_property
    def parts(self) -> Parts:
        """The tensors of the ordinary material's file."""
        if self.stored is not None:
            return self.stored
        _, parts = container.read_parts(self.tested.header.path)
        return dataclasses.replace(parts, network=self.tested.network)

    def decode(self, parts: Parts) -> Material:
        """The material of some tensors, which need not come from a file."""
        return loading.decoded(self.tested.codec, parts, torch.device("cpu"))


def subject_of(kind: type[Codec], folder: Path) -> Subject:
    """A codec under stress with its default settings, except for short fits; its files go into a folder."""
    return Subject(CodecUnderTest(kind(**short(kind)), folder))


def short(kind: type[Configured]) -> dict[str, Any]:
    """The settings that make fits short: `SHORT`, or the defaults if they are less."""
    defaults = settings_dict(kind())
    return {name: min(defaults[name], most) for name, most in SHORT.items() if name in defaults}


def judge(case: Case, subject: Subject) -> CaseVerdict:
    """Try a case on a codec, on one thread of PyTorch. Any exception that the codec raises is its failure."""

    def test() -> Measured | None:
        """The test of the case, if it applies to the codec."""
        unreal = case.unphysical and subject.tested.codec.physical
        applicable(not unreal, "models reflectance: no surface looks like this")
        try:
            return case.test(subject)
        except CheckError as error:
            if not case.unphysical:
                raise
            remedy = "only a codec that models reflectance may say `physical = True`"
            raise CheckError(f"{error}; {remedy}", error.figure) from None

    with torch_threads(1):
        return verdict_of(test, NotApplicable, partial(error_in_words, codec=subject.tested.codec))


def verdict_of(
    test: Callable[[], Measured | None], inapplicable: type[Exception], described: Callable[[BaseException], str]
) -> CaseVerdict:
    """The result of a test, with its duration: any exception is a failure, except a reason why it does not apply, and
    `KeyboardInterrupt`, which is passed on.

    `inapplicable` is the kind of exception that gives such a reason; `described` puts an unexpected one into words.
    """
    start = time.perf_counter()
    try:
        measured = test() or Measured()
        verdict = CaseVerdict("pass", measured.figure, measured.detail, measured.used)
    except inapplicable as reason:
        verdict = CaseVerdict("n/a", "n/a", str(reason))
    except CheckError as error:
        verdict = CaseVerdict("fail", error.figure or "failed", str(error))
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # any exception is a failure, and the next case still runs
        verdict = CaseVerdict("fail", type(error).__name__, described(error))
    return dataclasses.replace(verdict, seconds=time.perf_counter() - start)


def applicable(condition: object, reason: str) -> None:
    """Raise `NotApplicable` with that reason unless the condition holds."""
    if not condition:
        raise NotApplicable(reason)


def require(condition: object, figure: str, detail: str) -> None:
    """Raise `CheckError` with that figure unless the condition holds."""
    if not condition:
        raise CheckError(detail, figure)
