import numpy as np
import pytest
import torch

from bench.inputs.errors import InputError
from bench.training import code_model, predicted_codes, texture_codes
from bench.training.code_model import REACH, SHAPES, TOTAL, cumulative
from bench.training.texture_codes import PREDICTED, compress, expand

BITS = np.array([3, 5, 8, 1])
SIZES = [(9, 7), (4, 3), (1, 1)]
# The codes of `waves`, as the first version of this coding stored them.
GOLDEN = (
    "0349d353000e49a35300143167320100240046e500010531bb2609002d482ac8ecad9e4605eab64f7e916b5a2ef498888d10"
    "073d16bb8bf2fe85ea8c8168a31fe34d633c8c5d79d2046e9035b664c299b51915188a7761f2b61426c82af27874b1cfaefe"
    "e53474ec12e8b90afc24ff08cd0cd49594d4f733239bccf9170a81b06e17871992a55fc768c0a4a6a19e62e62e6dc78bae77"
    "b29899c7ad854febc78a180d"
)


def waves() -> np.ndarray:
    texel = np.arange(sum(height * width for height, width in SIZES))[:, None]
    rough = (texel * texel * 7 + texel * np.arange(4) * 3) % 5
    return ((texel * 3 % 41 + rough) % 2**BITS).astype(np.uint8)


def smooth(rng: np.random.Generator, sizes: list[tuple[int, int]], bits: np.ndarray) -> np.ndarray:
    found = []
    for height, width in sizes:
        y, x = np.mgrid[:height, :width][..., None] / 8
        phase = rng.uniform(0, 6, len(bits))
        wave = np.sin(x + phase) * np.cos(y - phase) + rng.normal(0, 0.1, (height, width, len(bits)))
        found.append(np.clip((wave + 1) / 2 * 2**bits, 0, 2**bits - 1).astype(np.uint8).reshape(-1, len(bits)))
    return np.concatenate(found)


def test_what_was_stored_once_is_still_read() -> None:
    np.testing.assert_array_equal(predicted_codes.decode(bytes.fromhex(GOLDEN), BITS, SIZES), waves())


@pytest.mark.parametrize("seed", range(5))
def test_codes_of_any_size_and_bits_survive(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sizes = [(int(h), int(w)) for h, w in rng.integers(1, 20, (rng.integers(1, 4), 2))]
    bits = rng.integers(1, 9, rng.integers(1, 9))
    count = sum(height * width for height, width in sizes)
    drawn = rng.integers(0, 2**bits, (count, len(bits)))
    for codes in (drawn, 0 * drawn, 0 * drawn + 2**bits - 1, smooth(rng, sizes, bits)):
        codes = codes.astype(np.uint8)
        data = predicted_codes.encode(codes, bits, sizes)
        np.testing.assert_array_equal(predicted_codes.decode(data, bits, sizes), codes)


@pytest.mark.parametrize("size", [(1, 1), (1, 300), (300, 1), (2, 2), (70, 50)])
@pytest.mark.parametrize("channels", [1, 12])
def test_a_texture_that_neighbours_predict_takes_the_fewest_bytes(size: tuple[int, int], channels: int) -> None:
    bits = np.resize([4, 6, 2], channels)
    codes = torch.from_numpy(smooth(np.random.default_rng(0), [size], bits)).float()
    data = compress(codes.reshape(*size, channels), bits.tolist())
    assert (data[0] == PREDICTED) == (max(size) > 2)
    assert expand(data, (*size, channels)).flatten(0, 1).equal(codes)


def test_levels_in_one_table_need_their_sizes() -> None:
    sizes, bits = [(64, 48), (32, 24), (16, 12)], np.array([4, 5])
    codes = torch.from_numpy(smooth(np.random.default_rng(0), sizes, bits)).float()
    data = compress(codes, bits.tolist(), sizes)
    assert data[0] == PREDICTED
    assert len(data) < 0.8 * len(compress(codes, bits.tolist()))
    assert expand(data, codes.shape, sizes).equal(codes)
    for wrong in (None, sizes[:2], [(4032, 0), (1, 4032)], [(1, 4032)]):
        with pytest.raises(InputError, match="encode"):
            expand(data, codes.shape, wrong)


def stored() -> tuple[bytes, np.ndarray]:
    codes = smooth(np.random.default_rng(0), [(16, 16)], np.array([4, 4, 4]))
    return predicted_codes.encode(codes, np.array([4, 4, 4]), [(16, 16)]), codes


@pytest.mark.long
def test_bytes_that_are_cut_too_many_or_altered_are_refused() -> None:
    (data, codes), bits, size = stored(), np.array([4, 4, 4]), [(16, 16)]
    assert data == stored()[0]
    np.testing.assert_array_equal(predicted_codes.decode(data, bits, size), codes)
    for wrong in (*(data[:end] for end in range(0, len(data), 41)), data + b"\0", data + b"\0\0", b"", b"\xff" * 500):
        with pytest.raises(InputError, match="encode"):
            predicted_codes.decode(wrong, bits, size)
    noticed, places = 0, range(0, len(data), 13)
    for place in places:
        altered = bytearray(data)
        altered[place] ^= 1 << place % 8
        try:
            assert predicted_codes.decode(bytes(altered), bits, size).shape == codes.shape
        except InputError:
            noticed += 1
    assert noticed > 0.9 * len(places)


def test_few_bytes_claim_no_more_codes_than_can_be_decoded(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="are predicted"):  # a term before the first channel
        code_model.CodeModel.from_bytes(bytes([0, 0, 0, 0, 1, len(code_model.OWN), 1]), np.array([4]))
    codes = torch.zeros(64, 64, 2)
    predicted = torch.tensor([PREDICTED, 4, 4, *bytes(40)], dtype=torch.uint8)
    with pytest.raises(InputError, match="40 bytes for"):
        expand(predicted, (2048, 2048, 2))
    with pytest.raises(InputError, match="codes lie"):
        expand(predicted, (1, 1 << 15, 2))
    monkeypatch.setattr(texture_codes, "MOST_PREDICTED", 100)
    assert expand(compress(codes, [4, 4]), (64, 64, 2)).equal(codes)
    monkeypatch.setattr(texture_codes, "MOST_CODES", 100)
    data = compress(codes, [1, 2])
    assert data[0] == texture_codes.PACKED  # what is beyond proportion can be read all the same
    assert expand(data, (64, 64, 2)).equal(codes)


def test_the_table_is_of_students_distributions() -> None:
    table = cumulative().reshape(len(SHAPES), 2 * REACH)
    assert (np.diff(table) >= 0).all()
    assert table.min() >= 0
    assert table.max() <= TOTAL
    stats = pytest.importorskip("scipy.stats")
    for freedom, row in zip(SHAPES, table, strict=True):  # rounding down at each step of its series: some 2^-16
        truth = TOTAL * stats.t.cdf(np.arange(-REACH, REACH) / code_model.FINE, freedom)
        np.testing.assert_allclose(row, truth, atol=3)
