import numpy as np
import pytest

from bench.data.materials.maps import Maps, resize
from bench.inputs.errors import InputError


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"height": np.zeros((3, 4))}, "shape"),
        ({"base_colour": np.zeros((2, 2, 3))}, "base_colour"),
        ({"roughness": 1.5}, "roughness"),
        ({"metalness": -0.1}, "metalness"),
        ({"height": np.full((3, 5), np.nan)}, "height"),
        ({"height": np.zeros((3, 5, 2))}, "height"),
    ],
)
def test_maps_that_make_no_sense_are_refused_by_name(change, named):
    good = {"height": np.zeros((3, 5)), "base_colour": 0.5, "roughness": np.full((3, 5), 0.5)}
    with pytest.raises(InputError, match=named):
        Maps(**good | change)


@pytest.mark.parametrize("shape", [(4, 3), (16, 24), (12, 12), (5, 7)])
def test_resizing_keeps_the_mean(shape):
    """To float32 rounding, where every texel has the same weight: whenever it shrinks, or grows by a whole factor."""
    picture = np.random.default_rng(0).random((8, 12))
    if all(new <= old or new % old == 0 for new, old in zip(shape, picture.shape, strict=True)):
        assert resize(picture, shape).mean() == pytest.approx(picture.mean(), rel=1e-6)
    assert resize(np.full((8, 12), 0.3), shape) == pytest.approx(0.3)
    np.testing.assert_allclose(resize(picture, (2, 3)), picture.reshape(2, 4, 3, 4).mean((1, 3)))


def test_resizing_wraps_around():
    picture = np.random.default_rng(0).random((8, 12, 3))
    moved = resize(np.roll(picture, (2, 3), (0, 1)), (16, 24))
    np.testing.assert_allclose(moved, np.roll(resize(picture, (16, 24)), (4, 6), (0, 1)), atol=1e-7)


def test_angles_are_averaged_modulo_a_half_turn_and_normals_stay_unit_vectors():
    angle = np.array([[np.radians(175), np.radians(5)]])
    normal = np.array([[[0.6, 0, 0.8], [-0.6, 0, 0.8]]])
    maps = Maps(height=0, base_colour=0.5, roughness=0.5, angle=angle, normal=normal).resized((1, 1))
    assert np.sin(maps.angle).item() == pytest.approx(0, abs=1e-6)
    np.testing.assert_allclose(maps.normal, [[[0, 0, 1]]], atol=1e-6)
