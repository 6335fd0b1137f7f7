import math

import numpy as np
import pytest
import torch
from scipy.ndimage import correlate
from torch import Tensor

from neubtf.published import SCALES, Style, focal_frequency, linear_display


def pictures(seed: int, size: tuple[int, int] = (12, 20)) -> Tensor:
    return torch.rand(2, 3, *size, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def gram(picture: np.ndarray, filters: np.ndarray) -> np.ndarray:
    responses = np.stack([sum(correlate(picture[c], f[c], mode="wrap") for c in range(3)) for f in filters])
    flat = np.maximum(responses, 0).reshape(len(filters), -1)
    return flat @ flat.T / flat.shape[1]


def halved(pictures: np.ndarray) -> np.ndarray:
    height, width = pictures.shape[2:]
    return pictures.reshape(*pictures.shape[:2], height // 2, 2, width // 2, 2).mean((3, 5))


def test_style_is_the_difference_of_gram_matrices() -> None:
    style, ours, theirs = Style().double(), pictures(1, (16, 24)), pictures(2, (16, 24))
    a, b, found = ours.numpy(), theirs.numpy(), []
    for filters in style.bank.numpy():
        found += [np.square(gram(x, filters) - gram(y, filters)).mean() for x, y in zip(a, b, strict=True)]
        a, b = (halved(x) if x.shape[2] > 4 else x for x in (a, b))
    assert len(found) == 2 * SCALES
    torch.testing.assert_close(style(ours, theirs).item(), float(np.mean(found)))


def test_where_a_picture_does_not_repeat_its_borders_are_not_joined() -> None:
    """A step across the border of a crop is none of its texture."""
    style, flat = Style().double(), torch.full((1, 3, 16, 16), 0.5, dtype=torch.float64)
    slope = flat + torch.linspace(-0.3, 0.3, 16, dtype=torch.float64)
    shifted = slope.roll(8, 3)
    assert style(slope, shifted).item() < 1e-12
    assert style(slope, shifted, (True, False)).item() > 1e-6


def test_focal_frequency_weighs_what_is_far_off() -> None:
    ours, theirs = pictures(1), pictures(2)
    found = []
    for x, y in zip(ours.numpy(), theirs.numpy(), strict=True):
        for channel in range(3):
            distance = np.abs(np.fft.fft2(x[channel]) - np.fft.fft2(y[channel])) / np.sqrt(x[channel].size)
            found.append((distance / distance.max() * distance**2).mean())
    torch.testing.assert_close(focal_frequency(ours, theirs).item(), float(np.mean(found)))


def test_the_weight_of_a_frequency_is_held_constant() -> None:
    ours, theirs = pictures(1).requires_grad_(), pictures(2)
    focal_frequency(ours, theirs).backward()
    difference = np.fft.fft2((ours.detach() - theirs).numpy(), norm="ortho")
    weight = np.abs(difference) / np.abs(difference).max((2, 3), keepdims=True)
    # d/dx of Σ w |F(x) − F'|² / n, for a real x and an orthonormal transform.
    expected = 2 * np.fft.ifft2(weight * difference, norm="ortho").real / difference.size
    assert ours.grad is not None
    torch.testing.assert_close(ours.grad.numpy(), expected)


@pytest.mark.parametrize(("ours", "theirs"), [(0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0)])
def test_black_and_white_have_gradients(ours: float, theirs: float) -> None:
    level = torch.full((1, 3, 8, 8), math.log1p(8 * ours), requires_grad=True)
    truth = torch.full((1, 3, 8, 8), theirs)
    loss = focal_frequency(linear_display(level), truth) + Style()(linear_display(level), truth)
    loss.backward()
    assert loss.item() == pytest.approx(0, abs=1e-9) if ours == theirs else loss.item() > 0.01
    assert level.grad is not None
    assert level.grad.isfinite().all()


def test_log_radiance_is_shown_linear_and_clipped() -> None:
    linear = torch.tensor([0.0, 0.3, 1.0, 7.0], dtype=torch.float64)
    torch.testing.assert_close(linear_display((8 * linear).log1p()), linear.clamp(0, 1))
    assert linear_display(torch.tensor(-0.5)) == 0
