"""The table: the data themselves at half precision, and a diffuse surface between the samples."""

from pathlib import Path

import numpy as np
import pytest
import torch

from baselines.table import Table
from bench import hemisphere
from bench.btf import BTF, ArraySource
from bench.codec import Fit
from bench.codecs import container, loading
from bench.material import Material, texel_centres
from bench.timing.queries import Queries


def btf_of(values: np.ndarray) -> BTF:
    """Values (views · 6, H, W, 3) over a product of views and six lights."""
    views = len(values) // 6
    wo, wi = (hemisphere.ubo2003()[hemisphere.thin(hemisphere.ubo2003(), n)] for n in (views, 6))
    return BTF("made", np.repeat(wo, 6, 0), np.tile(wi, (views, 1)), ArraySource(values.astype(np.float32)))


def stored(btf: BTF, folder: Path) -> Material:
    codec = Table()
    container.save(folder / "a.nbtf", codec, codec.encode(btf, Fit()))
    return loading.load(folder / "a.nbtf")[1]


@pytest.mark.parametrize("brightest", [1.0, 6e4, 1e7])
def test_exact_at_its_samples_up_to_half_precision(tmp_path: Path, brightest: float) -> None:
    values = np.random.default_rng(0).random((24, 5, 7, 3)) * brightest
    btf = btf_of(values)
    material = stored(btf, tmp_path)
    for i, wanted in enumerate(btf):
        got = material.slice(btf.wo[i], btf.wi[i]).numpy()
        # Half precision is 4.9e-4 relative; the interpolator adds neighbours at up to 4e-4.
        np.testing.assert_allclose(got, wanted, rtol=1e-3, atol=2e-4 * brightest)


def test_a_bright_slice_late_in_the_data_rescales_the_earlier_ones(tmp_path: Path) -> None:
    values = np.ones((24, 2, 2, 3))
    values[20] = 1e6
    btf = btf_of(values)
    material = stored(btf, tmp_path)
    assert float(material.slice(btf.wo[20], btf.wi[20]).mean()) == pytest.approx(1e6, rel=1e-3)
    assert float(material.slice(btf.wo[0], btf.wi[0]).mean()) == pytest.approx(1, rel=2e-2)


def test_a_diffuse_surface_is_exact_between_the_samples(tmp_path: Path) -> None:
    albedo = np.random.default_rng(0).uniform(0.3, 0.9, (4, 4, 3))
    flat = btf_of(np.zeros((24, 4, 4, 3)))
    material = stored(btf_of(flat.wi[:, None, None, 2:] * albedo / np.pi), tmp_path)
    wo, wi = hemisphere.from_degrees(33.0, 70.0), hemisphere.from_degrees(41.0, 200.0)
    np.testing.assert_allclose(material.slice(wo, wi), wi[2] * albedo / np.pi, rtol=1e-3)


def test_bilinear_and_periodic_between_texels(tmp_path: Path) -> None:
    values = np.random.default_rng(0).random((24, 4, 6, 3))
    btf = btf_of(values)
    material = stored(btf, tmp_path)
    # Half a texel to the right of a centre lies between two columns, the last and the first included.
    uv = texel_centres(4, 6) + torch.tensor([0.5 / 6, 0.0])
    wo, wi = (torch.as_tensor(w[3]).expand(24, 3) for w in (btf.wo, btf.wi))
    wanted = (btf[3] + np.roll(btf[3], -1, 1)) / 2
    np.testing.assert_allclose(material.query(uv, wo, wi).reshape(4, 6, 3), wanted, atol=1e-3)
    np.testing.assert_allclose(material.query(uv + 7, wo, wi), material.query(uv, wo, wi), atol=1e-4)


def test_one_view_and_one_light(tmp_path: Path) -> None:
    up = np.array([[0, 0, 1]], np.float32)
    btf = BTF("one", up, up, ArraySource(np.full((1, 3, 3, 3), 0.25, np.float32)))
    codec = Table()
    material = codec.decode(codec.encode(btf, Fit()), torch.device("cpu"))
    assert material.slice(up[0], up[0]).unique().tolist() == [0.25]


def test_the_cost_counts_the_whole_table(tmp_path: Path) -> None:
    material = stored(btf_of(np.ones((24, 5, 7, 3))), tmp_path)
    assert material.cost.texture_floats == 24 * 5 * 7 * 3
    # Four texels at 3 × 3 pairs, three floats each: stored as halves, and held as what a fetch adds up.
    assert material.cost.bytes_per_sample == 4 * 9 * 3 * 4


def test_half_tables_answer_nearly_as_float32_ones(tmp_path: Path) -> None:
    btf = btf_of(np.random.default_rng(0).random((24, 5, 7, 3)) * 6e4)
    material = stored(btf, tmp_path)
    queries = Queries(200).draw((5, 7), torch.device("cpu"))
    whole = material.query(*queries)
    torch.testing.assert_close(material.to(dtype=torch.float16).query(*queries), whole, rtol=1e-4, atol=1.0)
    assert material.cost.parameters == 0
