import numpy as np
import pytest

from bench.data.materials.maps import make_periodic, seams
from bench.inputs.errors import InputError


def test_blending_makes_a_picture_periodic():
    """A ramp is the worst case: its ends differ most. Across the cut it steps no further than inside the blend."""
    ramp = np.repeat(np.linspace(0, 1, 80)[:, None], 60, 1)
    blended = make_periodic(ramp, (20, 10))
    assert blended.shape == (60, 50)
    steps = np.abs(np.diff(blended, axis=0, append=blended[:1]))
    assert steps[-1].max() <= steps[:-1].max()


def test_blending_keeps_the_contrast_of_texture_in_each_channel():
    noise = np.random.default_rng(0).normal([0.0, 1, 9], size=(400, 400, 3))
    blended = make_periodic(noise, (100, 100))
    assert blended.shape == (300, 300, 3)
    assert blended[:100].std((0, 1)) == pytest.approx([1, 1, 1], abs=0.03)
    with pytest.raises(InputError, match="margins"):
        make_periodic(noise, (201, 1))


def test_a_seam_is_told_from_what_lies_inside():
    """Steps of one to the right everywhere, and back by seven at the border."""
    ramp = np.repeat(np.arange(8.0)[None, :, None], 5, 0)
    assert seams(ramp) == ((7, 1, 1), (0, 0, 0))
    assert seams(ramp.swapaxes(0, 1)) == ((0, 0, 0), (7, 1, 1))
    assert seams(ramp[:, :3])[0] == (0, 1, 1)
