import numpy as np
import pytest

from bench.btf import BTF, ArraySource
from bench.data.readers.checks import in_degrees, refuse_extremes, warn_of_radians
from bench.directions.hemisphere import from_degrees, uniform
from bench.inputs.errors import InputError


def test_extremes_are_looked_for_in_each_channel():
    """A picture of 200 x 200 texels has more values than are looked at: a step of three would meet red alone."""
    radiance = np.ones((1, 200, 200, 3), np.float32)
    radiance[..., 0] = 1e-14
    up = np.array([[0, 0, 1]], np.float32)
    refuse_extremes(BTF("hardly any red", up, up, ArraySource(radiance)))


def test_the_words_for_dim_data_say_which_value_is_too_small():
    """Where less than 1 % of the values are lit, the 99th percentile is 0, which is no fault."""
    radiance = np.zeros((1, 20, 20, 3), np.float32)
    radiance[0, 0, 0] = 1e-20
    up = np.array([[0, 0, 1]], np.float32)
    with pytest.raises(InputError, match=r"its largest value is 1e-20, below 1e-12"):
        refuse_extremes(BTF("one dim texel", up, up, ArraySource(radiance)))


RNG = np.random.default_rng(0)
THETA, PHI = RNG.uniform(0, 75, (60, 2)), RNG.uniform(0, 360, (60, 2))


@pytest.mark.parametrize(
    "columns", ["theta_o", "theta_i", "phi_o", "phi_i", "theta_o theta_i", "phi_o phi_i", "theta_i phi_i"]
)
@pytest.mark.parametrize("as_vectors", [False, True])
def test_each_column_of_radians_among_degrees_is_named(caplog, columns, as_vectors):
    angles = {"theta": THETA.copy(), "phi": PHI.copy()}
    for column in columns.split():
        symbol, side = column.split("_")
        angles[symbol][:, "oi".index(side)] *= np.pi / 180
    if as_vectors:
        wo, wi = (from_degrees(angles["theta"][:, side], angles["phi"][:, side]) for side in (0, 1))
        warn_of_radians(wo, wi, "a.npz")
    else:
        in_degrees(angles["theta"], angles["phi"], "a.csv", "")
    (record,) = caplog.records
    named = record.getMessage().split("numbers of ")[1].split(" are as")[0].split(" and ")
    assert sorted(named) == sorted(columns.split())


def test_angles_that_are_degrees_are_not_called_radians(caplog):
    in_degrees(THETA, PHI, "scattered", "")
    in_degrees(np.stack([0 * THETA[:, 0], THETA[:, 0]], 1), np.stack([0 * PHI[:, 0], PHI[:, 0]], 1), "one view", "")
    small = np.tile([[0.0, 1, 2, 3]], (2, 1)).T
    in_degrees(20 * small, small, "a few whole degrees around one plane", "")
    jitter = np.stack([1.1 + 0.1 * RNG.random(60), THETA[:, 1]], 1)
    in_degrees(jitter, PHI, "a camera that stands still", "")
    in_degrees(THETA * np.pi / 180, PHI, "as the user says", "degrees")
    warn_of_radians(uniform(RNG, 60), uniform(RNG, 60), "vectors")
    assert not caplog.records
