import numpy as np
import pytest
import torch
from scipy.special import factorial, lpmv

from baselines.hsh import HSH, LEAST_COSINE, PTM, harmonics
from bench.btf import BTF, ArraySource
from bench.conformance.check import tiny_btf
from bench.directions import hemisphere
from tests.baselines.made import at_tiny_pairs, coded


def oracle_harmonics(w: np.ndarray, bands: int) -> np.ndarray:
    """Gautron et al. 2004, with SciPy's Legendre functions, angles and their sign convention."""
    theta, phi = np.arccos(w[:, 2]), np.arctan2(w[:, 1], w[:, 0])
    found = []
    for band in range(bands):
        for m in range(-band, band + 1):
            a = abs(m)
            norm = np.sqrt((2 * band + 1) * factorial(band - a) / (2 * np.pi * factorial(band + a)))
            if m == 0:
                around = np.ones_like(phi)
            elif m > 0:
                around = np.sqrt(2) * np.cos(m * phi)
            else:
                around = np.sqrt(2) * np.sin(a * phi)
            found.append((-1) ** a * norm * lpmv(a, band, 2 * np.cos(theta) - 1) * around)
    return np.stack(found, 1)


def test_the_harmonics_are_those_of_the_paper() -> None:
    w = hemisphere.uniform(np.random.default_rng(0), 200).astype(np.float64)
    w /= np.linalg.norm(w, axis=1, keepdims=True)  # in double precision: the oracle takes the sine from z
    found = harmonics(torch.from_numpy(w), 6).numpy()
    np.testing.assert_allclose(found, oracle_harmonics(w, 6), atol=1e-6)


@pytest.mark.parametrize("domain", ["log", "rgb"])
@pytest.mark.parametrize("cosine", [True, False])
def test_a_decoded_file_answers_as_plain_least_squares(domain: str, cosine: bool) -> None:
    btf, (lights, views) = tiny_btf(), (3, 2)
    parts, material = coded(HSH(domain=domain, cosine=cosine, smoothness=0, lights=lights, views=views, bits=32), btf)
    gain = float(parts.other["gain"])

    def design(wo: np.ndarray, wi: np.ndarray) -> np.ndarray:
        light, view = oracle_harmonics(wi.astype(float), lights), oracle_harmonics(wo.astype(float), views)
        return np.stack([a * b for a in light.T for b in view.T], 1)

    c = np.maximum(btf.wi[:, 2], LEAST_COSINE) if cosine else np.ones(len(btf))
    y = np.stack(list(btf)).reshape(len(btf), -1) / c[:, None]
    y = np.log1p(gain * y) if domain == "log" else y
    found = np.linalg.lstsq(design(btf.wo, btf.wi) * c[:, None], y * c[:, None], rcond=None)[0]
    wo, wi = hemisphere.from_degrees(33.0, 70.0), hemisphere.from_degrees(41.0, 200.0)
    value = (design(wo[None], wi[None]) @ found).reshape(*btf.shape, 3)
    value = np.expm1(value) / gain if domain == "log" else value
    expected = (value * (wi[2] if cosine else 1)).clip(0)
    # Float32 sums of 625 products and of 36; 1e-4 is ten times what they round.
    np.testing.assert_allclose(material.slice(wo, wi), expected, rtol=1e-4, atol=1e-5)


def test_harmonics_that_are_alike_all_over_a_surface_take_no_bits() -> None:
    btf, rng = tiny_btf(), np.random.default_rng(0)
    # Texels differ by a multiple of the light's cosine, which is that of the constant harmonic, and by nothing else.
    colour, cosine = rng.uniform(0.2, 0.8, (1, *btf.shape, 3)), btf.wi[:, 2].clip(LEAST_COSINE)[:, None, None, None]
    values = at_tiny_pairs((colour + rng.uniform(0, 0.2, (81, 1, 1, 3))) * cosine)
    parts, material = coded(HSH(domain="rgb"), values)
    bits = parts.texture["coefficients"][1:109].unflatten(0, (36, 3))
    assert (bits[0] > 0).all()
    assert not bits[1:].any()
    exact = coded(HSH(domain="rgb", bits=32), values)[1]
    wo, wi = hemisphere.from_degrees(33.0, 70.0), hemisphere.from_degrees(41.0, 200.0)
    # Three bits or more of a range of 0.6 × cos 41°: their rounding is within 0.033.
    np.testing.assert_allclose(material.slice(wo, wi), exact.slice(wo, wi), atol=0.033)


def test_a_polynomial_texture_map_of_one_view_finds_its_polynomial_again() -> None:
    rng = np.random.default_rng(0)
    wi = hemisphere.uniform(rng, 40)
    wo = np.tile(np.array([[0, 0, 1]], np.float32), (40, 1))
    x, y = wi[:, 0], wi[:, 1]
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], 1)
    coefficients = rng.uniform(0, 0.1, (4, 5, 3, 6)) + np.eye(6)[0]
    values = np.einsum("hwck,nk->nhwc", coefficients, terms).astype(np.float32)
    material = coded(PTM(recipe="paper", bits=32), BTF("map", wo, wi, ArraySource(values)))[1]
    light = hemisphere.from_degrees(41.0, 200.0)
    lx, ly = light[:2]
    expected = coefficients @ np.array([1, lx, ly, lx * lx, lx * ly, ly * ly])
    np.testing.assert_allclose(material.slice(wo[0], light), expected, atol=1e-5)
