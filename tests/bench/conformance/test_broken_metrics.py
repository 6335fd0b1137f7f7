"""All but the first of `METRICS` and `LOSSES` find equal pictures equal, so that nothing else is wrong with them."""

from functools import partial

import numpy as np
import pytest
import torch

from bench.conformance.stress import metrics
from bench.metrics.base import SliceMetric
from bench.metrics.psnr import squared_error

CASES = {case.name: case for case in metrics.CASES}
PEAK = torch.tensor(8.0).log1p()  # of the log radiance of white


class Broken(SliceMetric):
    def __init__(self, fault):
        self.fault = fault

    def reference_side(self, reference):
        return reference

    def compare(self, side, test):
        return self.fault(side, test)


class Signed(Broken):
    def __init__(self, of_test):
        super().__init__(lambda reference, test: squared_error(reference.linear, test.linear))
        self.of_test = of_test

    def prepare(self, reference, exposure):
        state = super().prepare(reference, exposure)
        if not self.of_test:
            state.side.linear = np.moveaxis(reference, -1, 0)
        return state

    def error_map(self, state, test):
        if not self.of_test:
            return super().error_map(state, test)
        return squared_error(state.side.linear, np.moveaxis(test, -1, 0))


def relative_to(side):
    def fault(reference, test):
        error = np.abs(reference.linear - test.linear)
        return np.where(error > 0, error / (reference, test)[side].linear, 0).mean(0)

    return fault


def sample_deviation(reference, test):
    own = reference.luma - reference.luma.mean()
    covariance = (own * (test.luma - test.luma.mean())).sum() / np.float64(own.size - 1)
    return squared_error(reference.display, test.display) + 0 * covariance


METRICS = {
    "equal": Broken(lambda ours, test: squared_error(ours.linear.astype(np.float16), test.linear)),
    "both black": Broken(lambda ours, test: (np.abs(ours.linear - test.linear) / ours.linear).mean(0)),
    "both white": Broken(lambda ours, test: np.abs(np.log((1 - ours.exposed) / (1 - test.exposed))).mean(0)),
    "black, seen white": Broken(relative_to(0)),
    "white, seen black": Broken(relative_to(1)),
    "one texel": Broken(sample_deviation),
    "HDR": Broken(lambda ours, test: np.square((ours.linear - test.linear).astype(np.float16)).mean(0)),
    "HDR, equal": Broken(lambda ours, test: np.abs(np.exp(ours.linear) - np.exp(test.linear)).mean(0)),
    "negative as black": Signed(of_test=True),
    "negative reference": Signed(of_test=False),
}


def relative_loss(ours, target):
    return ((ours - target).abs() / target).mean()


def guarded(over):
    def loss(ours, target):
        differ = ours != target
        return ((ours - target).abs() / (ours, target)[over])[differ].sum()

    return loss


LOSSES = {
    "equal": lambda ours, target: ((ours - target).square() + 1e-6).sqrt().mean(),
    "both black": relative_loss,
    "both white": lambda ours, target: ((PEAK - ours).log() - (PEAK - target).log()).abs().mean(),
    "black, seen white": guarded(1),
    "white, seen black": guarded(0),
    "one texel": lambda ours, target: (ours.diff(dim=0) - target.diff(dim=0)).abs().mean(),
    "HDR": lambda ours, target: (ours.expm1() - target.expm1()).half().square().mean(),
    "HDR, equal": lambda ours, target: (ours.expm1().half() - target.expm1().half()).abs().mean(),
    "negative as black": relative_loss,  # a loss sees radiance that is clamped: both are black
    "negative reference": relative_loss,
}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("kind", ["metric", "loss"])
def test_what_breaks_there_fails(name, kind):
    test = (
        partial(metrics.check_metric, METRICS[name]) if kind == "metric" else partial(metrics.check_loss, LOSSES[name])
    )
    with np.errstate(all="ignore"):
        result = metrics.judge(test, CASES[name])
        assert result.verdict == "fail", result
        assert result.figure in {"nan", "inf", "not finite"} or float(result.figure) > 0  # no exception: a wrong number
        if name != "equal":
            assert metrics.judge(test, CASES["equal"]).verdict == "pass"


def test_a_loss_without_a_gradient_fails():
    root = partial(metrics.check_loss, lambda ours, target: (ours - target).square().mean().sqrt())
    result = metrics.judge(root, CASES["both black"])
    assert (result.verdict, result.figure) == ("fail", "not finite")
