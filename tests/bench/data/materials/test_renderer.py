from dataclasses import replace

import numpy as np
import pytest

from bench.data.materials import renderer
from bench.data.materials.maps import Maps
from bench.data.materials.procedural import grid, smooth
from bench.data.materials.renderer import half_a_texel_further, render
from bench.directions.hemisphere import from_degrees, uniform
from bench.inputs.errors import InputError


def pair(view, light):
    return from_degrees(*view)[None], from_degrees(*light)[None]


def luminance(maps, view, light, size=(32, 32), sub_points=2):
    return render(maps, *pair(view, light), size, sub_points)[0].mean(-1)


def random_pairs(count, seed=0):
    rng = np.random.default_rng(seed)
    return uniform(rng, count), uniform(rng, count)


def bump(size=64, height=0.1, width=0.08):
    u, v = grid(size)
    return height * np.exp(-((u - 0.5) ** 2 + (v - 0.5) ** 2) / (2 * width**2))


@pytest.fixture(scope="module")
def rich():
    rng = np.random.default_rng(0)
    maps = [smooth(rng, 32, 0.06, 0.06) for _ in range(5)]
    colour, roughness = np.clip(0.5 + 0.2 * np.stack(maps[1:4], -1), 0, 1), np.clip(0.5 + 0.1 * maps[4], 0.1, 1)
    metalness, anisotropy = np.clip(maps[1:3], 0, 1)
    return Maps(0.02 * maps[0], colour, roughness, metalness=metalness, anisotropy=anisotropy, angle=maps[3])


def test_flat_diffuse_is_albedo_over_pi_times_the_cosine():
    wo, wi = random_pairs(50)
    colour = np.array([0.2, 0.5, 0.9])
    slices = render(Maps(0, colour, 0.5, specular=0), wo, wi, (2, 3))
    expected = np.broadcast_to(colour / np.pi * wi[:, None, None, 2:], slices.shape)
    np.testing.assert_allclose(slices, expected, rtol=1e-5)  # float32 through a dozen roundings


@pytest.mark.parametrize("steps", [(1, 0), (0, 1), (5, 11)])
def test_shifting_the_maps_by_texels_shifts_the_slices(rich, steps):
    """So there is no seam: where the picture is cut cannot be told from the slice."""
    wo, wi = random_pairs(12, 3)
    fields = {n: getattr(rich, n) for n in ("height", "base_colour", "roughness", "metalness", "anisotropy", "angle")}
    moved = Maps(**{n: np.roll(m, np.multiply(steps, 2), (0, 1)) for n, m in fields.items()})
    slices = render(rich, wo, wi, (16, 16))
    expected = np.roll(slices, steps, (1, 2))
    np.testing.assert_allclose(render(moved, wo, wi, (16, 16)), expected, rtol=2e-3, atol=1e-3 * slices.max())


@pytest.mark.parametrize(("phi_deg", "side"), [(90, "top"), (270, "bottom"), (0, "right"), (180, "left")])
def test_light_brightens_the_slopes_that_face_it(phi_deg, side):
    """Azimuth 90° is the top edge of the picture, row 0; 0° is the right edge: the frame is right-handed."""
    picture = luminance(Maps(bump(height=0.05), 0.5, 0.5, specular=0), (0, 0), (40, phi_deg))
    halves = {"top": picture[8:16], "bottom": picture[16:24], "left": picture[:, 8:16], "right": picture[:, 16:24]}
    opposite = {"top": "bottom", "bottom": "top", "left": "right", "right": "left"}
    assert halves[side].mean() > 1.05 * halves[opposite[side]].mean()


@pytest.mark.parametrize("phi_deg", [0, 90, 180, 270])
def test_a_raised_spot_is_seen_nearer_to_the_far_side_of_the_view(phi_deg):
    """The ray that meets height h above p₀ passes the plane at p₀ − h · ω_xy / ω_z: spots move away from the camera."""
    u, v = grid(64)
    spot = (np.hypot(u - 0.5, v - 0.5) < 0.06).astype(float)
    plateau = np.where(np.hypot(u - 0.5, v - 0.5) < 0.12, 0.05, 0)
    maps = Maps(plateau, 0.02 + 0.9 * spot[..., None] * np.ones(3), 0.5, specular=0)
    picture = luminance(maps, (50, phi_deg), (0, 0), (64, 64))
    bright = picture * (picture > 0.1)
    seen = np.array([(bright * u).sum(), (bright * v).sum()]) / bright.sum()
    wo = from_degrees(50, phi_deg)
    expected = 0.5 - (0.05 - plateau.mean()) * wo[:2] / wo[2]
    np.testing.assert_allclose(seen, expected, atol=1 / 64)  # a texel


def test_highlights_stretch_along_the_angle_of_the_map():
    for angle in (0.0, np.pi / 2, np.pi / 4):
        maps = Maps(0, 0.9, 0.4, metalness=1, anisotropy=0.9, angle=angle)
        along, across = (luminance(maps, (0, 0), (40, np.degrees(angle) + turn), (1, 1)).item() for turn in (0.0, 90.0))
        assert along > 10 * across


def test_a_normal_map_of_the_slopes_shades_as_the_slopes_do():
    """OpenGL convention, green up: with the normals of the height field itself nothing changes."""
    height = bump(64, 0.05)
    normal = np.moveaxis(renderer.HeightField(height.astype(np.float32), 1.0).normals(), 0, -1)
    wo, wi = random_pairs(6, 4)
    given, derived = (render(Maps(height, 0.5, 0.5, normal=n), wo, wi, (32, 32)) for n in (normal, None))
    np.testing.assert_array_equal(given, derived)


def test_a_texel_is_the_mean_of_its_sub_points(rich):
    wo, wi = random_pairs(6, 5)
    fine = render(rich, wo, wi, (32, 32), 1)
    mean = fine.reshape(6, 16, 2, 16, 2, 3).mean((2, 4))
    np.testing.assert_allclose(render(rich, wo, wi, (16, 16), 2), mean, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("size", [(16, 16), (5, 4), (12, 16)])
def test_half_a_texel_further_lie_the_texels_of_a_picture_twice_as_fine(rich, size):
    bumpy = replace(rich, normal=np.moveaxis(renderer.HeightField(rich.height, 1).normals(), 0, -1))
    wo, wi = random_pairs(4)
    for maps in (rich, bumpy):
        moved = render(half_a_texel_further(maps, size, 2), wo, wi, size, 2)
        fine = render(maps, wo, wi, (2 * size[0], 2 * size[1]), 1)
        fine = np.roll(fine, (-1, -1), (1, 2))  # the lower right texel of each four now comes first
        expected = fine.reshape(4, size[0], 2, size[1], 2, 3).mean((2, 4))
        np.testing.assert_allclose(moved, expected, rtol=1e-4, atol=1e-5)


def test_pictures_need_not_be_square():
    u, v = grid(32)
    square = 0.03 * np.sin(2 * np.pi * u) * np.sin(2 * np.pi * v)
    wide = np.tile(square, (1, 2)) / 2  # heights are in units of the width, which has doubled
    wo, wi = random_pairs(6, 6)
    one, two = (render(Maps(h, 0.5, 0.5), wo, wi, (16, w)) for h, w in ((square, 16), (wide, 32)))
    assert two.shape == (6, 16, 32, 3)
    np.testing.assert_allclose(two, np.tile(one, (1, 1, 2, 1)), rtol=1e-3, atol=1e-5)


def test_the_number_of_threads_and_the_order_of_the_pairs_change_nothing(rich, monkeypatch):
    wo, wi = np.repeat(random_pairs(4)[0], 4, 0), np.tile(random_pairs(4)[1], (4, 1))
    monkeypatch.setattr(renderer, "cores", lambda: 1)
    one = render(rich, wo, wi, (16, 16))
    monkeypatch.setattr(renderer, "cores", lambda: 3)
    np.testing.assert_array_equal(one, render(rich, wo, wi, (16, 16)))
    order = np.random.default_rng(0).permutation(16)
    np.testing.assert_array_equal(one[order], render(rich, wo[order], wi[order], (16, 16)))


@pytest.mark.parametrize(
    ("wo", "wi", "size"),
    [([[0, 0, -1]], [[0, 0, 1]], (4, 4)), ([[0, 0, 1]] * 2, [[0, 0, 1]], (4, 4)), ([[0, 0, 1]], [[0, 0, 1]], (0, 4))],
)
def test_what_cannot_be_rendered_is_refused(rich, wo, wi, size):
    with pytest.raises(InputError):
        render(rich, wo, wi, size)
