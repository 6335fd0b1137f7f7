"""Metrics and losses at the extremes: pictures that are equal, black, white, one texel, HDR or negative."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import ClassVar, get_args

import numpy as np
import torch
from torch import Tensor

from bench import metrics
from bench.btf import Array
from bench.conformance.stress.case import CaseVerdict, require, verdict_of
from bench.inputs.errors import InputError
from bench.metrics.base import SliceMetric
from bench.metrics.display import LOG_SCALE
from bench.training.fitting import LogLoss, distance

SIDE = 16


def picture(seed: int = 0, side: int = SIDE) -> Array:
    """A picture (side, side, 3) of noise in [0, 1)."""
    return np.random.default_rng(seed).random((side, side, 3)).astype(np.float32)


def flat(value: float) -> Array:
    """A picture (SIDE, SIDE, 3) of one value."""
    return np.full((SIDE, SIDE, 3), value, np.float32)


def hdr(seed: int) -> Array:
    """A picture (SIDE, SIDE, 3) of radiance from 1e-8 to 1e6."""
    exponent = np.random.default_rng(seed).random((SIDE, SIDE, 3)).astype(np.float32) * 14 - 8  # from −8 to 6
    return 10**exponent


@dataclass(frozen=True)
class PictureCase:
    """A column: a reference and a test (H, W, 3), linear radiance at exposure 1, and whether they must be equal."""

    name: str
    make: Callable[[], tuple[Array, Array]]
    equal: bool
    group: ClassVar[str] = "pictures"

    @property
    def holds(self) -> str:
        """What must hold, in one sentence."""
        error = "exactly no error" if self.equal else "a finite number, and some error"
        return f"{error}; the gradient of a loss, too"


CASES = (
    PictureCase("equal", lambda: (picture(), picture()), equal=True),
    PictureCase("both black", lambda: (flat(0), flat(0)), equal=True),
    PictureCase("both white", lambda: (flat(1), flat(1)), equal=True),
    PictureCase("black, seen white", lambda: (flat(0), flat(1)), equal=False),
    PictureCase("white, seen black", lambda: (flat(1), flat(0)), equal=False),
    PictureCase("one texel", lambda: (picture(0, 1), picture(1, 1)), equal=False),
    PictureCase("HDR", lambda: (hdr(0), hdr(1)), equal=False),
    PictureCase("HDR, equal", lambda: (hdr(0), hdr(0)), equal=True),
    PictureCase("negative as black", lambda: (flat(0), -picture()), equal=True),
    PictureCase("negative reference", lambda: (-picture(), flat(0)), equal=True),
)


def check_metric(metric: SliceMetric, case: PictureCase) -> None:
    """Score the pictures of a case. `CheckError` says what does not hold."""
    reference, test = case.make()
    fitted = metric.for_material(reference.reshape(-1, 3))
    raw = fitted.score(fitted.prepare(reference, 1.0), test)
    require(np.isfinite(raw), f"{raw}", f"the raw number is {raw}")
    value = float(fitted.values(np.array([raw]))[0])
    require(not np.isnan(value), "NaN", "the number in its unit is NaN")
    perfect = abs(raw - fitted.perfect) <= 1e-12  # up to rounding in float64
    require(perfect == case.equal, f"{raw:.3g}", f"the raw number is {raw!r}; a perfect one is {fitted.perfect}")


def _level(radiance: Array) -> Tensor:
    """The log radiance (H, W, 3) that losses compare, of radiance (H, W, 3)."""
    return torch.from_numpy(np.maximum(radiance, 0)).mul(LOG_SCALE).log1p()


def check_loss(loss: Callable[[Tensor, Tensor], Tensor], case: PictureCase) -> None:
    """Compute a loss between log radiances, ours and the target, and its gradient. `CheckError` says what is wrong."""
    reference, test = case.make()
    target, ours = _level(reference), _level(test).requires_grad_()
    value = loss(ours, target)
    value.backward()
    assert ours.grad is not None
    require(value.isfinite() and ours.grad.isfinite().all(), "not finite", "the loss or its gradient is not finite")
    no_error = value.item() == 0 and not ours.grad.any()
    require(no_error == case.equal, f"{value.item():.3g}", f"the loss is {value.item()!r}")


def subjects() -> dict[str, Callable[[PictureCase], None]]:
    """Every metric and loss by name."""
    tests: dict[str, Callable[[PictureCase], None]] = {}
    for name in metrics.examples():
        tests[name] = partial(check_metric, metrics.get(name).load())
    for loss in get_args(LogLoss):
        tests[f"loss {loss}"] = partial(check_loss, partial(distance, loss=loss))
    return tests


def judge(test: Callable[[PictureCase], None], case: PictureCase) -> CaseVerdict:
    """Try a metric or a loss on two pictures; the case does not apply if a picture is too small for it."""
    return verdict_of(lambda: test(case), InputError, lambda error: f"{type(error).__name__}: {error}".splitlines()[0])
