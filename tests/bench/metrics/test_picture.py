import numpy as np
import pytest

from bench.inputs.errors import InputError
from bench.metrics import DEFAULTS, chosen_names, get

GOOD = np.full((16, 16, 3), 0.5, np.float32)
EVERY = [*chosen_names(DEFAULTS, False), "flip_hdr_67ppd"]


def spoiled(value):
    picture = GOOD.copy()
    picture[3, 4, 1] = value
    return picture


BAD = [spoiled(np.nan), spoiled(np.inf), (GOOD * 255).astype(np.uint8), GOOD[..., 0], GOOD[:, :0], np.ones((9, 9, 4))]


@pytest.mark.parametrize("name", EVERY)
@pytest.mark.parametrize("bad", BAD, ids=range(len(BAD)))
def test_bad_input_names_its_argument(name, bad):
    metric = get(name).load()
    with pytest.raises(InputError, match="reference"):
        metric.prepare(bad, 1.0)
    for test in (bad, GOOD[:, :15]):
        with pytest.raises(InputError, match="test"):
            metric.score(metric.prepare(GOOD, 1.0), test)
    for exposure in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(InputError, match="exposure"):
            metric.prepare(GOOD, exposure)


@pytest.mark.parametrize("name", EVERY)
def test_equal_pictures_are_perfect_and_negative_radiance_counts_as_zero(name):
    picture = np.random.default_rng(0).random((16, 17, 3), dtype=np.float32) * 2
    metric = get(name).load()
    assert metric.score(metric.prepare(picture, 0.7), picture) == metric.perfect
    state = metric.prepare(GOOD, 1.0)
    assert metric.score(state, spoiled(-7)) == metric.score(state, spoiled(0))


@pytest.mark.parametrize("name", chosen_names(DEFAULTS, True))
def test_a_stack_scores_as_its_slices_do(name):
    rng = np.random.default_rng(1)
    references, tests = rng.random((2, 3, 12, 13, 3), dtype=np.float32)
    metric = get(name).load()
    single = [metric.score(metric.prepare(r, 0.8), t) for r, t in zip(references, tests, strict=True)]
    np.testing.assert_allclose(metric.score(metric.prepare(references, 0.8), tests), single, rtol=1e-12)
