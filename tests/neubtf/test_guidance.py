from pathlib import Path

import numpy as np
import png
import pytest
import torch

from bench.data.materials.maps import seams
from bench.metrics.display import LUMA, decode_srgb, encode_srgb
from neubtf.autoencoder import as_guidance
from neubtf.guidance import Treatment, blended, guidance_of, read_guidance

RNG = np.random.default_rng(0)
OWN = torch.from_numpy(RNG.integers(20, 200, (16, 16, 3), np.uint8))
PICTURE = RNG.uniform(0.1, 0.4, (24, 20, 3)).astype(np.float32)


def image_of(picture: np.ndarray, **treatment: object) -> np.ndarray:
    image, _ = guidance_of(picture, Treatment(**treatment), OWN, 2.0)  # type: ignore[arg-type]
    return image[0].movedim(0, -1).double().numpy()


def test_a_file_s_own_guidance_comes_back() -> None:
    linear = decode_srgb(OWN.numpy() / 255).astype(np.float32)
    image, factor = guidance_of(linear, Treatment(), OWN, 2.0)
    assert factor == pytest.approx(1, abs=1e-6)
    torch.testing.assert_close(image, as_guidance(OWN), rtol=0, atol=1e-6)


def test_a_picture_is_converted_from_the_colour_space_that_it_states(tmp_path: Path) -> None:
    codes = RNG.integers(0, 256, (8, 8, 3), np.uint8)
    for name, gamma in (("linear", 1.0), ("srgb", 0.45455)):
        with open(tmp_path / f"{name}.png", "wb") as stream:
            png.Writer(8, 8, greyscale=False, gamma=gamma).write(stream, codes.reshape(8, -1).tolist())
    image, provenance = read_guidance(tmp_path / "linear.png", Treatment(exposure="1"), OWN, 2.0)
    np.testing.assert_allclose(image[0].movedim(0, -1).numpy(), encode_srgb(codes / 255), atol=1e-5)
    assert provenance["guidance_colour"].endswith("gAMA 1")
    image, provenance = read_guidance(tmp_path / "srgb.png", Treatment(exposure="1"), OWN, 2.0)
    np.testing.assert_allclose(image[0].movedim(0, -1).numpy(), codes / 255, atol=1e-5)
    assert "guidance_colour" not in provenance


def test_brightness_is_matched_on_average() -> None:
    for stops in (-3, 0, 1):
        image = image_of(PICTURE * 2.0**stops)
        expected = decode_srgb(OWN.numpy() / 255).mean((0, 1)) @ LUMA
        assert decode_srgb(image).mean((0, 1)) @ LUMA == pytest.approx(expected, rel=1e-4)


def test_exposure_by_radiance_and_by_a_factor() -> None:
    np.testing.assert_allclose(image_of(PICTURE, exposure="radiance"), encode_srgb(2 * PICTURE), atol=1e-6)
    np.testing.assert_allclose(image_of(PICTURE, exposure="1.5"), encode_srgb(1.5 * PICTURE), atol=1e-6)
    np.testing.assert_array_equal(image_of(PICTURE, exposure="99"), 1)


def test_shrinking_averages_linear_light() -> None:
    checks = np.indices((8, 8)).sum(0)[..., None] % 2 * np.ones(3)
    image = image_of(checks.astype(np.float32), scale=0.5, exposure="1")
    np.testing.assert_allclose(image, encode_srgb(np.full((4, 4, 3), 0.5)), atol=1e-6)


@pytest.mark.parametrize(("scale", "size"), [(0.5, (12, 10)), (0.3, (7, 6)), (0.001, (1, 1)), (2, (48, 40))])
def test_sizes_after_scaling(scale: float, size: tuple[int, int]) -> None:
    assert image_of(PICTURE, scale=scale).shape == (*size, 3)


def test_blending_removes_the_seam_of_a_ramp() -> None:
    ramp = np.linspace(0.1, 0.9, 48, dtype=np.float32)[:, None, None] * np.ones((1, 36, 3), np.float32)
    ramp = ramp + np.linspace(0, 0.4, 36, dtype=np.float32)[None, :, None]
    across, _, largest = np.transpose(seams(image_of(ramp, exposure="1", margin=0.25)))
    assert (across <= largest).all()
    across, _, largest = np.transpose(seams(image_of(ramp, exposure="1")))
    assert (across > 10 * largest).all()
    assert image_of(ramp, margin=0.25).shape == (36, 24, 3)


def test_blending_gives_no_negative_light() -> None:
    spots = (RNG.uniform(0, 1, (40, 40, 1)) > 0.9) * np.ones(3, np.float32)
    image = image_of(spots, margin=0.5)
    assert image.min() == 0


@pytest.mark.parametrize(("side", "left"), [(140, 116), (96, 80), (10, 8), (3, 3), (2, 2)])
def test_what_is_blended_fits_the_autoencoder_s_cells(side: int, left: int) -> None:
    """A sixth of the side is lost, and up to three texels more; pictures of a few texels keep what they have."""
    assert blended(np.ones((side, side, 3), np.float32), 1 / 6).shape == (left, left, 3)


def test_half_of_an_odd_side_is_blended() -> None:
    assert blended(np.ones((7, 1023, 3), np.float32), 0.5).shape == (4, 512, 3)
