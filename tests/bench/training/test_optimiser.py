import pytest
import torch
from torch import Tensor

from bench.training.decoder import Architecture, Decoder
from bench.training.optimiser import MOMENTUM, Muon, Optimisers, groups_of, hidden_matrices, orthogonal


@pytest.mark.parametrize("shape", [(32, 32), (16, 48), (48, 16)])
def test_an_update_keeps_directions_and_evens_their_sizes(shape: tuple[int, int]) -> None:
    matrix = torch.randn(shape, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    left, values, right = torch.linalg.svd(matrix, full_matrices=False)
    around = left.T @ orthogonal(matrix) @ right.T
    even = around.diagonal()[values > 0.05 * values.max()]
    # The published coefficients do not converge to 1: they stay in this band, whatever the singular value was.
    assert even.min() > 0.6
    assert even.max() < 1.3
    assert (around - around.diagonal().diag()).abs().max() < 1e-9
    assert not orthogonal(torch.zeros(shape)).any()


def test_a_step_is_nesterovs_momentum_made_orthogonal() -> None:
    generator = torch.Generator().manual_seed(0)
    weight = torch.nn.Parameter(torch.randn(12, 3, generator=generator))
    first, gradients = weight.detach().clone(), [torch.randn(12, 3, generator=generator) for _ in range(2)]
    muon = Muon([{"params": [weight], "lr": 0.1}])
    momentum, expected = torch.zeros(12, 3), first
    for gradient in gradients:
        weight.grad = gradient.clone()
        muon.step()
        momentum = MOMENTUM * momentum + (1 - MOMENTUM) * gradient
        ahead = MOMENTUM * momentum + (1 - MOMENTUM) * gradient
        expected = expected - 0.1 * 2 * orthogonal(ahead)  # 12 rows over 3 columns: the root of 4
    torch.testing.assert_close(weight.detach(), expected)


def decoder() -> Decoder:
    return Decoder(Architecture(5, (8, 8, 8)), torch.Generator().manual_seed(1))


def test_only_matrices_between_hidden_layers_are_hidden() -> None:
    network = torch.nn.ModuleList([decoder(), torch.nn.Linear(8, 8)])
    first = network[0]
    assert isinstance(first, Decoder)
    assert [id(p) for p in hidden_matrices(network)] == [id(first.layers[i].weight) for i in (1, 2)]
    adam, muon = groups_of([network], 0.01, "muon", 0.02)
    assert (adam["lr"], muon["lr"], muon["hidden"]) == (0.01, 0.02, True)
    assert len(adam["params"]) + len(muon["params"]) == len(list(network.parameters()))
    (everything,) = groups_of([network], 0.01, "adam", 0.02)
    assert len(everything["params"]) == len(list(network.parameters()))


def test_each_group_is_stepped_at_its_own_rate_in_the_order_it_was_given() -> None:
    a, b, c = (torch.nn.Parameter(torch.eye(3)) for _ in range(3))
    groups = [{"params": [a], "lr": 1.0, "hidden": True}, {"params": [b], "lr": 2.0}, {"params": [c], "lr": 3.0}]
    optimisers = Optimisers(groups, torch.device("cpu"))
    assert optimisers.highest == [1.0, 2.0, 3.0]
    assert [id(p) for p in optimisers.parameters] == [id(a), id(b), id(c)]
    for p in (a, b, c):
        p.grad = torch.eye(3)
    optimisers.set_rates([0.0, 0.5, 0.0])
    optimisers.step()
    moved = [not torch.equal(p.detach(), torch.eye(3)) for p in (a, b, c)]
    assert moved == [False, True, False]
    assert [p.grad for p in (a, b, c)] == [None] * 3


def test_their_state_is_all_that_is_needed_to_go_on() -> None:
    def start() -> tuple[Decoder, Optimisers]:
        network = decoder()
        return network, Optimisers(groups_of([network], 0.01, "muon", 0.02), torch.device("cpu"))

    def step(network: Decoder, optimisers: Optimisers, seed: int) -> None:
        x = torch.randn(64, 5, generator=torch.Generator().manual_seed(seed))
        network(x).square().mean().backward()
        optimisers.set_rates(optimisers.highest)
        optimisers.step()

    def everything(network: Decoder, optimisers: Optimisers) -> dict[str, Tensor]:
        return {**network.state_dict(), **optimisers.tensors()}

    one, other = start(), start()
    for seed in range(6):
        step(*one, seed)
        if seed == 2:
            with torch.no_grad():
                for name, value in everything(*other).items():
                    value.copy_(everything(*one)[name])
        if seed > 2:
            step(*other, seed)
    assert all(torch.equal(value, everything(*other)[name]) for name, value in everything(*one).items())
