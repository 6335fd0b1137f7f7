"""The weights of a network in a file: as floats, as halves, or in at most eight bits, which the fit takes into account.

In eight bits each matrix has as few bits as add little error, and each of its rows a step of its own, so that the
largest weight of the row is the last step; their codes are stored as those of textures are. Biases, norms and other
vectors stay halves. From half of the fit on, a step is taken with the weights as the file will hold them: the gradient
at the rounded weights moves the exact ones (Courbariaux et al., "BinaryConnect", 2015).
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Literal, TypeVar

import torch
from torch import Tensor, nn

from bench.material import HALF_MAX
from bench.training.quantise import pack, unpack
from bench.training.stored_texture import shared_out
from bench.training.texture_codes import MOST_BITS, compress, expand

WeightPrecision = Literal["float32", "half", "int8"]

LEAST_BITS = 2  # of a weight: −1, 0 and 1 steps
BEARABLE = 0.03  # share of the fit's squared error that the rounding of all weights may add
MIDDLE = 2 ** (MOST_BITS - 1)  # the code of a weight of 0
ON_HOST = "stored_bits_on_host"  # the attribute of a network with the numbers of its buffer `BITS`
BITS = "stored_bits"  # the buffer of a network that holds the bits of each of its matrices; 0: not chosen


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
    bits = _bits_of(network, matrices)
    steps = [_steps(matrix, count) for matrix, count in zip(matrices, bits, strict=True)]
    codes = [(matrix.detach() / step).round() for matrix, step in zip(matrices, steps, strict=True)]
    stored = {"weights": compress((_joined(codes) + MIDDLE)[:, None], [MOST_BITS], _sizes(matrices))}
    return stored | pack("weights.step", _joined(steps), "half") | pack("weights.other", _joined(others), "half")


def load_network(network: Stored, tensors: dict[str, Tensor]) -> Stored:
    """The network, with the weights that `store_network` stored. Raises `ValueError` if their count differs."""
    if "weights.step" not in tensors:
        load_vector(unpack("weights", tensors), network)
        return network
    matrices, others = _matrices_and_others(network)
    count = sum(matrix.numel() for matrix in matrices)
    codes = expand(tensors["weights"], (count, 1), _sizes(matrices))[:, 0] - MIDDLE
    _copy_into(matrices, codes)
    _copy_into(others, unpack("weights.other", tensors))
    steps = [torch.empty(len(matrix), 1) for matrix in matrices]
    _copy_into(steps, unpack("weights.step", tensors))
    with torch.no_grad():
        for matrix, step in zip(matrices, steps, strict=True):
            # Halves hold no larger weights either: those of an altered file could overflow in a few layers.
            matrix.mul_(step).clamp_(-HALF_MAX, HALF_MAX)
    return network


def note_bits(networks: Iterable[nn.Module]) -> None:
    """Give each network the buffer of the bits of its matrices, which belongs to the state of its fit."""
    for network in networks:
        if not hasattr(network, BITS):
            matrices, _ = _matrices_and_others(network)
            device = next((p.device for p in network.parameters()), None)
            network.register_buffer(BITS, torch.zeros(len(matrices), dtype=torch.long, device=device))


@torch.no_grad()
def choose_weight_bits(networks: Iterable[nn.Module], answers: Callable[[], Tensor], target: Tensor) -> None:
    """Choose the bits of each matrix, by the change of `answers`, which should be `target`, if it is rounded alone.

    The squared error that a matrix adds grows with the square of its rounding. Each bit goes to the matrix that adds
    most error for each of its weights, until all together add `BEARABLE` of the fit's error.
    """
    networks = list(networks)
    matrices = [matrix for network in networks for matrix in _matrices_and_others(network)[0]]
    exact = answers()
    noise = []  # of each matrix, the error that it adds with each number of bits
    for matrix in matrices:
        kept = matrix.clone()
        changes = [_rounded(kept, bits) - kept for bits in range(LEAST_BITS, MOST_BITS + 1)]
        spread = torch.stack([change.square().mean() for change in changes])
        probed = len(changes) // 2
        matrix.add_(changes[probed])
        error = (answers() - exact).square().mean()
        matrix.copy_(kept)
        noise.append(spread * (error / spread[probed].clamp_min(1e-30)))
    sizes = torch.tensor([matrix.numel() for matrix in matrices])
    bearable = BEARABLE * float((exact - target).square().mean())
    bits = shared_out(torch.stack(noise).cpu(), sizes, MOST_BITS * int(sizes.sum()), bearable, LEAST_BITS)
    for network in networks:
        buffer = getattr(network, BITS)
        buffer.copy_(bits[: len(buffer)])
        bits = bits[len(buffer) :]
    read_bits(networks)


def read_bits(networks: Iterable[nn.Module]) -> None:
    """Note the bits of matrices on the host, too, where steps read them: a GPU would be waited for at each."""
    for network in networks:
        setattr(network, ON_HOST, getattr(network, BITS).tolist())


@contextmanager
def rounded_weights(networks: Iterable[nn.Module]) -> Iterator[None]:
    """Within it, some networks have the weights that a file of eight bits holds; after it, their own again."""
    exact = []  # each matrix with a copy
    with torch.no_grad():
        for network in networks:
            matrices, _ = _matrices_and_others(network)
            for matrix, bits in zip(matrices, _bits_of(network, matrices), strict=True):
                exact.append((matrix, matrix.detach().clone()))
                matrix.copy_(_rounded(matrix, bits))
    try:
        yield
    finally:
        with torch.no_grad():
            for matrix, values in exact:
                matrix.copy_(values)


def _matrices_and_others(network: nn.Module) -> tuple[list[Tensor], list[Tensor]]:
    """The parameters that are matrices, and the others."""
    parameters = list(network.parameters())
    matrices: list[Tensor] = [p for p in parameters if p.ndim == 2]
    others: list[Tensor] = [p for p in parameters if p.ndim != 2]
    return matrices, others


def _bits_of(network: nn.Module, matrices: Sequence[Tensor]) -> list[int]:
    """The bits of each matrix of a network: those that were chosen, or as many as there can be."""
    chosen: list[int] = getattr(network, ON_HOST, [0] * len(matrices))
    return [bits or MOST_BITS for bits in chosen]


def _steps(matrix: Tensor, bits: int) -> Tensor:
    """The step (rows, 1) of each row of a matrix (rows, columns) of so many bits a weight."""
    largest = matrix.detach().abs().amax(1, keepdim=True)
    # A row of zeros has the least step that is no zero, because weights are divided by it.
    return (largest / (2 ** (bits - 1) - 1)).clamp_min(torch.finfo(torch.float32).tiny)


def _rounded(matrix: Tensor, bits: int) -> Tensor:
    """A matrix (rows, columns) in so many bits a weight."""
    step = _steps(matrix, bits)
    return (matrix.detach() / step).round() * step


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
    wanted = sum(counts)
    if vector.shape != (wanted,):
        raise ValueError(f"the networks have {wanted} parameters, but the file has {tuple(vector.shape)}")
    with torch.no_grad():
        for each, values in zip(tensors, vector.split(counts), strict=True):
            each.copy_(values.reshape(each.shape))
