import colorsys

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter
from torch import Tensor

from bench.metrics.display import LUMA
from neubtf.augmentation import Crop, Disturbance, blurred, draw_scale, gaussians, rotation, saturated, taps_of, turned
from neubtf.autoencoder import STRIDE, Autoencoder, Pooled


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def picture(height: int = 24, width: int = 32) -> Tensor:
    return torch.rand(1, 3, height, width, generator=generator(7))


def windows(shape: tuple[int, int], largest: int, periodic: bool) -> list[Crop]:
    random = generator()
    return [Crop.drawn(shape, largest, draw_scale(0.5, 0.5, random), periodic, random, 16) for _ in range(200)]


@pytest.mark.parametrize("keep", [0.0, 0.5, 1.0])
def test_scales_are_kept_in_a_share_of_the_draws_and_else_within_the_range(keep: float) -> None:
    random = generator()
    scales = np.array([draw_scale(0.5, keep, random) for _ in range(400)])
    assert (scales == 1).mean() == pytest.approx(keep, abs=0.08)
    assert keep == 1 or (0.5 <= scales.min() < 0.52 and 0.97 < scales[scales < 1].max() < 1)


@pytest.mark.parametrize("periodic", [True, False])
def test_windows_fit_the_strides_and_cover_the_picture(periodic: bool) -> None:
    found = windows((160, 144), 32, periodic)
    for window in found:
        assert all(side % STRIDE == 0 and STRIDE <= side <= 32 for side in window.inner_size)
        assert window.around == (16, 16)
    kept = [window for window in found if window.keeps_scale]
    last = [(window.corner[0] + 16) % 160 + window.inner_size[0] for window in kept]
    assert (max(last) > 160) == periodic
    assert {window.corner[0] % STRIDE for window in found} == {0, 1, 2, 3}


def test_a_side_that_its_surroundings_would_fill_is_whole() -> None:
    for window in windows((48, 160), 32, True):
        assert window.source[0] == 48
        assert window.whole == (True, False)
        assert window.inner_size[0] == window.size[0]


def test_a_crop_is_coded_as_in_the_whole_picture() -> None:
    """Padded as if it repeated, its borders would be far off: the autoencoder reaches 36 texels."""
    whole = torch.rand(1, 3, 128, 128, generator=generator(3))
    network = Autoencoder(6, generator())
    window = Crop.drawn((128, 128), 32, 1.0, True, generator(5), 16).aligned()
    seen = whole.flatten(2)[..., window.texels((128, 128))].unflatten(2, window.source)
    with torch.no_grad():
        pooled = Pooled.of_cells(network.encode(whole).deep)  # over the whole picture, which no crop can know
        expected = network.decode(network.encode(whole), pooled).flatten(2)[0, :, window.texels((128, 128))]
        found = network.decode(network.encode(seen), pooled)[0].flatten(1)
        inner = window.inner(torch.device("cpu"))
        alone = seen.flatten(2)[..., inner].unflatten(2, window.inner_size)
        padded = network.decode(network.encode(alone), pooled)[0].flatten(1)
    errors = [(x - expected[:, inner]).square().mean().sqrt() / expected.std() for x in (found[:, inner], padded)]
    assert errors[0] < 0.01 < 0.05 < errors[1]


def test_a_window_beyond_the_border_goes_on_at_the_other() -> None:
    whole = picture()
    window = Crop((20, 30), (8, 4), (8, 4))
    seen = whole.flatten(2)[..., window.texels((24, 32))].unflatten(2, window.source)
    torch.testing.assert_close(window.rescaled(seen), whole.roll((-20, -30), (2, 3))[..., :8, :4])


def test_half_the_scale_averages() -> None:
    window, whole = Crop((0, 0), (24, 32), (12, 16)), picture()
    torch.testing.assert_close(window.rescaled(torch.full((1, 3, 24, 32), 0.3)), torch.full((1, 3, 12, 16), 0.3))
    assert window.rescaled(whole).std() < 0.6 * whole.std()
    assert window.rescaled(whole).mean() == pytest.approx(whole.mean().item(), abs=0.01)


def test_taps_are_the_rescale_of_single_texels() -> None:
    for window in (Crop((3, 5), (21, 13), (16, 8)), Crop((3, 5), (8, 8), (8, 8)), Crop((0, 0), (9, 16), (4, 4))):
        seen = torch.rand(1, 3, *window.source, generator=generator())
        texel = torch.arange(window.size[0] * window.size[1])
        index, weight = window.taps(texel)
        mean = (seen.flatten(2)[0][:, index] * weight).sum(2)
        torch.testing.assert_close(mean, window.rescaled(seen)[0].flatten(1))
        assert (index.shape[1] == 1) == window.keeps_scale


def test_taps_of_several_windows_are_texels_of_the_picture_with_their_weights() -> None:
    whole = picture()
    windows = [Crop((3, 5), (11, 9), (8, 8)), Crop((20, 28), (8, 8), (8, 8))]  # the second reaches over the borders
    texels, weights = taps_of(windows, (24, 32), torch.device("cpu"))
    for at, window in enumerate(windows):
        seen = whole.flatten(2)[..., window.texels((24, 32))].unflatten(2, window.source)
        mean = (whole.flatten(2)[0][:, texels[at]] * weights[at]).sum(2)
        torch.testing.assert_close(mean, window.rescaled(seen)[0].flatten(1))


@pytest.mark.parametrize("turn", [0.0, 1 / 3, 0.25, 0.9])
def test_hue_turns_by_its_share_of_the_wheel(turn: float) -> None:
    start = torch.tensor([0.6, 0.4, 0.4]).reshape(1, 3, 1, 1)
    red, green, blue = turned(start, rotation(torch.tensor([turn]))).flatten().tolist()
    # The hue of an orthonormal wheel and that of HSV agree at each sixth of a turn, and to 0.02 between.
    assert colorsys.rgb_to_hsv(red, green, blue)[0] == pytest.approx(turn, abs=0.02)
    assert red + green + blue == pytest.approx(1.4)


def test_blur_is_a_gaussian_of_each_pictures_own_width() -> None:
    widths = [0.4, 1.0, 2.5]
    before = torch.cat([picture().double().roll(at, 2) for at in range(len(widths))])
    after = blurred(before, *gaussians(torch.tensor(widths, dtype=torch.float64)))
    for sigma, ours, whole in zip(widths, after.numpy(), before.numpy(), strict=True):
        for channel, seen in zip(ours, whole, strict=True):
            expected = gaussian_filter(seen, sigma, mode="wrap", radius=int(np.ceil(3 * sigma)))
            np.testing.assert_allclose(channel, expected, rtol=1e-9)


def test_no_width_is_no_blur() -> None:
    torch.testing.assert_close(blurred(picture(), *gaussians(torch.zeros(1))), picture())


def test_the_pictures_of_a_batch_are_disturbed_each_in_its_own_way() -> None:
    twice = Disturbance().disturbed(picture().repeat(2, 1, 1, 1), generator(1))
    assert (twice[0] - twice[1]).abs().mean() > 0.05


def test_a_disturbance_is_seeded_and_stays_in_range() -> None:
    one = Disturbance().disturbed(picture(), generator(1))
    assert one.equal(Disturbance().disturbed(picture(), generator(1)))
    assert not one.equal(Disturbance().disturbed(picture(), generator(2)))
    assert one.min() >= 0
    assert one.max() <= 1
    assert Disturbance(0, 0, 0, 0).disturbed(picture(), generator(1)).allclose(picture())


def test_saturation_goes_from_grey_through_the_picture_to_more() -> None:
    three = saturated(picture().repeat(3, 1, 1, 1), torch.tensor([0.0, 1.0, 1.5]))
    grey = (picture()[0] * torch.tensor(LUMA).float()[:, None, None]).sum(0)
    torch.testing.assert_close(three[0], grey.expand(3, -1, -1))
    torch.testing.assert_close(three[1], picture()[0])
    assert (three[2] - grey).abs().mean() > 1.1 * (three[1] - grey).abs().mean()
    colours = Disturbance(blur=0, noise=0).disturbed(picture().repeat(200, 1, 1, 1), generator(1))
    spread = (colours - colours.mean(1, keepdim=True)).abs().mean((1, 2, 3))  # of each picture over its channels
    assert spread.min() < 0.1 * spread.median()  # some are almost grey
