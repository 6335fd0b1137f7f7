import pytest
import torch

from bench.training.quantise import half_scale, pack, pack_bits, unpack, unpack_bits

VALUES = torch.rand(5, 7, 3, generator=torch.Generator().manual_seed(0)) * 2 - 1


@pytest.mark.parametrize("factor", [1e-30, 1e-8, 1.0, 1e5, 1e30])
def test_halves_hold_numbers_of_any_size(factor: float) -> None:
    unpacked = unpack("x", pack("x", VALUES * factor, "half"))
    # 11 bits of each number, and nothing finer than 2⁻²⁴ of the largest.
    torch.testing.assert_close(unpacked, VALUES * factor, rtol=2**-11, atol=2**-24 * factor)


def test_numbers_that_halves_can_tell_apart_are_stored_as_they_are() -> None:
    for factor in (1.0, 65504.0, 0.25):
        packed = pack("x", VALUES * factor, "half")
        assert list(packed) == ["x"]
        assert torch.equal(packed["x"], (VALUES * factor).half())
    subnormal = torch.arange(1024.0) * 2**-24
    packed = pack("x", subnormal, "half")
    assert packed["x.scale"].log2().frac().item() == 0
    assert torch.equal(unpack("x", packed), subnormal)
    assert list(pack("x", torch.zeros(2, 3), "half")) == ["x"]
    assert pack("x", torch.zeros(0, 3), "half")["x"].shape == (0, 3)


@pytest.mark.parametrize("bits", [1, 3, 8])
def test_packed_bits_come_back(bits: int) -> None:
    codes = torch.arange(11) * 37 % 2**bits
    assert len(packed := pack_bits(codes, bits)) == -(-11 * bits // 8)
    assert torch.equal(unpack_bits(packed, 11, bits), codes)


@pytest.mark.parametrize("peak", [5e-324, 1e-40, 2**-4.1, 65505.0, 3e38])
def test_scaled_halves_stay_in_range(peak: float) -> None:
    assert 2.0**-126 <= half_scale(peak) <= 2.0**127
    assert peak / half_scale(peak) <= 32768
