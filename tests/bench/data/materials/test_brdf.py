import math

import numpy as np
import pytest

from bench.data.materials import brdf
from bench.directions.hemisphere import from_degrees, uniform


def reflectance(o, i, roughness=0.5, metalness=0.0, specular=1.0, anisotropy=0.0, base=1.0):
    """f · cos θ_i (N,) float64, one channel, of one material at N pairs of directions (3, N)."""
    o, i = np.broadcast_arrays(np.asarray(o, np.float64), np.asarray(i, np.float64))
    names = {"roughness": roughness, "metalness": metalness, "specular": specular, "anisotropy": anisotropy}
    maps = {name: np.full(o.shape[1], value) for name, value in names.items()}
    at = brdf.points(tuple(o), maps | {"base": np.full(o.shape, base)})
    between = (o * i).sum(0)
    through, lobe = brdf.reflect(at, tuple(i), between)
    return (at.diffuse * through + brdf.specular_colour(at, between) * lobe)[0]


def hemisphere(rings=400, sectors=800):
    theta = (np.arange(rings) + 0.5) / rings * math.pi / 2
    phi = (np.arange(sectors) + 0.5) / sectors * 2 * math.pi
    theta, phi = (a.ravel() for a in np.meshgrid(theta, phi, indexing="ij"))
    direction = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    return direction, np.sin(theta) * (math.pi / 2 / rings) * (2 * math.pi / sectors)


def albedo(theta_deg, **material):
    i, weight = hemisphere()
    o = np.asarray(from_degrees(theta_deg, 25), np.float64)[:, None]
    return float((reflectance(o, i, **material) * weight).sum())


def random_pairs(count, seed=0):
    rng = np.random.default_rng(seed)
    drawn = (uniform(rng, count).T.astype(np.float64) for _ in range(2))
    return tuple(d / np.linalg.norm(d, axis=0) for d in drawn)


@pytest.mark.parametrize(("roughness", "anisotropy"), [(0.4, 0.7), (0.2, 0.0), (1.0, 0.3)])
def test_it_equals_the_published_formulas_written_out_one_pair_at_a_time(roughness, anisotropy):
    """Walter's D, Heitz's Λ and G₂ = 1 / (1 + Λ(o) + Λ(i)), Schlick's F: the textbook form, which is not the code's."""

    def textbook(o, i, a_t, a_b, f0):
        h = (o + i) / np.linalg.norm(o + i)
        d = 1 / (math.pi * a_t * a_b * ((h[0] / a_t) ** 2 + (h[1] / a_b) ** 2 + h[2] ** 2) ** 2)
        lam = [(-1 + math.sqrt(1 + ((a_t * x[0]) ** 2 + (a_b * x[1]) ** 2) / x[2] ** 2)) / 2 for x in (o, i)]
        fresnel = f0 + (1 - f0) * (1 - h @ o) ** 5
        return fresnel * d / (1 + lam[0] + lam[1]) / (4 * o[2] * i[2]) * i[2]

    o, i = random_pairs(300, 1)
    stretch = math.sqrt(1 - 0.9 * anisotropy)
    sides = roughness**2 / stretch, roughness**2 * stretch
    expected = [textbook(a, b, *sides, 0.8) for a, b in zip(o.T, i.T, strict=True)]
    got = reflectance(o, i, roughness=roughness, metalness=1, anisotropy=anisotropy, base=0.8)
    np.testing.assert_allclose(got, expected, rtol=1e-9)


@pytest.mark.parametrize("theta_deg", [0, 45, 75, 85])
@pytest.mark.parametrize(("roughness", "anisotropy"), [(0.25, 0.0), (0.5, 0.8), (1.0, 0.0)])
@pytest.mark.parametrize("metalness", [0.0, 0.5, 1.0])
def test_a_white_surface_never_reflects_more_than_it_receives(theta_deg, roughness, anisotropy, metalness):
    assert albedo(theta_deg, roughness=roughness, anisotropy=anisotropy, metalness=metalness) <= 1.0


def test_float32_in_gives_float32_out():
    o, i = (d.astype(np.float32) for d in random_pairs(5))
    maps = {n: np.full(5, 0.5, np.float32) for n in ("roughness", "metalness", "specular", "anisotropy")}
    at = brdf.points(tuple(o), maps | {"base": np.full((3, 5), 0.5, np.float32)})
    parts = (*brdf.reflect(at, tuple(i), np.float32(0.3)), brdf.specular_colour(at, np.float32(0.3)), at.diffuse)
    assert {p.dtype for p in parts} == {np.dtype(np.float32)}
