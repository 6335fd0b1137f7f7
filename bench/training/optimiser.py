"""The optimisers of a fit: Muon for the matrices between hidden layers, Adam for all other parameters.

Muon (Jordan et al., "Muon: an optimizer for hidden layers in neural networks", 2024) moves a matrix by its gradient's
momentum with all singular values brought near 1, so directions with a small gradient are learned too. It is meant for
matrices from hidden channels to hidden channels; Adam steps inputs, outputs, biases, norms and latents.
`torch.optim.Muon` does the same in bfloat16, which many processors emulate: 2.1 ms for 32² instead of 0.06 ms here.
"""

import math
from collections.abc import Iterable
from typing import Any, Literal

import torch
from torch import Tensor, nn

from bench.machine.devices import records_graphs

ParameterGroup = dict[str, Any]  # of an optimiser of PyTorch: `params`, `lr` and more

Optimiser = Literal["muon", "adam"]

QUINTIC = (3.4445, -4.7750, 2.0315)  # coefficients of the published iteration
ITERATIONS = 5  # how often it is applied
MOMENTUM = 0.95
WARMUP = 100  # steps, or a tenth of a short fit
TINY = 1e-7  # a matrix of zeros is divided by it instead of by its norm


def rate(step: int, steps: int) -> float:
    """The share of the highest learning rate at a step: a linear warm-up times a cosine that falls from 1 to 0."""
    warm = min(1.0, (step + 1) / (min(WARMUP, steps // 10) + 1))
    return warm * (1 + math.cos(math.pi * step / steps)) / 2


def orthogonal(matrix: Tensor) -> Tensor:
    """About U Vᵀ of a matrix U S Vᵀ: all but its smallest singular values become 0.6 to 1.3."""
    tall = matrix.shape[0] > matrix.shape[1]  # then turned, so that the Gram matrix is the smaller one
    x = matrix.T if tall else matrix
    x = x / x.norm().clamp_min(TINY)
    a, b, c = QUINTIC
    for _ in range(ITERATIONS):  # each maps every singular value s to a s + b s³ + c s⁵
        gram = x @ x.T
        x = torch.addmm(x, torch.addmm(gram, gram, gram, beta=b, alpha=c), x, beta=a)  # a x + (b G + c G²) x
    return x.T if tall else x


class Muon(torch.optim.Optimizer):
    """Steps matrices by their orthogonalised Nesterov momentum, times the root of rows over columns where above 1."""

    def __init__(self, groups: Iterable[ParameterGroup]):
        super().__init__(groups, {})  # each group has its own rate
        for matrix in _parameters(self.param_groups):
            self.state[matrix] = {"momentum": torch.zeros_like(matrix)}

    @torch.no_grad()
    def step(self) -> None:  # type: ignore[override]  # no closure, because a fit computes its loss once a step
        """Move each matrix by its orthogonalised momentum, at its group's rate `lr`; one without a gradient stays."""
        for group in self.param_groups:
            for matrix in group["params"]:
                if matrix.grad is None:
                    continue
                momentum = self.state[matrix]["momentum"].lerp_(matrix.grad, 1 - MOMENTUM)  # running mean of gradients
                # Nesterov's momentum: the mean as it would be if the next gradient were this one again.
                update = orthogonal(matrix.grad.lerp(momentum, MOMENTUM))
                rows, columns = matrix.shape
                distance = group["lr"] * max(1.0, rows / columns) ** 0.5
                if isinstance(distance, Tensor):  # the rate of a recorded step, see `Optimisers`
                    matrix.sub_(update * distance)
                else:
                    matrix.sub_(update, alpha=distance)


def groups_of(
    networks: Iterable[nn.Module], rate: float, optimiser: Optimiser, hidden_rate: float
) -> list[ParameterGroup]:
    """Parameter groups of some networks: all at `rate`; with Muon, hidden matrices at `hidden_rate`."""
    together = nn.ModuleList(networks)
    hidden = hidden_matrices(together) if optimiser == "muon" else []
    of_muon = {id(matrix) for matrix in hidden}
    others = [parameter for parameter in together.parameters() if id(parameter) not in of_muon]
    groups: list[ParameterGroup] = [{"params": others, "lr": rate}]
    if hidden:
        groups.append({"params": hidden, "lr": hidden_rate, "hidden": True})
    return groups


def hidden_matrices(network: nn.Module) -> list[nn.Parameter]:
    """The matrices between hidden channels that the modules of a network name by a method `hidden_matrices`."""
    matrices: list[nn.Parameter] = []
    for module in network.modules():
        if hasattr(module, "hidden_matrices"):
            matrices += module.hidden_matrices()  # type: ignore[operator]
    return matrices


def _parameters(groups: Iterable[ParameterGroup]) -> list[nn.Parameter]:
    """The parameters of some groups, one after the other."""
    parameters: list[nn.Parameter] = []
    for group in groups:
        parameters += group["params"]
    return parameters


class Optimisers:
    """Adam and Muon over the groups of an objective; Muon steps the groups with `hidden`."""

    def __init__(self, groups: list[ParameterGroup], device: torch.device):
        """Share the groups out to the two optimisers, and make their states, before any step."""
        self.highest = [group["lr"] for group in groups]  # the highest learning rate of each group
        self.optimiser_of_name: dict[str, torch.optim.Optimizer] = {}
        self.groups: list[ParameterGroup] = []  # in the order of `groups`; the optimisers hold the same dictionaries
        groups_of_name: dict[str, list[ParameterGroup]] = {"adam": [], "muon": []}
        for group in groups:
            own = {key: value for key, value in group.items() if key != "hidden"}
            groups_of_name["muon" if group.get("hidden") else "adam"].append(own)
            self.groups.append(own)
        if groups_of_name["adam"]:
            adam = torch.optim.Adam(groups_of_name["adam"], fused=True, capturable=records_graphs(device))
            self.optimiser_of_name["adam"] = adam
            # Adam makes its state at the first step; made now, it can be saved and restored before any step.
            for parameter in _parameters(adam.param_groups):
                adam.state[parameter] = {
                    "step": torch.zeros((), device=device),
                    "exp_avg": torch.zeros_like(parameter),
                    "exp_avg_sq": torch.zeros_like(parameter),
                }
        if groups_of_name["muon"]:
            self.optimiser_of_name["muon"] = Muon(groups_of_name["muon"])
        if records_graphs(device):  # a recorded step reads its rates there
            for group in self.groups:
                group["lr"] = torch.zeros((), device=device)

    @property
    def parameters(self) -> list[nn.Parameter]:
        """All parameters, in the order of the given groups."""
        return _parameters(self.groups)

    def tensors(self) -> dict[str, Tensor]:
        """Every tensor of their states by name; not copies."""
        tensors = {}
        for name, optimiser in self.optimiser_of_name.items():
            for number, parameter in enumerate(_parameters(optimiser.param_groups)):
                for key, value in optimiser.state[parameter].items():
                    tensors[f"{name}.{number}.{key}"] = value
        return tensors

    def set_rates(self, rates: list[float]) -> None:
        """Set the learning rate of each group."""
        for group, new_rate in zip(self.groups, rates, strict=True):
            if isinstance(group["lr"], Tensor):
                group["lr"].fill_(new_rate)
            else:
                group["lr"] = new_rate

    def step(self) -> None:
        """One step down the gradients, each group at its own rate; then clear the gradients."""
        for optimiser in self.optimiser_of_name.values():
            optimiser.step()
        self.clear()

    def clear(self) -> None:
        """Clear the gradients."""
        for optimiser in self.optimiser_of_name.values():
            optimiser.zero_grad(set_to_none=True)
