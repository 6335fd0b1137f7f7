import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import torch
from sklearn import decomposition

from baselines.pca import PCA
from bench.btf import BTF, Source
from bench.codec import Fit
from bench.codecs import container
from bench.directions import hemisphere
from bench.training.svd import truncated_svd
from tests.baselines.made import CPU, btf_of, slices, stored, table

FLOAT32 = {"bits": 32}


def made(pairs: int = 25, height: int = 8, width: int = 6, views: int = 5, seed: int = 0) -> BTF:
    """Random radiance of a falling spectrum, positive, with slices of very different brightness."""
    rng = np.random.default_rng(seed)
    rank = min(20, pairs)
    mixed = np.einsum("prc,rhw->phwc", rng.random((pairs, rank, 3)), rng.random((rank, height, width)) ** 3)
    noise = 0.05 * rng.random((pairs, height, width, 3))
    return btf_of((mixed + noise) * rng.uniform(0.01, 2, (pairs, 1, 1, 1)), views)


@pytest.fixture
def streamed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Small data are decomposed by reading them several times, as large data are."""
    monkeypatch.setattr("bench.training.svd.EXACT_SIDE", 0)


@pytest.mark.parametrize("rank", [1, 4, 8])
@pytest.mark.parametrize("side", [0, 1024], ids=["streamed", "exact"])
def test_at_a_rank_it_is_as_good_as_scikit_learn(monkeypatch: pytest.MonkeyPatch, rank: int, side: int) -> None:
    monkeypatch.setattr("bench.training.svd.EXACT_SIDE", side)
    btf = made(100, 20, 20, views=10)
    rows = table(btf).transpose(1, 2, 0, 3).reshape(400, 300).astype(np.float64)
    reference = decomposition.PCA(rank, svd_solver="full").fit(rows)
    best = np.linalg.norm(reference.inverse_transform(reference.transform(rows)) - rows)
    parts = PCA(components=rank, domain="rgb", **FLOAT32).encode(btf, Fit())
    basis, mean = parts.decoder["basis"].flatten(0, 1), parts.decoder["mean"]  # (N, k, 3) and (N, 3)
    got = torch.einsum("hwk,pkc->hwpc", parts.texture["coefficients"], basis) + mean
    error = np.linalg.norm(got.reshape(400, 300).numpy() - rows)
    assert best * (1 - 1e-5) <= error <= best * (1 + 1e-3)


@pytest.mark.parametrize("decay", ["flat", "slow", "fast"])
@pytest.mark.usefixtures("streamed")
def test_the_streamed_decomposition_is_near_the_best(decay: str) -> None:
    generator = torch.Generator().manual_seed(3)
    size, rank = 400, 8
    steps = torch.arange(size, dtype=torch.float64)
    spectrum = {"flat": torch.ones(size), "slow": 1 / (1 + steps), "fast": 0.8**steps}[decay]
    left, right = (torch.linalg.qr(torch.randn(n, size, generator=generator).double()).Q for n in (600, 900))
    matrix = ((left * spectrum) @ right.T).float()
    found = truncated_svd(lambda _: iter(matrix.clone().split(70)), (600, 900), rank, 5, generator, CPU)
    error = (found.basis @ found.coefficients + found.mean[:, None] - matrix).norm()
    centred = matrix.double() - matrix.double().mean(1, keepdim=True)
    best = torch.linalg.svdvals(centred)[rank:].norm()
    assert best * (1 - 1e-5) <= error <= best * (1 + 1e-3)
    assert found.coefficients.amax(1).tolist() == [1.0] * rank


@pytest.mark.parametrize(("bits", "tolerance"), [(32, 1e-5), (16, 2e-3), (8, 2e-2)])
def test_bits_of_the_log_domain(tmp_path: Path, bits: int, tolerance: float) -> None:
    btf = made()
    got = slices(stored(PCA(components=1000, bits=bits), btf, tmp_path), btf)
    assert np.linalg.norm(got - table(btf)) <= tolerance * np.linalg.norm(table(btf))


@pytest.mark.long
def test_the_parts_are_of_the_stated_sizes() -> None:
    btf = made(100, 20, 20, views=10)
    for bits in (32, 16, 8, 4, 0):
        parts = PCA(components=6, bits=bits).encode(btf, Fit())
        for numbers, kept in ((2400, parts.texture["coefficients"]), (2100, parts.decoder["basis"])):  # with the mean
            if bits > 8:
                assert kept.nbytes == numbers * bits // 8
            else:  # a byte says the way, six say the bits of each channel; coding only takes away
                assert kept.nbytes <= numbers * (bits or 8) / 8 + 7


@pytest.mark.long
@pytest.mark.usefixtures("streamed")
def test_the_same_seed_gives_the_same_bytes() -> None:
    btf = made(100, 20, 20, views=10)
    codec = PCA(components=6)

    def encoded(seed: int) -> bytes:
        return container.to_bytes(codec, codec.encode(btf, Fit(seed=seed)))

    assert encoded(1) == encoded(1)
    assert encoded(1) != encoded(2)


class Counted(Source):
    """Slices made one by one from a seed, counting how often each is asked for; nothing else can be read."""

    def __init__(self, count: int, shape: tuple[int, int]):
        self.count, self.shape, self.asked = count, shape, np.zeros(count, int)

    def slice(self, pair: int) -> np.ndarray:
        self.asked[pair] += 1
        return np.random.default_rng(pair).random((*self.shape, 3), np.float32)

    def gather(self, pair: np.ndarray, row: np.ndarray, col: np.ndarray) -> np.ndarray:
        return np.full((len(pair), 3), 0.5, np.float32)


@pytest.mark.long
@pytest.mark.usefixtures("streamed")
def test_the_data_are_read_as_often_as_stated_and_never_held(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bench.training.svd.BLOCK_BYTES", 1 << 20)
    source = Counted(144, (128, 128))
    wo, wi = (hemisphere.ubo2003()[hemisphere.thin(hemisphere.ubo2003(), 12)] for _ in range(2))
    btf = BTF("made", np.repeat(wo, 12, 0), np.tile(wi, (12, 1)), source)
    tracemalloc.start()
    PCA(components=2, passes=3).encode(btf, Fit())
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    # Some slices are read once more, for the bits.
    assert ((source.asked == 3) | (source.asked == 4)).all()
    assert (source.asked == 4).sum() == 32
    # A few blocks and what the exposure sampled; tracemalloc sees NumPy alone.
    assert peak < len(btf) * 128 * 128 * 12 * 0.6


@pytest.mark.usefixtures("streamed")
def test_with_little_memory_the_last_images_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bench.training.svd.SPACE_BYTES", 0)
    left, right = (torch.randn(n, generator=torch.Generator().manual_seed(4)) for n in ((300, 30), (30, 500)))
    matrix = (left * 0.7 ** torch.arange(30.0)) @ right
    found = truncated_svd(lambda _: iter(matrix.clone().split(70)), (300, 500), 5, 4, Fit().generator(), CPU)
    error = (found.basis @ found.coefficients + found.mean[:, None] - matrix).norm()
    best = torch.linalg.svdvals(matrix.double() - matrix.double().mean(1, keepdim=True))[5:].norm()
    assert error <= best * (1 + 1e-3)


def test_the_components_of_a_whole_measurement_are_found_in_a_part_of_it(monkeypatch, tmp_path):
    """Four components and noise; a third of the pairs and half of the texels, which are more than enough for them."""
    rng = np.random.default_rng(0)
    mixed = np.einsum("prc,rhw->phwc", rng.random((49, 4, 3)), rng.random((4, 12, 12)))
    btf = btf_of(mixed + 0.002 * rng.random((49, 12, 12, 3)), 7)
    codec = PCA(components=4, domain="rgb", **FLOAT32)
    whole = slices(stored(codec, btf, tmp_path), btf)
    for name, value in (("LARGE", 0), ("PART_PAIRS", 16), ("PART_TEXELS", 72), ("PAIRS_AT_ONCE", 10), ("SPARE", 3)):
        monkeypatch.setattr(f"baselines.pca.{name}", value)
    part = slices(stored(codec, btf, tmp_path), btf)
    truth = np.stack(list(btf))
    errors = [np.square(found - truth).mean() for found in (whole, part)]
    # Rows fitted by 8 numbers at 72 texels have an error 1 + 8 / 72 as large, coefficients of 48 rows some more.
    assert errors[0] < errors[1] < 1.5 * errors[0]
    flat = btf_of(np.full((49, 12, 12, 3), 0.25), 7)
    np.testing.assert_allclose(slices(stored(codec, flat, tmp_path), flat), 0.25, rtol=1e-5)
