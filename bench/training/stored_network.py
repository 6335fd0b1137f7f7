"""The weights of a network in a file: as floats, as halves, or in eight bits, which the fit takes into account.

In eight bits a matrix is stored in steps of its own, as large as the fit bears, and the codes are stored as those of
textures are, so that many small ones take few bytes. Biases, norms, convolutions and all others that are no matrices
stay halves. From half of the fit on, a step is taken with the weights as the file will hold them: the gradient at the
rounded weights moves the exact ones (Courbariaux et al., "BinaryConnect", 2015).
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Literal, TypeVar

import torch
from torch import Tensor, nn

from bench.material import HALF_MAX
from bench.training.quantise import pack, unpack
from bench.training.texture_codes import MOST_BITS, compress, expand

WeightPrecision = Literal["float32", "half", "int8"]

BEARABLE = 0.03  # share of the fit's squared error that the rounding of all weights may add
MIDDLE = 2 ** (MOST_BITS - 1)  # the code of a weight of 0
PROBED_STEPS = 8  # a matrix is rounded in steps this many times its least one, to see what error a step adds
MOST_STEPS = MIDDLE - 1  # the most steps of a weight
STEPS = "stored_steps"  # the buffer of a network with the step of each of its matrices; 0: not chosen


def to_vector(network: nn.Module) -> Tensor:
    """Concatenate all parameters of a network to one tensor, as a codec file stores them."""
    return torch.cat([p.detach().reshape(-1) for p in network.parameters()])


def load_vector(vector: Tensor, network: nn.Module) -> None:
    """The inverse of `to_vector`, from any float dtype. Raises `ValueError` if the count differs."""
    _copy_into(list(network.parameters()), vector)


Stored = TypeVar("Stored", bound=nn.Module)


def store_network(network: nn.Module, precision: WeightPrecision) -> dict[str, Tensor]:
    """All weights of a network as named tensors, `weights` and others, for one part of a file."""
    if precision != "int8":
        return pack("weights", to_vector(network), precision)
    matrices, others = _matrices_and_others(network)
    if not matrices:
        return pack("weights", to_vector(network), "half")
    steps = _steps(network, matrices)
    codes = [_codes(matrix, step) for matrix, step in zip(matrices, steps, strict=True)]
    stored = {"weights": compress((_joined(codes) + MIDDLE)[:, None], [MOST_BITS], _sizes(matrices))}
    return stored | {"weights.step": steps.cpu()} | pack("weights.other", _joined(others), "half")


def load_network(network: Stored, tensors: dict[str, Tensor]) -> Stored:
    """The network, with weights of `store_network`. `ValueError` if their count differs, `InputError` if codes do."""
    if "weights.step" not in tensors:
        load_vector(unpack("weights", tensors), network)
        return network
    matrices, others = _matrices_and_others(network)
    count = sum(matrix.numel() for matrix in matrices)
    codes = expand(tensors["weights"], (count, 1), _sizes(matrices))[:, 0] - MIDDLE
    _copy_into(matrices, codes)
    _copy_into(others, unpack("weights.other", tensors))
    steps = [torch.empty(()) for _ in matrices]
    _copy_into(steps, tensors["weights.step"])
    with torch.no_grad():
        for matrix, step in zip(matrices, steps, strict=True):
            # Halves hold no larger weights either: those of an altered file could overflow in a few layers.
            matrix.mul_(step).clamp_(-HALF_MAX, HALF_MAX)
    return network


def note_steps(networks: Iterable[nn.Module]) -> None:
    """Give each network the buffer of the steps of its matrices, which belongs to the state of its fit."""
    for network in networks:
        if not hasattr(network, STEPS):
            matrices, _ = _matrices_and_others(network)
            device = next((p.device for p in network.parameters()), None)
            network.register_buffer(STEPS, torch.zeros(len(matrices), device=device))


@torch.no_grad()
def choose_steps(networks: Iterable[nn.Module], answers: Callable[[], Tensor], target: Tensor) -> None:
    """Choose the steps in the buffers of `note_steps`, by how much `answers` change if a matrix is rounded alone.

    The answers should be `target`. The squared error that a matrix adds grows with the square of its step, and a weight
    has the fewer bits the larger its step is, by the logarithm. So for given error the file is smallest if all matrices
    add the same error for each of their weights; all together may add `BEARABLE` of the fit's error.
    """
    networks = list(networks)
    exact = answers()
    bearable = BEARABLE * (exact - target).square().mean()
    matrices_of_networks = [_matrices_and_others(network)[0] for network in networks]
    count = sum(matrix.numel() for matrices in matrices_of_networks for matrix in matrices)
    for network, matrices in zip(networks, matrices_of_networks, strict=True):
        steps = getattr(network, STEPS)
        for place, matrix in enumerate(matrices):
            exact_matrix = matrix.clone()
            least = _least_step(matrix)
            probed_step = least * PROBED_STEPS
            matrix.copy_(_codes(matrix, probed_step) * probed_step)
            error = (answers() - exact).square().mean()
            matrix.copy_(exact_matrix)
            share = bearable * matrix.numel() / count
            step = probed_step * (share / error.clamp_min(1e-30)).sqrt()
            steps[place] = step.clamp(least, least * MOST_STEPS)


@contextmanager
def rounded_weights(networks: Iterable[nn.Module]) -> Iterator[None]:
    """Within it, some networks have the weights that a file of eight bits holds; after it, their own again."""
    exact = []  # each matrix with a copy
    with torch.no_grad():
        for network in networks:
            matrices, _ = _matrices_and_others(network)
            if not matrices:
                continue
            for matrix, step in zip(matrices, _steps(network, matrices), strict=True):
                exact.append((matrix, matrix.detach().clone()))
                matrix.copy_(_codes(matrix, step) * step)
    try:
        yield
    finally:
        with torch.no_grad():
            for matrix, values in exact:
                matrix.copy_(values)


def _matrices_and_others(network: nn.Module) -> tuple[list[Tensor], list[Tensor]]:
    """The parameters of a network that are matrices, and the others."""
    parameters = list(network.parameters())
    matrices: list[Tensor] = [p for p in parameters if p.ndim == 2]
    others: list[Tensor] = [p for p in parameters if p.ndim != 2]
    return matrices, others


def _steps(network: nn.Module, matrices: Sequence[Tensor]) -> Tensor:
    """The steps (matrices,) of a network that has some: those that were chosen, or the least."""
    least = torch.stack([_least_step(matrix) for matrix in matrices])
    chosen = getattr(network, STEPS, None)
    return least if chosen is None else torch.where(chosen > 0, chosen, least)


def _least_step(matrix: Tensor) -> Tensor:
    """The step () that makes the largest weight of a matrix the last code."""
    # A matrix of zeros has the least step that is no zero, because weights are divided by it.
    return (matrix.detach().abs().amax() / MOST_STEPS).clamp_min(torch.finfo(torch.float32).tiny)


def _codes(matrix: Tensor, step: Tensor) -> Tensor:
    """The weights of a matrix (rows, columns) in whole steps."""
    return (matrix.detach() / step).round().clamp(-MOST_STEPS, MOST_STEPS)


def _sizes(matrices: Sequence[Tensor]) -> list[tuple[int, int]]:
    """The rows and columns of matrices, whose codes are predicted as those of pictures are."""
    return [(matrix.shape[0], matrix.shape[1]) for matrix in matrices]


def _joined(tensors: list[Tensor]) -> Tensor:
    """Some tensors as one vector; of none, an empty one."""
    flat = [tensor.detach().cpu().reshape(-1) for tensor in tensors]
    return torch.cat([torch.empty(0), *flat])


def _copy_into(tensors: list[Tensor], vector: Tensor) -> None:
    """Copy a vector into some tensors, one after the other. Raises `ValueError` if the count differs."""
    counts = [each.numel() for each in tensors]
    total = sum(counts)
    if vector.shape != (total,):
        raise ValueError(f"the networks have {total} parameters, but the file has {tuple(vector.shape)}")
    with torch.no_grad():
        for each, values in zip(tensors, vector.split(counts), strict=True):
            each.copy_(values.reshape(each.shape))
