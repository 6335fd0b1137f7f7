"""Packed tensors come back within the rounding of their precision, whatever their size."""

import pytest
import torch

from bench.training.quantise import half_scale, pack, unpack

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


def test_nothing_is_lost_by_a_power_of_two() -> None:
    subnormal = torch.arange(1024.0) * 2**-24
    packed = pack("x", subnormal, "half")
    assert packed["x.scale"].log2().frac().item() == 0
    assert torch.equal(unpack("x", packed), subnormal)


@pytest.mark.parametrize("peak", [5e-324, 1e-40, 2**-4.1, 65505.0, 3e38])
def test_scaled_halves_stay_in_range(peak: float) -> None:
    assert 2.0**-126 <= half_scale(peak) <= 2.0**127
    assert peak / half_scale(peak) <= 32768


def test_black_and_empty_tensors_need_no_scale() -> None:
    assert list(pack("x", torch.zeros(2, 3), "half")) == ["x"]
    assert pack("x", torch.zeros(0, 3), "half")["x"].shape == (0, 3)


@pytest.mark.parametrize("factor", [1e-6, 1.0, 1e4])
def test_eight_bits_are_within_half_a_step_of_each_channel(factor: float) -> None:
    packed = pack("x", VALUES * factor, "int8")
    assert packed["x"].dtype == torch.uint8
    error = (unpack("x", packed) - VALUES * factor).abs().amax((0, 1))
    assert (error <= 0.5001 * packed["x.scale"] + 1e-6 * factor).all()


def test_a_constant_channel_is_exact() -> None:
    assert torch.equal(unpack("x", pack("x", torch.full((4, 2), 0.3), "int8")), torch.full((4, 2), 0.3))
