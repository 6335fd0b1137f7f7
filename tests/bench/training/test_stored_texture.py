from functools import partial

import pytest
import torch

from bench.inputs.errors import InputError
from bench.training.stored_texture import (
    Rounding,
    choose_bits,
    codes_of,
    load_table,
    load_texture,
    round_after,
    rounded,
    shared_out,
    steps_for,
    store_alike,
    store_table,
    store_texture,
)
from bench.training.texture_codes import MOST_BITS, compress, expand


@pytest.mark.parametrize("bits", [[each] * 5 for each in range(1, 9)] + [[1, 8, 3, 5, 2]], ids=str)
def test_codes_survive_and_take_no_more_than_their_bits(bits: list[int]) -> None:
    drawn = torch.rand(32, 24, 5, generator=torch.Generator().manual_seed(0))
    codes = (drawn * 2 ** torch.tensor(bits)).floor()
    data = compress(codes, bits)
    torch.testing.assert_close(expand(data, (32, 24, 5)), codes)
    assert len(data) <= 32 * 24 * sum(bits) / 8 + 1 + len(bits)
    repeated = codes[:1].expand(32, -1, -1)
    assert len(compress(repeated, bits)) < len(data) / 4
    torch.testing.assert_close(expand(compress(repeated, bits), (32, 24, 5)), repeated)


def test_a_channel_without_bits_has_one_code_and_takes_no_bytes() -> None:
    codes = torch.randint(16, (32, 24, 3), generator=torch.Generator().manual_seed(0)).float()
    for bits in ([4, 4, 4, 0, 0], [0, 4, 0, 4, 4], [0, 0]):
        every = torch.zeros(32, 24, len(bits))
        every[..., torch.tensor(bits) > 0] = codes[..., : sum(each > 0 for each in bits)]
        data = compress(every, bits)
        torch.testing.assert_close(expand(data, every.shape), every)
        alone = compress(codes, [4, 4, 4]) if any(bits) else torch.zeros(4)
        assert len(data) == len(alone) + len(bits) - 3


def test_channels_without_bits_open_no_more_than_others() -> None:
    data = compress(torch.zeros(1, 1, 9), [0] * 9)
    assert not expand(data, (1024, 1024, 9)).any()
    with pytest.raises(InputError, match="37748736 codes"):
        expand(data, (2048, 2048, 9))


def test_a_damaged_texture_says_so() -> None:
    for codes in (torch.zeros(8, 8, 2), torch.randint(16, (8, 8, 2)).float()):  # as LZMA, and as bits alone
        data = compress(codes, [4, 4])
        with pytest.raises(InputError, match=r"holds|expand"):
            expand(data[:5], (8, 8, 2))
        with pytest.raises(InputError, match="not 512"):
            expand(data, (16, 16, 2))
        for wrong in (data[:0], torch.cat([torch.tensor([4], dtype=torch.uint8), data[1:]])):
            with pytest.raises(InputError, match="is stored"):
                expand(wrong, (8, 8, 2))
        altered = data.clone()
        altered[2] = 9
        with pytest.raises(InputError, match="its bits"):
            expand(altered, (8, 8, 2))


@pytest.mark.parametrize("bits", [1, 2, 4, 8])
def test_steps_round_no_worse_than_the_whole_range(bits: int) -> None:
    values = torch.randn(4000, 3, generator=torch.Generator().manual_seed(0))
    counts = torch.full((3,), bits)
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
        alone = steps_for(values[:, channel : channel + 1], torch.tensor([bits]))
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


def test_a_channel_that_adds_nothing_may_take_no_bits() -> None:
    fall = 4.0 ** -torch.arange(MOST_BITS + 1)
    noise = torch.tensor([16.0, 0, 1e-3])[:, None] * fall
    alike = torch.ones(3, dtype=torch.long)
    assert shared_out(noise, alike, 100, 0.1, least=0).tolist() == [4, 0, 0]
    assert shared_out(noise, alike, 5, 0.0, least=0).tolist() == [5, 0, 0]
    assert shared_out(noise, alike, 100, 100.0, least=0).tolist() == [0, 0, 0]


@pytest.mark.parametrize("bits", [0, 2])
def test_a_channel_without_bits_is_its_mean(bits: int) -> None:
    values = torch.rand(40, 30, 3, generator=torch.Generator().manual_seed(0)) ** 3
    matters = torch.tensor([1.0, 0.0, 1e-4])

    def answers(texture: torch.Tensor) -> torch.Tensor:
        return texture @ matters[:, None]

    rounding = round_after(values, bits, answers, answers(values) + 0.1, least=0)
    assert (rounding.bits > 0).tolist() == [True, False, False]
    found = load_texture("x", store_texture("x", values, rounding))
    torch.testing.assert_close(found, rounding(values))
    torch.testing.assert_close(found[..., 1:], values.mean((0, 1))[1:].expand(40, 30, 2))
    assert (round_after(values, bits, answers, answers(values) + 0.1).bits > 0).all()  # unless a codec asks for it


def test_a_channel_of_two_values_keeps_the_bit_that_tells_them_apart() -> None:
    """Four bits tell two values exactly: measured with them, the channel seemed to need none."""
    values = torch.ones(8, 8, 2)
    values[:4, :, 0] = 0.25
    rounding = round_after(values, 0, lambda texture: texture, values + 0.01, least=0)
    assert rounding.bits.tolist() == [1, 0]
    torch.testing.assert_close(rounding(values), values)


def test_rounding_lets_the_gradient_pass() -> None:
    values = torch.randn(10, 2, requires_grad=True)
    bits = torch.tensor([3, 3])
    low, step = steps_for(values, bits)
    out = rounded(values, low, step, bits)
    torch.testing.assert_close(out, low + step * codes_of(values, low, step, bits))
    out.sum().backward()  # type: ignore[no-untyped-call]
    assert values.grad is not None
    torch.testing.assert_close(values.grad, torch.ones_like(values))


@pytest.mark.parametrize("bits", [0, 1, 5, 8, 16, 32])
def test_a_stored_texture_comes_back_as_the_fit_saw_it(bits: int) -> None:
    values = torch.randn(6, 5, 3, generator=torch.Generator().manual_seed(0))
    values[..., 2] = 0.7  # one channel is constant
    rounding = round_after(values, bits, lambda texture: texture.sum(-1), torch.zeros(6, 5))
    stored = store_texture("x", values, rounding)
    seen = values.half().float() if bits == 16 else rounding(values)
    torch.testing.assert_close(load_texture("x", stored), seen)
    assert all(tensor.ndim == 1 for tensor in stored.values()) == (bits <= 8)


def test_textures_of_one_fit_share_their_bits_by_what_they_add() -> None:
    generator = torch.Generator().manual_seed(0)
    strong, weak = torch.randn(2, 64, 2, generator=generator)
    first, second = Rounding(2, 4), Rounding(2, 4)
    choose_bits([first, second], lambda: 16 * first(strong) + second(weak), torch.zeros(64, 2))
    assert (first.bits > second.bits).all()
    assert first.bits.sum() + second.bits.sum() == 16
    choose_bits([first, second], lambda: 1 / 0, torch.zeros(64, 2))  # once only
    for bits in (0, 32):  # unfinished, and floats, which are never rounded
        rounding = Rounding(2, bits)
        choose_bits([rounding], lambda: rounding(weak), torch.zeros(64, 2)) if bits else None  # noqa: B023
        assert rounding(weak) is weak


def test_bits_that_are_not_stated_are_those_whose_error_the_fit_can_bear() -> None:
    values = torch.randn(64, 2, generator=torch.Generator().manual_seed(0))
    totals = []
    for error in (0.0, 0.1, 1.0):
        rounding = Rounding(2, 0)
        choose_bits([rounding], partial(rounding, values), values + error)
        totals.append(int(rounding.bits.sum()))
    assert 2 * MOST_BITS == totals[0] > totals[1] > totals[2]


def test_another_texture_takes_the_same_bits_a_channel() -> None:
    values, other = torch.randn(2, 8, 8, 2, generator=torch.Generator().manual_seed(0))
    rounding = Rounding(2, 5)
    rounding.set(values, torch.tensor([2, 7]))
    again = store_alike("x", 100 * other, store_texture("x", values, rounding))
    assert again["x"][1:3].tolist() == [2, 7]
    found = load_texture("x", again)
    assert (found - 100 * other).abs()[..., 1].max() < 5  # in its own range
    assert store_alike("x", other, {"x": other.half()})["x"].dtype == torch.float16


ALTERED = [("x.low", torch.zeros(1000, 1, 1, 2)), ("x.step", torch.zeros(1, 2)), ("x", torch.zeros(0).byte())]
ALTERED += [("x.size", torch.tensor(size)) for size in ([1 << 20, 1 << 20], [-4, -4], [4, 5])]


@pytest.mark.parametrize(("name", "altered"), ALTERED)
def test_an_altered_texture_is_refused(name: str, altered: torch.Tensor) -> None:
    values = torch.randn(4, 4, 2)
    stored = store_texture("x", values, round_after(values, 4, lambda texture: texture, values))
    with pytest.raises(InputError, match="encode"):
        load_texture("x", stored | {name: altered})


@pytest.mark.parametrize("bits", [0, 5, 16, 32])
@pytest.mark.parametrize("axis", [2, 3])
def test_a_table_is_rounded_as_a_texture_is(axis: int, bits: int) -> None:
    """The order in which codes are stored changes none of them."""
    values = torch.randn(4, 5, 3, 2, generator=torch.Generator().manual_seed(0))
    texture = values.movedim(axis, 3)
    rounding = round_after(texture, bits, lambda rounded: rounded, texture)
    as_texture = load_texture("x", store_texture("x", texture, rounding))
    stored = store_table("x", values, rounding, axis)
    assert torch.equal(load_table("x", stored, axis), as_texture.movedim(3, axis))


def test_colours_that_follow_each_other_take_fewer_bytes() -> None:
    grey = torch.rand(20, 20, 8, 1, generator=torch.Generator().manual_seed(0))
    table = grey * torch.tensor([1.0, 0.9, 0.8])
    rounding = round_after(table.transpose(2, 3), 4, lambda rounded: rounded, table.transpose(2, 3))
    apart = store_texture("x", table.transpose(2, 3), rounding)["x"]
    assert store_table("x", table, rounding, axis=2)["x"].nbytes < 0.9 * apart.nbytes


def test_an_altered_table_is_refused() -> None:
    values = torch.randn(4, 4, 2, 3)
    rounding = round_after(values, 4, lambda rounded: rounded, values)
    stored = store_table("x", values, rounding, axis=3)
    for altered in (stored | {"x.size": torch.tensor([4, 4])}, stored | {"x.step": torch.ones(2, 1)}):
        with pytest.raises(InputError, match="encode"):
            load_table("x", altered, axis=3)
    with pytest.raises(InputError, match="four axes"):
        load_table("x", {"x": torch.ones(4, 4, 6)}, axis=3)


def test_a_smooth_texture_is_estimated_at_fewer_bits_as_its_file_takes_them() -> None:
    """And pictures in rows are estimated as the same pictures with their sides are."""
    generator = torch.Generator().manual_seed(0)
    noise = torch.randn(24, 16, 3, generator=generator)
    smooth = noise.cumsum(0).cumsum(1) / 20
    estimated, taken = [], []
    for values in (smooth, noise):
        rounding = Rounding(3, 4)
        rounding.set(values, torch.tensor([4, 4, 0]))
        rounding(values.requires_grad_())
        estimated.append(float(rounding.spent_bits.detach()))
        taken.append(8 * store_texture("latents", values.detach(), rounding)["latents"].numel())
        rounding.spent_bits.backward()
        assert not values.grad[..., 2].any()  # a channel of no bits takes none
        in_rows = Rounding(3, 4, sizes=[(24, 16)])
        in_rows.set(values, torch.tensor([4, 4, 0]))
        in_rows(values.detach().flatten(0, 1).requires_grad_())
        assert float(in_rows.spent_bits.detach()) == pytest.approx(estimated[-1])
    assert estimated[0] < estimated[1]
    assert taken[0] < taken[1]
    assert estimated[1] == pytest.approx(taken[1], rel=0.25)


@pytest.mark.parametrize("size", [(1, 8), (8, 1), (1, 1)])
def test_a_single_row_of_texels_has_no_estimate(size: tuple[int, int]) -> None:
    values = torch.rand(*size, 3, requires_grad=True)
    rounding = Rounding(3, 4)
    rounding.set(values, torch.tensor([4, 4, 4]))
    rounding(values)
    assert rounding.spent_bits is None
