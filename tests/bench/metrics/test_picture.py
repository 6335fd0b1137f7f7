"""Input that no metric can judge is refused, by the name of the argument."""

import numpy as np
import pytest

from bench.errors import InputError
from bench.metrics import default_names, get
from bench.metrics.picture import Picture

GOOD = np.full((16, 16, 3), 0.5, np.float32)
EVERY = [*default_names(False), "flip_hdr_67ppd"]


def spoiled(value):
    picture = GOOD.copy()
    picture[3, 4, 1] = value
    return picture


BAD = {
    "nan": spoiled(np.nan),
    "infinite": spoiled(np.inf),
    "bytes": (GOOD * 255).astype(np.uint8),
    "grey": GOOD[..., 0],
    "four channels": np.ones((16, 16, 4), np.float32),
    "empty": GOOD[:0],
}


@pytest.mark.parametrize("name", EVERY)
@pytest.mark.parametrize("bad", BAD.values(), ids=BAD.keys())
def test_bad_input_names_its_argument(name, bad):
    metric = get(name).load()
    with pytest.raises(InputError, match="reference"):
        metric.prepare(bad, 1.0)
    with pytest.raises(InputError, match="test"):
        metric.score(metric.prepare(GOOD, 1.0), bad)


@pytest.mark.parametrize("name", EVERY)
def test_sizes_that_differ_are_refused(name):
    metric = get(name).load()
    with pytest.raises(InputError, match=r"test is .* reference is"):
        metric.score(metric.prepare(GOOD, 1.0), GOOD[:, :15])


@pytest.mark.parametrize("exposure", [0.0, -1.0, np.nan, np.inf])
def test_the_exposure_must_be_positive(exposure):
    with pytest.raises(InputError, match="exposure"):
        get("psnr_display").load().prepare(GOOD, exposure)


@pytest.mark.parametrize("name", EVERY)
def test_negative_radiance_counts_as_zero(name):
    metric = get(name).load()
    state = metric.prepare(GOOD, 1.0)
    assert metric.score(state, spoiled(-7)) == metric.score(state, spoiled(0))


@pytest.mark.parametrize("name", EVERY)
def test_equal_pictures_are_perfect(name):
    picture = np.random.default_rng(0).random((16, 17, 3), dtype=np.float32) * 2
    metric = get(name).load()
    assert metric.score(metric.prepare(picture, 0.7), picture) == metric.perfect


@pytest.mark.parametrize("name", default_names(True))
def test_a_stack_scores_as_its_slices_do(name):
    rng = np.random.default_rng(1)
    references, tests = rng.random((2, 3, 12, 13, 3), dtype=np.float32)
    metric = get(name).load()
    single = [metric.score(metric.prepare(r, 0.8), t) for r, t in zip(references, tests, strict=True)]
    np.testing.assert_allclose(metric.score(metric.prepare(references, 0.8), tests), single, rtol=1e-12)
    against_one = [metric.score(metric.prepare(references[0], 0.8), t) for t in tests]
    np.testing.assert_allclose(metric.score(metric.prepare(references[0], 0.8), tests), against_one, rtol=1e-12)


def test_a_picture_is_planar_and_keeps_its_values():
    radiance = np.random.default_rng(2).random((5, 4, 3), dtype=np.float32)
    assert (np.moveaxis(Picture(radiance, 1.0, "x").linear, 0, -1) == radiance).all()
