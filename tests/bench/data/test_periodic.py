import numpy as np
import pytest

from bench.data.periodic import make_periodic, seams
from bench.errors import InputError


def test_blending_makes_a_picture_periodic():
    """A ramp is the worst case: its ends differ most. Across the cut it steps no further than inside the blend."""
    ramp = np.repeat(np.linspace(0, 1, 80)[:, None], 60, 1)
    blended = make_periodic(ramp, (20, 10))
    assert blended.shape == (60, 50)
    steps = np.abs(np.diff(blended, axis=0, append=blended[:1]))
    assert steps[-1].max() <= steps[:-1].max()


def test_blending_keeps_the_contrast_of_texture():
    noise = np.random.default_rng(0).normal(size=(400, 400))
    blended = make_periodic(noise, (100, 100))
    assert blended[:100].std() == pytest.approx(1, abs=0.03)


def test_each_channel_of_a_colour_picture_is_blended_by_itself():
    noise = np.random.default_rng(0).normal([0.0, 1, 9], size=(40, 30, 3))
    blended = make_periodic(noise, (0, 10))
    assert blended.shape == (40, 20, 3)
    for channel in range(3):
        np.testing.assert_allclose(blended[..., channel], make_periodic(noise[..., channel], (0, 10)), atol=1e-12)


def test_margins_that_do_not_fit_are_refused():
    with pytest.raises(InputError, match="margins of 1 × 6 do not fit twice into a picture of 12 × 10"):
        make_periodic(np.zeros((10, 12, 3)), (6, 1))


def test_a_seam_is_told_from_what_lies_inside():
    """Steps of one to the right everywhere, and back by seven at the border."""
    ramp = np.repeat(np.arange(8.0)[None, :, None], 5, 0)
    assert seams(ramp) == ((7, 1, 1), (0, 0, 0))
    assert seams(ramp.swapaxes(0, 1)) == ((0, 0, 0), (7, 1, 1))
    assert seams(ramp[:, :3])[0] == (0, 1, 1)
