import numpy as np
import pytest
import torch

from baselines.vq import VQ, pack_index, unpack_index
from bench.btf import BTF, ArraySource
from bench.codec import Fit
from bench.conformance.check import tiny_btf
from bench.material import Material
from tests.baselines.made import decoded, slices, table


def clustered_btf(kinds: int = 5) -> tuple[BTF, np.ndarray]:
    """A BTF whose texels are of a few kinds only, and the kind of each texel."""
    like = tiny_btf()
    kind = np.random.default_rng(0).permutation(np.arange(64) % kinds).reshape(8, 8)
    abrdf = np.random.default_rng(1).uniform(0.1, 1, (len(like), kinds, 3)).astype(np.float32)
    return BTF("kinds", like.wo, like.wi, ArraySource(abrdf[:, kind]), periodic=True), kind


def error(btf: BTF, material: Material) -> float:
    return float(np.abs(slices(material, btf) - table(btf)).max())


def test_kinds_of_texels_are_found_exactly() -> None:
    btf, kind = clustered_btf()
    codec = VQ(codes=5, bits=16)
    parts = codec.encode(btf, Fit())
    label = unpack_index(parts.texture["index0"], 64, 5).numpy()
    assert len({*zip(label, kind.reshape(-1), strict=True)}) == 5
    # The codebook is stored in half floats: 5e-4 of a log value of up to 2, and as much again of the radiance.
    assert error(btf, codec.decode(parts, torch.device("cpu"))) < 2e-3


def test_more_codes_and_more_stages_come_nearer() -> None:
    btf = tiny_btf()
    errors = []
    for settings in ({"codes": 4}, {"codes": 16}, {"codes": 16, "stages": 2}):
        material = decoded(VQ(bits=16, **settings), btf)
        # Clusters are chosen by squares; the largest error may grow.
        errors.append(float(np.square(slices(material, btf) - table(btf)).mean()))
    assert errors[0] > errors[1] > errors[2]


def test_many_codes_below_each_other_are_those_side_by_side(monkeypatch: pytest.MonkeyPatch) -> None:
    btf = tiny_btf()
    beside = decoded(VQ(codes=6), btf)
    monkeypatch.setattr("baselines.vq.MOST_CODES_AS_CHANNELS", 5)
    assert np.array_equal(slices(decoded(VQ(codes=6), btf), btf), slices(beside, btf))


@pytest.mark.parametrize("codes", [1, 2, 3, 32, 33, 1000])
def test_an_index_takes_the_bits_it_needs(codes: int) -> None:
    label = np.random.default_rng(codes).integers(0, codes, 77)
    packed = pack_index(label, codes)
    bits = max(1, (codes - 1).bit_length())  # beside a byte that says the way, and one or two that say the bits
    assert packed.numel() <= -(-77 * bits // 8) + 1 + -(-bits // 8)
    assert torch.equal(unpack_index(packed, 77, codes), torch.from_numpy(label))


def test_an_index_beyond_the_codebook_is_refused() -> None:
    with pytest.raises(ValueError, match="codebook of 6"):
        unpack_index(pack_index(np.array([7]), 8), 1, 6)
