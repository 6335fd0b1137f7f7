"""The weights of a network in a file: as floats, as halves, or in eight bits, which the fit takes into account.

In eight bits each row of a matrix has a step of its own, so that the largest weight of the row is 127 steps; biases,
norms and other vectors stay halves. From half of the fit on, a step is taken with the weights as the file will hold
them: the gradient at the rounded weights moves the exact ones (Courbariaux et al., "BinaryConnect", 2015).
"""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Literal, TypeVar

import torch
from torch import Tensor, nn

from bench.material import HALF_MAX
from bench.training.quantise import pack, unpack

WeightPrecision = Literal["float32", "half", "int8"]

MOST_STEPS = 127  # of the largest weight of a row, in eight bits


def to_vector(*networks: nn.Module) -> Tensor:
    """Concatenate all parameters of some networks to one tensor, as a codec file stores them."""
    return torch.cat([p.detach().reshape(-1) for p in _all_parameters(networks)])


def load_vector(vector: Tensor, *networks: nn.Module) -> None:
    """The inverse of `to_vector`, from any float dtype. Raises `ValueError` if the count differs."""
    _copy_into(_all_parameters(networks), vector)


def _all_parameters(networks: Iterable[nn.Module]) -> list[Tensor]:
    """The parameters of some networks, one after the other."""
    found: list[Tensor] = []
    for network in networks:
        found += network.parameters()
    return found


Stored = TypeVar("Stored", bound=nn.Module)


def store_network(network: nn.Module, precision: WeightPrecision) -> dict[str, Tensor]:
    """All weights of a network as named tensors, `weights` and others, for one part of a file."""
    if precision != "int8":
        return pack("weights", to_vector(network), precision)
    matrices, others = _matrices_and_others(network)
    steps = [_steps(matrix) for matrix in matrices]
    codes = [(matrix.detach() / step).round() for matrix, step in zip(matrices, steps, strict=True)]
    stored = {"weights": _joined(codes).to(torch.int8).cpu()}
    return stored | pack("weights.step", _joined(steps), "half") | pack("weights.other", _joined(others), "half")


def load_network(network: Stored, tensors: dict[str, Tensor]) -> Stored:
    """The network, with the weights that `store_network` stored. Raises `ValueError` if their count differs."""
    if "weights.step" not in tensors:
        load_vector(unpack("weights", tensors), network)
        return network
    matrices, others = _matrices_and_others(network)
    _copy_into(matrices, tensors["weights"].float())
    _copy_into(others, unpack("weights.other", tensors))
    steps = [torch.empty(len(matrix), 1) for matrix in matrices]
    _copy_into(steps, unpack("weights.step", tensors))
    with torch.no_grad():
        for matrix, step in zip(matrices, steps, strict=True):
            # Halves hold no larger weights either: those of an altered file could overflow in a few layers.
            matrix.mul_(step).clamp_(-HALF_MAX, HALF_MAX)
    return network


@contextmanager
def rounded_weights(networks: Iterable[nn.Module]) -> Iterator[None]:
    """Within it, some networks have the weights that a file of eight bits holds; after it, their own again."""
    matrices = [p for p in _all_parameters(networks) if p.ndim == 2]
    exact = [matrix.detach().clone() for matrix in matrices]
    with torch.no_grad():
        for matrix in matrices:
            step = _steps(matrix)
            matrix.div_(step).round_().mul_(step)
    try:
        yield
    finally:
        with torch.no_grad():
            for matrix, values in zip(matrices, exact, strict=True):
                matrix.copy_(values)


def _matrices_and_others(network: nn.Module) -> tuple[list[Tensor], list[Tensor]]:
    """The parameters that are matrices, and the others."""
    parameters = list(network.parameters())
    matrices: list[Tensor] = [p for p in parameters if p.ndim == 2]
    others: list[Tensor] = [p for p in parameters if p.ndim != 2]
    return matrices, others


def _steps(matrix: Tensor) -> Tensor:
    """The step (rows, 1) of each row of a matrix (rows, columns)."""
    largest = matrix.detach().abs().amax(1, keepdim=True)
    # A row of zeros has the least step that is no zero, because weights are divided by it.
    return (largest / MOST_STEPS).clamp_min(torch.finfo(torch.float32).tiny)


def _joined(tensors: list[Tensor]) -> Tensor:
    """Some tensors as one vector; of none, an empty one."""
    flat = [tensor.detach().cpu().reshape(-1) for tensor in tensors]
    return torch.cat([torch.empty(0), *flat])


def _copy_into(tensors: list[Tensor], vector: Tensor) -> None:
    """Copy a vector into some tensors, one after the other. Raises `ValueError` if the count differs."""
    counts = [each.numel() for each in tensors]
    wanted = sum(counts)
    if vector.shape != (wanted,):
        raise ValueError(f"the networks have {wanted} parameters, but the file has {tuple(vector.shape)}")
    with torch.no_grad():
        for each, values in zip(tensors, vector.split(counts), strict=True):
            each.copy_(values.reshape(each.shape))
