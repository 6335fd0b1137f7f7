import numpy as np
import pytest

from bench.directions.hemisphere import DIRECTION_SETS, from_degrees, thin, to_degrees, ubo2003, ubo2014, uniform

UBO2014 = {0: 1, 11: 6, 23.5: 12, 30: 12, 37.5: 12, 45: 18, 52.5: 18, 60: 24, 67.5: 24, 75: 24}


@pytest.mark.parametrize(
    ("made", "rings"), [(ubo2003, {0: 1, 15: 6, 30: 12, 45: 18, 60: 20, 75: 24}), (ubo2014, UBO2014)]
)
def test_the_published_sets_have_their_sizes_and_rings(made, rings):
    theta, counts = np.unique(to_degrees(made())[0].round(3), return_counts=True)
    assert dict(zip(theta.tolist(), counts.tolist(), strict=True)) == pytest.approx(rings)


def test_the_frame_is_right_handed_with_x_right_and_y_up():
    np.testing.assert_allclose(from_degrees([90, 90, 0], [0, 90, 123]), np.eye(3), atol=1e-7)


@pytest.mark.parametrize("name", DIRECTION_SETS)
def test_thinning_keeps_the_zenith_and_spreads_the_rest(name):
    directions = DIRECTION_SETS[name]()
    chosen = thin(directions, 25)
    assert len(set(chosen.tolist())) == 25
    assert (np.diff(chosen) > 0).all()
    assert directions[chosen, 2].max() == 1
    apart = np.linalg.norm(directions[chosen][:, None] - directions[chosen], axis=-1) + 9 * np.eye(25)
    # 25 caps that share the solid angle up to 75° evenly have a radius near 0.24; the spacing is about twice that.
    assert apart.min() > 0.24
    np.testing.assert_array_equal(thin(directions, len(directions)), np.arange(len(directions)))
    for count in (0, len(directions) + 1):
        with pytest.raises(ValueError, match="between 1 and"):
            thin(directions, count)


def test_uniform_directions_are_uniform_in_solid_angle():
    directions = uniform(np.random.default_rng(0), 20000)
    theta, phi = to_degrees(directions)
    assert theta.max() <= 75
    # z and φ are uniform; a mean of 20,000 draws has a standard error of range / √(12 · 20,000) = range / 490.
    low = np.cos(np.radians(75))
    assert abs(directions[:, 2].mean() - (1 + low) / 2) < 4 * (1 - low) / 490
    assert abs(phi.mean() - 180) < 4 * 360 / 490
