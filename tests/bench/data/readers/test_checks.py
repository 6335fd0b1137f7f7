import numpy as np

from bench.btf import BTF, ArraySource
from bench.data.readers.checks import refuse_extremes


def test_extremes_are_looked_for_in_each_channel():
    """A picture of 200 x 200 texels has more values than are looked at: a step of three would meet red alone."""
    radiance = np.ones((1, 200, 200, 3), np.float32)
    radiance[..., 0] = 1e-14
    up = np.array([[0, 0, 1]], np.float32)
    refuse_extremes(BTF("hardly any red", up, up, ArraySource(radiance)))
