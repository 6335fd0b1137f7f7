"""Weights in a file: what comes back, in how many bytes, and that a fit sees them as the file holds them."""

import pytest
import torch
from torch import nn

from bench.inputs.errors import InputError
from bench.training.decoder import Architecture, Decoder
from bench.training.stored_network import (
    BEARABLE,
    STEPS,
    choose_steps,
    load_network,
    note_steps,
    rounded_weights,
    store_network,
    to_vector,
)

NORMED = Architecture(9, (16, 16), activation="sine", norm=True)


def network(scale: float = 1.0) -> Decoder:
    made = Decoder(NORMED, torch.Generator().manual_seed(0))
    with torch.no_grad():
        for p in made.parameters():
            p.mul_(scale)
    return made


@pytest.mark.parametrize("scale", [1e-6, 1.0, 3e4])
def test_eight_bits_are_within_half_a_step_of_each_matrix(scale: float) -> None:
    ours = network(scale)
    back = load_network(Decoder(NORMED), store_network(ours, "int8"))
    for one, other in zip(ours.parameters(), back.parameters(), strict=True):
        if one.ndim == 2:
            step = one.detach().abs().amax() / 127
            assert ((one - other).abs() <= 0.501 * step).all()
        else:
            torch.testing.assert_close(one, other, rtol=1e-3, atol=1e-3 * scale)


def test_eight_bits_take_about_a_byte_a_weight() -> None:
    ours = network()
    stored = store_network(ours, "int8")
    total = sum(each.numel() * each.element_size() for each in stored.values())
    matrices = sum(p.numel() for p in ours.parameters() if p.ndim == 2)
    others = sum(p.numel() for p in ours.parameters() if p.ndim != 2)
    assert total <= matrices + 2 * others + 32


def test_a_matrix_that_matters_little_gets_a_large_step_and_its_file_is_smaller() -> None:
    ours = network()
    with torch.no_grad():
        ours.layers[2].weight.mul_(1e-3)  # what the layer before gives hardly counts
    inputs = torch.randn(500, 9, generator=torch.Generator().manual_seed(1))
    target = ours(inputs).detach() + 0.1
    note_steps([ours])
    own = [p.detach().clone() for p in ours.parameters()]
    choose_steps([ours], lambda: ours(inputs), target)
    assert all(torch.equal(p, before) for p, before in zip(ours.parameters(), own, strict=True))
    steps = getattr(ours, STEPS)
    torch.testing.assert_close(steps[1], ours.layers[1].weight.abs().max())  # its codes are −1, 0 and 1
    file = store_network(ours, "int8")
    assert file["weights"].numel() < store_network(network(), "int8")["weights"].numel()
    with torch.no_grad():
        with rounded_weights([ours]):
            rounded = ours(inputs)
        torch.testing.assert_close(load_network(Decoder(NORMED), file)(inputs), rounded, rtol=2e-3, atol=2e-3)
        added = float((rounded - ours(inputs)).square().mean())
    assert added < 2 * BEARABLE * 0.1**2


def test_rows_of_zeros_come_back() -> None:
    ours = network()
    with torch.no_grad():
        ours.layers[1].weight[3] = 0
    back = load_network(Decoder(NORMED), store_network(ours, "int8"))
    assert not back.layers[1].weight[3].any()


def test_a_fit_sees_the_weights_of_the_file_and_keeps_its_own() -> None:
    ours = network()
    own = [p.detach().clone() for p in ours.parameters()]
    file = load_network(Decoder(NORMED), store_network(ours, "int8"))
    inputs = torch.randn(50, 9, generator=torch.Generator().manual_seed(1))
    with rounded_weights([ours]):
        torch.testing.assert_close(ours(inputs), file(inputs), rtol=2e-3, atol=2e-3)
        ours(inputs).sum().backward()
    assert all(torch.equal(p, before) for p, before in zip(ours.parameters(), own, strict=True))
    assert all(p.grad is not None for p in ours.parameters())


def test_weights_come_back_if_a_step_fails() -> None:
    ours = network()
    before = ours.layers[0].weight.detach().clone()
    with pytest.raises(RuntimeError, match="a step"), rounded_weights([ours]):
        raise RuntimeError("a step fails")
    assert torch.equal(ours.layers[0].weight, before)


def test_a_file_with_too_few_weights_is_refused() -> None:
    stored = store_network(network(), "int8")
    for name in stored:
        if stored[name].numel() > 1:
            with pytest.raises((ValueError, InputError)):
                load_network(Decoder(NORMED), {**stored, name: stored[name][:-1]})


def test_a_network_without_matrices_is_stored_in_halves() -> None:
    convolution = nn.Conv2d(3, 2, 3)
    note_steps([convolution])
    with rounded_weights([convolution]):
        stored = store_network(convolution, "int8")
    assert torch.equal(to_vector(load_network(nn.Conv2d(3, 2, 3), stored)), to_vector(convolution).half().float())
