"""The loss of displayed errors: its curve, its weights, and that a fit by it gains in the metric that decides."""

import numpy as np
import pytest
import torch

from bench.metrics.display import LOG_SCALE, to_display
from bench.training.display_loss import LEAST_ERROR, LOG_SHARE, SHOWN_FROM, WEIGHT, DisplayLoss, displayed


def test_the_curve_is_that_of_the_metric() -> None:
    radiance = np.concatenate([[0, 1e-6, 0.0031308, 0.5, 1, 2, 1e6], np.random.default_rng(0).random(50)])
    level = torch.from_numpy(np.log1p(LOG_SCALE * radiance))
    np.testing.assert_allclose(displayed(level).numpy(), to_display(radiance, 1.0), atol=1e-6)


def test_its_gradient_is_finite_everywhere() -> None:
    level = torch.tensor([-5.0, -1e-30, 0.0, 1e-30, 1e-8, 1.0, 15.0, 50.0, 1e30], requires_grad=True)
    displayed(level).sum().backward()
    assert level.grad is not None
    assert level.grad.isfinite().all()


def test_slices_count_alike_whatever_their_error() -> None:
    """Two directions, one with errors ten times as large: both give the same share of the loss."""
    loss, target = DisplayLoss(2), torch.full((64, 3), 1.0)
    direction = torch.arange(64) % 2
    ours = (target + torch.where(direction == 0, 0.2, 0.02)[:, None]).requires_grad_()
    both = torch.zeros(())
    for _ in range(300):
        assert loss(ours.detach(), target, direction, both, SHOWN_FROM / 2) == both  # not yet
    value = loss(ours, target, direction, both, SHOWN_FROM)
    assert float(value.detach()) == pytest.approx(WEIGHT, rel=0.1)
    value.backward()
    assert ours.grad is not None
    pull = (ours.grad * (ours - target)).detach().sum(1)
    assert float(pull[direction == 0].sum()) == pytest.approx(float(pull[direction == 1].sum()), rel=0.1)


def test_a_perfect_answer_has_only_the_share_of_the_other_loss() -> None:
    loss, target = DisplayLoss(3), torch.rand(10, 3)
    value = loss(target, target, torch.zeros(10, dtype=torch.long), torch.tensor(2.0), 1.0)
    assert float(value) == pytest.approx(2 * LOG_SHARE)
    assert LEAST_ERROR > 0
