from pathlib import Path

import numpy as np
import pytest

from baselines.clusters import unpack_index
from baselines.local_pca import LocalPCA, local_components
from baselines.pca import PCA
from bench.btf import BTF
from bench.codec import Fit
from tests.baselines.made import btf_of, slices, stored


def two_kinds(side: int = 12) -> BTF:
    """Texels of two kinds, each a mean and two components of its own in logarithms: no three suffice for all."""
    rng = np.random.default_rng(0)
    kind, share = rng.integers(0, 2, (side, side)), rng.standard_normal((side, side, 2))
    means, axes = rng.uniform(1.5, 2, (2, 25, 3)), 0.1 * rng.standard_normal((2, 25, 3, 2))
    log = means[kind] + np.einsum("hwpck,hwk->hwpc", axes[kind], share)
    return btf_of(np.expm1(log.clip(0)).transpose(2, 0, 1, 3), 5)


def test_clusters_with_components_of_their_own_are_found(tmp_path: Path) -> None:
    btf = two_kinds()
    truth = np.stack(list(btf))
    local = slices(stored(LocalPCA(clusters=2, components=2, bits=32), btf, tmp_path), btf)
    globally = slices(stored(PCA(components=2, bits=32), btf, tmp_path), btf)
    assert np.linalg.norm(local - truth) < 0.02 * np.linalg.norm(globally - truth)


def test_a_texel_is_decoded_by_its_own_cluster(tmp_path: Path) -> None:
    """The stored numbers, put together by NumPy at a pair that was fitted and a texel's centre."""
    btf = two_kinds()
    codec = LocalPCA(clusters=3, components=2, bits=32)
    parts = codec.encode(btf, Fit())
    material = stored(codec, btf, tmp_path)
    label = unpack_index(parts.texture["clusters"], 144, int(parts.other["count"])).reshape(12, 12)
    table = parts.decoder["components"].numpy().reshape(25, -1, 3, 3)[7].transpose(2, 0, 1)
    known = np.concatenate([np.ones((12, 12, 1)), parts.texture["coefficients"].numpy()], 2)
    level = np.einsum("chwk,hwk->hwc", table[:, label.numpy()], known)
    radiance = np.expm1(level.clip(0)) / float(parts.other["gain"])
    np.testing.assert_allclose(material.slice(btf.wo[7], btf.wi[7]).numpy(), radiance, rtol=1e-4, atol=1e-6)


def test_components_are_orthogonal_and_each_point_is_in_its_nearest_cluster() -> None:
    points = np.random.default_rng(1).standard_normal((300, 6)).astype(np.float32)
    found = local_components(points, 4, 2, 0)
    unit = found.axes / np.linalg.norm(found.axes, axis=1, keepdims=True)
    np.testing.assert_allclose(np.einsum("nkc,nkd->ncd", unit, unit), np.broadcast_to(np.eye(2), (4, 2, 2)), atol=1e-5)
    errors = [
        np.square(points - mean - (points - mean) @ axis @ axis.T).sum(1)
        for mean, axis in zip(found.means, unit, strict=True)
    ]
    assert (np.argmin(errors, 0) == found.label).mean() > 0.95  # the last round may have stopped early
    assert np.abs(found.coefficients).max() == pytest.approx(1)
