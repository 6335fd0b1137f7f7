from pathlib import Path

import numpy as np
import pytest
import torch

from baselines.table import Table
from bench.material import texel_centres
from bench.timing import random_queries
from tests.baselines.made import btf_of, stored


@pytest.mark.parametrize("brightest", [1.0, 6e4, 1e7])
def test_exact_at_its_samples_up_to_half_precision(tmp_path: Path, brightest: float) -> None:
    values = np.random.default_rng(0).random((24, 5, 7, 3)) * brightest
    btf = btf_of(values, 4)
    material = stored(Table(), btf, tmp_path)
    for i, wanted in enumerate(btf):
        got = material.slice(btf.wo[i], btf.wi[i]).numpy()
        # Half precision is 4.9e-4 relative; the interpolator adds neighbours at up to 4e-4.
        np.testing.assert_allclose(got, wanted, rtol=1e-3, atol=2e-4 * brightest)


def test_a_bright_slice_late_in_the_data_rescales_the_earlier_ones(tmp_path: Path) -> None:
    values = np.ones((24, 2, 2, 3))
    values[20] = 1e6
    btf = btf_of(values, 4)
    material = stored(Table(), btf, tmp_path)
    assert float(material.slice(btf.wo[20], btf.wi[20]).mean()) == pytest.approx(1e6, rel=1e-3)
    assert float(material.slice(btf.wo[0], btf.wi[0]).mean()) == pytest.approx(1, rel=2e-2)


def test_bilinear_and_periodic_between_texels(tmp_path: Path) -> None:
    values = np.random.default_rng(0).random((24, 4, 6, 3))
    btf = btf_of(values, 4)
    material = stored(Table(), btf, tmp_path)
    # Half a texel to the right of a centre lies between two columns, the last and the first included.
    uv = texel_centres(4, 6) + torch.tensor([0.5 / 6, 0.0])
    wo, wi = (torch.as_tensor(w[3]).expand(24, 3) for w in (btf.wo, btf.wi))
    wanted = (btf[3] + np.roll(btf[3], -1, 1)) / 2
    np.testing.assert_allclose(material.query(uv, wo, wi).reshape(4, 6, 3), wanted, atol=1e-3)
    np.testing.assert_allclose(material.query(uv + 7, wo, wi), material.query(uv, wo, wi), atol=1e-4)


def test_half_tables_answer_nearly_as_float32_ones(tmp_path: Path) -> None:
    btf = btf_of(np.random.default_rng(0).random((24, 5, 7, 3)) * 6e4, 4)
    material = stored(Table(), btf, tmp_path)
    queries = random_queries(200, torch.device("cpu"))
    whole = material.query(*queries)
    torch.testing.assert_close(material.to(dtype=torch.float16).query(*queries), whole, rtol=1e-4, atol=1.0)
    assert material.cost.parameters == 0
