import pytest
import torch

from baselines.relief.latents import codes_of, compress, expand, rounded, steps_for
from bench.errors import InputError


@pytest.mark.parametrize("bits", range(2, 9))
def test_codes_survive_and_take_no_more_than_their_bits(bits: int) -> None:
    codes = torch.randint(2**bits, (32, 24, 5), generator=torch.Generator().manual_seed(0)).float()
    data = compress(codes, bits)
    torch.testing.assert_close(expand(data, (32, 24, 5), bits), codes)
    assert len(data) <= codes.numel() * bits / 8 + 2


def test_what_repeats_takes_less() -> None:
    smooth = (torch.arange(4096).reshape(64, 64, 1) // 256).float()
    assert len(compress(smooth, 4)) < 200


def test_a_damaged_texture_says_so() -> None:
    data = compress(torch.zeros(8, 8, 2), 4)
    with pytest.raises(InputError, match=r"holds|expand"):
        expand(data[:5], (8, 8, 2), 4)
    with pytest.raises(InputError, match="not 512"):
        expand(data, (16, 16, 2), 4)


@pytest.mark.parametrize("bits", [2, 4, 8])
def test_steps_round_no_worse_than_the_whole_range(bits: int) -> None:
    values = torch.randn(4000, 3, generator=torch.Generator().manual_seed(0))
    low, step = steps_for(values, bits)
    whole = values.amin(0), (values.amax(0) - values.amin(0)) / (2**bits - 1)

    def error(low: torch.Tensor, step: torch.Tensor) -> torch.Tensor:
        return (rounded(values, low, step, bits) - values).square().mean(0)

    assert (error(low, step) <= error(*whole) * 1.0001).all()
    if bits == 2:  # the least error of a uniform step at two bits of a normal density is 0.1188: Max 1960
        torch.testing.assert_close(error(low, step), torch.full((3,), 0.1188), rtol=0.1, atol=0)


def test_rounding_lets_the_gradient_pass() -> None:
    values = torch.randn(10, 2, requires_grad=True)
    low, step = steps_for(values, 3)
    out = rounded(values, low, step, 3)
    torch.testing.assert_close(out, low + step * codes_of(values, low, step, 3))
    out.sum().backward()  # type: ignore[no-untyped-call]
    assert values.grad is not None
    torch.testing.assert_close(values.grad, torch.ones_like(values))


def test_a_constant_channel_survives() -> None:
    low, step = steps_for(torch.full((5, 1), 0.7), 4)
    torch.testing.assert_close(rounded(torch.full((5, 1), 0.7), low, step, 4), torch.full((5, 1), 0.7))
