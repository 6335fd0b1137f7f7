import numpy as np
import pytest
import torch
from scipy.special import factorial, lpmv

from baselines.hsh import HSH, LEAST_COSINE, harmonics
from bench import hemisphere
from bench.btf import BTF, ArraySource
from bench.codec import Fit
from bench.conformance.check import tiny_btf
from bench.training import load_texture
from tests.baselines.made import coded, decoded


def oracle_harmonics(w: np.ndarray, bands: int) -> np.ndarray:
    """Gautron et al. 2004, with SciPy's Legendre functions, angles and their sign convention."""
    theta, phi = np.arccos(w[:, 2]), np.arctan2(w[:, 1], w[:, 0])
    found = []
    for band in range(bands):
        for m in range(-band, band + 1):
            a = abs(m)
            norm = np.sqrt((2 * band + 1) * factorial(band - a) / (2 * np.pi * factorial(band + a)))
            around = 1 if m == 0 else np.sqrt(2) * (np.cos(m * phi) if m > 0 else np.sin(a * phi))
            found.append((-1) ** a * norm * lpmv(a, band, 2 * np.cos(theta) - 1) * around)
    return np.stack(found, 1)


def one_view(pairs: int = 60) -> BTF:
    """Two texels of a rough and a glossy lobe, seen from the zenith under some lights."""
    wi = hemisphere.uniform(np.random.default_rng(2), pairs)
    wo = np.tile(np.float32([0, 0, 1]), (pairs, 1))
    lobes = np.stack([wi[:, 2], wi[:, 2] * (0.2 + wi[:, 2] ** 8)], 1)[:, None, :, None]
    return BTF("rti", wo, wi, ArraySource((lobes * [0.5, 0.3, 0.1]).astype(np.float32)))


def test_the_harmonics_are_those_of_the_paper() -> None:
    w = hemisphere.uniform(np.random.default_rng(0), 200).astype(np.float64)
    w /= np.linalg.norm(w, axis=1, keepdims=True)  # in double precision: the oracle takes the sine from z
    found = harmonics(torch.from_numpy(w), 6).numpy()
    np.testing.assert_allclose(found, oracle_harmonics(w, 6), atol=1e-6)


def test_the_harmonics_are_orthonormal_over_the_hemisphere() -> None:
    # z uniform in (0, 1) and φ uniform is uniform in solid angle; midpoints of both integrate these polynomials well.
    z, phi = (np.arange(400) + 0.5) / 400, (np.arange(32) + 0.5) / 32 * 2 * np.pi
    z, phi = (grid.reshape(-1) for grid in np.meshgrid(z, phi))
    r = np.sqrt(1 - z * z)
    values = harmonics(torch.from_numpy(np.stack([r * np.cos(phi), r * np.sin(phi), z], 1)), 4).numpy()
    np.testing.assert_allclose(values.T @ values * (2 * np.pi / len(z)), np.eye(16), atol=1e-4)


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


def test_coefficients_are_bands_squared_a_colour_of_light_times_view() -> None:
    texture = load_texture("coefficients", HSH(lights=3, views=2).encode(tiny_btf(), Fit()).texture)
    assert texture.shape == (8, 8, 108)


def test_one_view_has_the_nine_coefficients_a_colour_of_rti() -> None:
    material = decoded(HSH(), one_view())
    assert material.cost.texture_channels == 27
    assert material.modules() == []


def test_few_lights_have_few_bands() -> None:
    assert decoded(HSH(lights=4), one_view(5)).cost.texture_channels == 3 * 4


def test_more_bands_come_nearer_to_a_lobe() -> None:
    btf = one_view()

    def error(bands: int) -> float:
        material = decoded(HSH(lights=bands, smoothness=0), btf)
        return max(
            np.abs(material.slice([0, 0, 1], btf.wi[i].tolist()).numpy() - btf[i]).max() for i in range(len(btf))
        )

    assert error(1) > error(2) > error(4)


def test_as_many_harmonics_as_pairs_answer_the_pairs() -> None:
    btf = tiny_btf()
    material = decoded(HSH(lights=3, views=3, smoothness=0, bits=32), btf)
    assert material.cost.texture_channels == 3 * len(btf)
    for i in range(0, len(btf), 9):
        # The ridge of 1e-9, against the least eigenvalue of the normal equations, about 1e-5 of the pairs.
        np.testing.assert_allclose(material.slice(btf.wo[i].tolist(), btf.wi[i].tolist()), btf[i], rtol=0.01, atol=1e-3)
