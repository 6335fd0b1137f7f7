import numpy as np
import pytest

from bench.metrics.display import decode_srgb, encode_srgb, exposed, exposure_of, to_display, to_log1p


def test_exposure_puts_the_bright_texels_of_bright_slices_at_0_8():
    picture = np.linspace(0, 5, 1001)
    assert np.percentile(picture, 99) * exposure_of(picture[None]) == pytest.approx(0.8)
    slices = picture * np.linspace(0, 1, 11)[:, None]  # the tenth of eleven is the 90th percentile
    assert np.percentile(slices[9], 99) * exposure_of(slices) == pytest.approx(0.8)
    values = np.zeros((2, 1000))
    assert exposure_of(values) == 1  # where all is black
    values[0, 0] = 4
    assert exposure_of(values) == pytest.approx(0.2)  # by the maximum where the percentile is 0
    assert exposure_of(-values) == 1


def test_a_few_mirror_pairs_do_not_own_the_exposure():
    """As on polished stone: a twentieth of the slices is a thousand times as bright as the others."""
    slices = np.full((100, 8, 8, 3), 0.2)
    slices[:5] = 200.0
    assert exposure_of(slices) == pytest.approx(4.0)
    assert exposed(slices, exposure_of(slices)).fault == ""
    by_mirror = exposed(slices, 0.8 / 200)
    assert by_mirror.black == pytest.approx(0.95 * 39.7 + 0.05 * 0.97, abs=0.1)
    assert by_mirror.fault.startswith("black scores 38 dB")
    dim = exposed([np.full((8, 8, 3), 0.02)] * 3, 1.0).fault
    assert "39 of 255" in dim


def test_srgb_has_the_standard_values_and_inverts():
    # IEC 61966-2-1: mid grey 0.5 encodes 0.21404114; the linear segment is 12.92 steep.
    np.testing.assert_allclose(decode_srgb([0, 0.02, 0.5, 1]), [0, 0.02 / 12.92, 0.21404114048, 1], atol=1e-11)
    linear = np.linspace(0, 1, 1000)
    # The standard's rounded constants leave a step of 3e-8 where its two pieces meet.
    np.testing.assert_allclose(decode_srgb(encode_srgb(linear)), linear, atol=3e-8)


def test_display_clips_and_log_does_not():
    assert to_display(np.array([-1.0, 0, 1, 50]), 1.0) == pytest.approx([0, 0, 1, 1])
    assert to_log1p(np.array([-1.0, 0, 2]), 0.5) == pytest.approx([0, 0, np.log(9)])
