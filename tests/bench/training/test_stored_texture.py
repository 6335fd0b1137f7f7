import pytest
import torch

from bench.errors import InputError
from bench.training.stored_texture import codes_of, rounded, shared_out, steps_for
from bench.training.texture_codes import MOST_BITS, compress, expand


def all_of(bits: int, channels: int) -> torch.Tensor:
    return torch.full((channels,), bits)


@pytest.mark.parametrize("bits", [[each] * 5 for each in range(1, 9)] + [[1, 8, 3, 5, 2]], ids=str)
def test_codes_survive_and_take_no_more_than_their_bits(bits: list[int]) -> None:
    drawn = torch.rand(32, 24, 5, generator=torch.Generator().manual_seed(0))
    codes = (drawn * 2 ** torch.tensor(bits)).floor()
    data = compress(codes, bits)
    torch.testing.assert_close(expand(data, (32, 24, 5)), codes)
    assert len(data) <= 32 * 24 * sum(bits) / 8 + 1 + len(bits)


@pytest.mark.parametrize("bits", [[4, 4, 4], [2, 4, 8]], ids=str)
def test_what_repeats_takes_less(bits: list[int]) -> None:
    smooth = (torch.arange(4096).reshape(64, 64, 1) // 1024).float().expand(64, 64, 3)
    data = compress(smooth, bits)
    assert len(data) < 200
    torch.testing.assert_close(expand(data, (64, 64, 3)), smooth)


def test_a_damaged_texture_says_so() -> None:
    for codes in (torch.zeros(8, 8, 2), torch.randint(16, (8, 8, 2)).float()):  # as LZMA, and as bits alone
        data = compress(codes, [4, 4])
        with pytest.raises(InputError, match=r"holds|expand"):
            expand(data[:5], (8, 8, 2))
        with pytest.raises(InputError, match="not 512"):
            expand(data, (16, 16, 2))
        for wrong in (data[:0], torch.cat([torch.tensor([3], dtype=torch.uint8), data[1:]])):
            with pytest.raises(InputError, match="does not say how it is stored"):
                expand(wrong, (8, 8, 2))
        for wrong in (0, 9):
            altered = data.clone()
            altered[2] = wrong
            with pytest.raises(InputError, match="does not say its bits"):
                expand(altered, (8, 8, 2))


@pytest.mark.parametrize("bits", [1, 2, 4, 8])
def test_steps_round_no_worse_than_the_whole_range(bits: int) -> None:
    values = torch.randn(4000, 3, generator=torch.Generator().manual_seed(0))
    counts = all_of(bits, 3)
    low, step = steps_for(values, counts)
    whole = values.amin(0), (values.amax(0) - values.amin(0)) / (2**bits - 1)

    def error(low: torch.Tensor, step: torch.Tensor) -> torch.Tensor:
        return (rounded(values, low, step, counts) - values).square().mean(0)

    assert (error(low, step) <= error(*whole) * 1.0001).all()
    if bits == 2:  # the least error of a uniform step at two bits of a normal density is 0.1188: Max 1960
        torch.testing.assert_close(error(low, step), torch.full((3,), 0.1188), rtol=0.1, atol=0)


def test_channels_are_rounded_each_to_its_bits() -> None:
    values = torch.randn(200, 3, generator=torch.Generator().manual_seed(0))
    together = steps_for(values, torch.tensor([2, 5, 8]))
    for channel, bits in enumerate([2, 5, 8]):
        alone = steps_for(values[:, channel : channel + 1], all_of(bits, 1))
        for one, all_three in zip(alone, together, strict=True):
            torch.testing.assert_close(one[0], all_three[channel])


def test_a_channel_that_matters_more_takes_more_bits() -> None:
    fall = 4.0 ** -torch.arange(MOST_BITS)
    noise = torch.tensor([16.0, 1, 4])[:, None] * fall  # each bit makes it a quarter: 16 times are two bits
    alike = torch.ones(3, dtype=torch.long)
    assert shared_out(noise, alike, 12, 0.0).tolist() == [5, 3, 4]
    assert shared_out(noise, alike, 3 * MOST_BITS, 3 * 4.0**-3).tolist() == [6, 4, 5]
    assert shared_out(noise, alike, 100, 0.0).tolist() == [8, 8, 8]
    assert shared_out(noise, alike, 100, 1e9).tolist() == [1, 1, 1]
    # The third has sixteen times as many numbers: two bits of each of them are spent better elsewhere.
    assert shared_out(noise, torch.tensor([1, 1, 16]), 58, 0.0).tolist() == [6, 4, 3]


def test_rounding_lets_the_gradient_pass() -> None:
    values = torch.randn(10, 2, requires_grad=True)
    bits = all_of(3, 2)
    low, step = steps_for(values, bits)
    out = rounded(values, low, step, bits)
    torch.testing.assert_close(out, low + step * codes_of(values, low, step, bits))
    out.sum().backward()  # type: ignore[no-untyped-call]
    assert values.grad is not None
    torch.testing.assert_close(values.grad, torch.ones_like(values))


def test_a_constant_channel_survives() -> None:
    bits = all_of(4, 1)
    low, step = steps_for(torch.full((5, 1), 0.7), bits)
    torch.testing.assert_close(rounded(torch.full((5, 1), 0.7), low, step, bits), torch.full((5, 1), 0.7))
