from dataclasses import replace

import numpy as np
import pytest
import torch

from baselines.tucker import Tucker, rounding_with_zero, tucker_factors
from bench.btf import BTF, ArraySource
from bench.codec import Fit
from bench.conformance.check import tiny_btf
from bench.material import Material
from bench.training import load_texture, store_texture
from tests.baselines.made import decoded, slices, table
from tests.tiers import long


def error(btf: BTF, material: Material) -> float:
    return float(np.sqrt(np.square(slices(material, btf) - table(btf)).mean()))


def product(rank: int, size: int = 6) -> BTF:
    """A table of multilinear rank (rank, rank, rank) over texels, views and lights."""
    like, rng = tiny_btf(), np.random.default_rng(rank)
    views, lights = len(like.layout.views), len(like.layout.lights)
    factors = [rng.uniform(0.1, 1, (n, rank)) for n in (size * size, views, lights)]
    core = rng.uniform(0, 1, (rank, rank, rank, 3))
    table = np.einsum("ti,vj,lk,ijkc->vltc", *factors, core)[like.layout.view, like.layout.light]
    return BTF("product", like.wo, like.wi, ArraySource(table.reshape(-1, size, size, 3).astype(np.float32)))


def test_a_table_of_low_multilinear_rank_is_exact() -> None:
    # Texels are centred, so one component fewer is left to their SVD; float32 through three products.
    btf = product(3)
    settings = {"domain": "rgb", "components": 3, "views": 3, "lights": 3}
    assert error(btf, decoded(Tucker(bits=32, **settings), btf)) < 1e-4
    assert error(btf, decoded(Tucker(**settings), btf)) < 0.02  # in eight bits


def oracle(table: np.ndarray, ranks: tuple[int, int, int], rounds: int) -> np.ndarray:
    """HOOI by NumPy's SVD of each unfolding: the approximation of a tensor (k, V, L, 3); the first slice is kept."""

    def unfold(x: np.ndarray, mode: int) -> np.ndarray:
        return np.moveaxis(x, mode, 0).reshape(x.shape[mode], -1)

    def project(x: np.ndarray, basis: np.ndarray, mode: int) -> np.ndarray:
        return np.moveaxis(np.tensordot(basis @ basis.T, x, (1, mode)), 0, mode)

    def leading(x: np.ndarray, mode: int) -> np.ndarray:
        kept_apart = x[1:] if mode == 0 else x
        return np.linalg.svd(unfold(kept_apart, mode))[0][:, : ranks[mode]]

    bases = [leading(table, mode) for mode in range(3)]

    def texels(x: np.ndarray) -> np.ndarray:
        return np.concatenate([x[:1], project(x[1:], bases[0], 0)])

    for _ in range(rounds):
        for mode in (1, 2, 0):
            x = table if mode == 0 else texels(table)
            for other in {1, 2} - {mode}:
                x = project(x, bases[other], other)
            bases[mode] = leading(x, mode)
    return project(project(texels(table), bases[1], 1), bases[2], 2)


@pytest.mark.parametrize("rounds", [0, 1, 6])
def test_the_factors_are_those_of_an_independent_hooi(rounds: int) -> None:
    table = np.random.default_rng(0).normal(size=(7, 5, 6, 3)) * np.geomspace(1, 0.05, 7)[:, None, None, None]
    texel, view, light, core = tucker_factors(torch.from_numpy(table), (3, 2, 4), rounds)
    assert core.shape == (4, 2, 4, 3)
    ours = torch.einsum("kjmc,vj,lm->kvlc", core, view, light)
    ours = torch.cat([ours[:1], torch.einsum("Kvlc,kK->kvlc", ours[1:], texel)])
    # The same subspaces in double precision, whatever the signs of their bases.
    np.testing.assert_allclose(ours, oracle(table, (3, 2, 4), rounds), atol=1e-8)


def test_pairs_that_are_no_product_are_one_mode() -> None:
    btf = tiny_btf().subset(np.delete(np.arange(81), [3, 40, 77]))
    codec = Tucker(components=64, views=9, lights=9, bits=32)
    parts = codec.encode(btf, Fit())
    assert parts.decoder["light"].shape == (1, 1)
    assert error(btf, codec.decode(parts, torch.device("cpu"))) < 1e-3


@pytest.mark.parametrize("side", ["view", "light"])
def test_a_file_whose_pairs_name_a_direction_without_components_is_refused(side: str) -> None:
    codec = Tucker(components=2)
    parts = codec.encode(tiny_btf(), Fit())
    (name,) = (name for name in parts.decoder if name.startswith(side))
    damaged = replace(parts, decoder={**parts.decoder, name: parts.decoder[name][:-1]})
    with pytest.raises(ValueError, match="view or light"):
        codec.decode(damaged, torch.device("cpu"))
    damaged = replace(parts, decoder={**parts.decoder, name: parts.decoder[name][:, :-1]})
    with pytest.raises(ValueError, match=r"core.*factors"):
        codec.decode(damaged, torch.device("cpu"))


def test_eight_bits_of_a_core_hold_zero() -> None:
    """Most numbers of a core are nearly 0: they must not all be off to one side."""
    rng = np.random.default_rng(0)
    values = torch.from_numpy(rng.normal(0, 1e-4, (40, 3)).astype(np.float32))
    values[:2] = torch.tensor([[1.0, 0.3, 1.0], [-0.31, -1.0, 0.2]])  # the last has small numbers below 0 alone
    step = (values.amax(0) - values.amin(0)) / 254
    stored = load_texture("core", store_texture("core", values, rounding_with_zero(values, 8)))
    assert ((stored - values).abs() <= 0.51 * step).all()
    assert float(stored[2:].abs().max()) < 2e-7  # float32
    same = torch.ones(3, 2)
    torch.testing.assert_close(load_texture("core", store_texture("core", same, rounding_with_zero(same, 8))), same)


@pytest.mark.parametrize("factor", [1e-4, long(0.7), long(3.0)])
def test_the_scale_of_the_data_changes_nothing_in_eight_bits(factor: float) -> None:
    """Rounding must not choose the signs of components, whose range eight bits divide."""
    btf = tiny_btf()
    scaled = BTF("scaled", btf.wo, btf.wi, ArraySource(np.stack(list(btf)) * np.float32(factor)), periodic=True)
    plain, other = error(btf, decoded(Tucker(), btf)), error(scaled, decoded(Tucker(), scaled)) / factor
    assert other == pytest.approx(plain, rel=0.01)
