import math

import pytest
import torch

from bench.training.decoder import Architecture, Decoder, smelu
from bench.training.stored_network import load_vector, to_vector

NEUBTF = Architecture(18, (32, 32, 32), activation="sine", norm=True, residual=True)
PUBLISHED = {
    "NeuBTF's renderer": (NEUBTF, 3011),
    "Rainer 2019": (Architecture(12, (106,) * 4), 35725),
    "Rainer 2020": (Architecture(36, (106,) * 4), 38269),
    "NeuMIP, six outputs": (Architecture(11, (25, 25, 25), 6), 1756),
    "NeuMIP, three outputs": (Architecture(11, (25, 25, 25), 3), 1678),
    "NeuMIP's offset": (Architecture(9, (25, 25, 25), 1), 1576),
}


@pytest.mark.parametrize(("architecture", "published"), PUBLISHED.values(), ids=PUBLISHED.keys())
def test_parameters_are_those_that_were_published(architecture: Architecture, published: int) -> None:
    assert architecture.parameters == published
    assert sum(p.numel() for p in Decoder(architecture).parameters()) == published


def test_flops_count_a_multiply_add_twice() -> None:
    assert Architecture(2, (3,), 1).flops == 2 * (2 * 3 + 3 * 1) + 3
    assert Architecture(3, (3,), 1, norm=True, residual=True).flops == 2 * (3 * 3 + 3) + 9 * 3 + 3


def test_the_network_is_the_one_described() -> None:
    """Written out by hand: linear, layer norm, sine of ω times it, and the input where widths agree."""
    architecture = Architecture(4, (5, 5), 2, activation="sine", omega=3.0, norm=True, residual=True)
    network = Decoder(architecture, torch.Generator().manual_seed(1))
    x = torch.randn(7, 4, generator=torch.Generator().manual_seed(2))
    (w1, b1), (w2, b2), (w3, b3) = ((layer.weight, layer.bias) for layer in network.layers)

    def norm(h: torch.Tensor) -> torch.Tensor:
        return (h - h.mean(1, keepdim=True)) / (h.var(1, keepdim=True, correction=0) + 1e-5).sqrt()

    hidden = torch.sin(3 * norm(x @ w1.T + b1))
    hidden = hidden + torch.sin(3 * norm(hidden @ w2.T + b2))
    torch.testing.assert_close(network(x), hidden @ w3.T + b3)


def test_a_sine_network_starts_as_siren_says() -> None:
    network = Decoder(Architecture(8, (64, 64), 3, activation="sine", omega=30.0), torch.Generator().manual_seed(0))
    first, second, _ = (layer.weight.abs().max().item() for layer in network.layers)
    assert 0.9 / 8 < first <= 1 / 8
    assert 0.9 < second / (math.sqrt(6 / 64) / 30) <= 1


def test_a_smooth_rectifier_has_a_parabola_between_its_slopes() -> None:
    """a x² + b x + c with the slopes .01 at −½ and 1 at ½: a = .99 / 2, b = 1.01 / 2, c = .99 / 8."""
    x = torch.linspace(-2, 2, 401, dtype=torch.float64)
    parabola = 0.495 * x**2 + 0.505 * x + 0.12375
    expected = torch.where(x <= -0.5, 0.01 * x, torch.where(x >= 0.5, x, parabola))
    torch.testing.assert_close(smelu(x), expected)


@pytest.mark.parametrize("activation", ["relu", "leaky-relu", "smelu", "silu", "sine"])
@pytest.mark.parametrize("norm", [True, False])
def test_a_half_saturates_instead_of_overflowing(activation: str, norm: bool) -> None:
    architecture = Architecture(6, (6, 6), 3, activation=activation, omega=30.0, norm=norm, residual=True)  # type: ignore[arg-type]
    network = Decoder(architecture, torch.Generator().manual_seed(0)).half()
    with torch.no_grad():
        for p in network.parameters():
            p.copy_(p.sign() * 65504)
    assert network(torch.full((4, 6), 1e3)).isfinite().all()


def test_a_network_starts_at_one_answer_and_can_leave_it() -> None:
    network, again, theirs = (Decoder(NEUBTF, torch.Generator().manual_seed(seed)) for seed in (0, 0, 4))
    assert torch.equal(to_vector(network), to_vector(again))
    load_vector(to_vector(network), theirs)
    assert all(torch.equal(a, b) for a, b in zip(network.parameters(), theirs.parameters(), strict=True))
    with pytest.raises(ValueError, match="3011"):
        load_vector(torch.zeros(3010), theirs)
    network.start_at(torch.tensor([0.1, 0.2, 0.3]))
    x = torch.randn(5, 18, generator=torch.Generator().manual_seed(1))
    assert torch.equal(network(x), torch.tensor([0.1, 0.2, 0.3]).expand(5, 3))
    network(x)[:, 0].sum().backward()
    assert network.layers[-1].get_parameter("weight").grad.any()  # type: ignore[union-attr]
