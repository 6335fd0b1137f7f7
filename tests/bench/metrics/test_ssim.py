import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.metrics import structural_similarity

from bench.inputs.errors import InputError
from bench.metrics.display import LUMA, to_display
from bench.metrics.ssim import RADIUS, SSIM


def pair(seed, height, width):
    rng = np.random.default_rng(seed)
    reference = rng.random((height, width, 3)) ** 2
    return reference, np.maximum(reference + rng.uniform(0.01, 0.3) * rng.standard_normal(reference.shape), 0)


def oracle(reference, test, exposure):
    x, y = to_display(reference, exposure) @ LUMA, to_display(test, exposure) @ LUMA
    return structural_similarity(
        x, y, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=1, full=True
    )


@settings(derandomize=True, max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(11, 40), st.integers(11, 40), st.floats(0.3, 3))
def test_ssim_is_that_of_scikit_image(seed, height, width, exposure):
    reference, test = pair(seed, height, width)
    metric = SSIM()
    state = metric.prepare(reference, exposure)
    mean, full = oracle(reference, test, exposure)
    # Both work in float64; what is left is the order of sums.
    assert metric.score(state, test) == pytest.approx(mean, abs=1e-12)
    inside = full[RADIUS:-RADIUS, RADIUS:-RADIUS]
    np.testing.assert_allclose(metric.error_map(state, test), inside, atol=1e-12)


@pytest.mark.parametrize(("height", "width"), [(40, 33), (11, 12), (4, 7), (3, 1)])
def test_the_periodic_variant_is_ssim_of_the_wrap_padded_picture(height, width):
    reference, test = pair(0, height, width)
    pad = ((RADIUS, RADIUS), (RADIUS, RADIUS), (0, 0))
    periodic, plain = SSIM(periodic=True), SSIM()
    state = plain.prepare(np.pad(reference, pad, "wrap"), 1.0)
    padded = plain.error_map(state, np.pad(test, pad, "wrap"))
    np.testing.assert_allclose(periodic.error_map(periodic.prepare(reference, 1.0), test), padded, atol=1e-12)


def test_a_picture_smaller_than_the_window_is_refused():
    small = np.ones((10, 40, 3))
    with pytest.raises(InputError, match=r"10 × 40.*11 × 11"):
        SSIM().prepare(small, 1.0)
    assert SSIM(periodic=True).score(SSIM(periodic=True).prepare(small, 1.0), small) == 1
