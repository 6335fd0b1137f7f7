"""Truncated singular value decomposition of a matrix that is read in blocks of rows, a stated number of times.

The matrix is features × texels (a slice gives three rows), each row centred over the texels. With Q an orthonormal
basis of texel space, one reading gives A Q and, in the same pass, Aᵀ A Q: a whole power iteration. Randomised range
finder: Halko, Martinsson and Tropp, "Finding structure with randomness", SIAM Review 53 (2011), algorithms 4.4, 5.1.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

OVERSAMPLE = 10  # columns beyond the rank: Halko et al. recommend five to ten
EPSILON = torch.finfo(torch.float32).eps

Blocks = Callable[[str], Iterator[Tensor]]


@dataclass(frozen=True)
class Factors:
    """mean (F,) and the factors of the centred matrix (F, T) ≈ basis (F, k) · coefficientsᵀ, coefficients (T, k).

    Components come in falling order of energy; each column of coefficients has 1 as its largest magnitude.
    """

    mean: Tensor
    basis: Tensor
    coefficients: Tensor


def truncated_svd(
    read: Blocks, shape: tuple[int, int], rank: int, passes: int, generator: torch.Generator, device: torch.device
) -> Factors:
    """The best `rank` components of a matrix of `shape` (F, T), or all that stand above rounding where it has fewer.

    `read(label)` yields the matrix in float32 blocks of rows, in order, which may be overwritten; it is called
    `passes` ≥ 2 times. Memory: four times (F + T) · (rank + 10) numbers, and two blocks. Where rank + 10 reaches the
    smaller side, that is more than the matrix itself: it is then read once and decomposed exactly.
    """
    size = rank + OVERSAMPLE
    if size >= min(shape):
        return _exact(read, shape, rank, device)
    features, texels = shape
    mean = torch.zeros(features, device=device)
    basis = torch.randn(texels, size, generator=generator).to(device)
    for step in range(passes - 1):
        power = torch.zeros_like(basis)
        for _, block in _centred(read(f"pass {step + 1} of {passes}"), mean, first=step == 0):
            power.addmm_(block.T, block @ basis)
        basis = torch.linalg.qr(power).Q
        del power
    projected = torch.empty(features, size, device=device)
    energy = 0.0
    for rows, block in _centred(read(f"pass {passes} of {passes}"), mean, first=False):
        torch.mm(block, basis, out=projected[rows])
        energy += float(torch.linalg.vector_norm(block)) ** 2
    values, vectors = torch.linalg.eigh(projected.T.double() @ projected.double())
    floor = EPSILON * (energy + texels * float(mean.square().sum())) ** 0.5
    keep = _largest(values, rank, floor)
    turn = vectors[:, keep].float()
    return _balanced(mean, projected @ turn, basis @ turn)


def _exact(read: Blocks, shape: tuple[int, int], rank: int, device: torch.device) -> Factors:
    """All components, from the eigenvectors of the smaller Gram matrix in double precision."""
    features, texels = shape
    mean = torch.zeros(features, device=device)
    matrix = torch.empty(features, texels, dtype=torch.float64, device=device)
    for rows, block in _centred(read("reading"), mean, first=True):
        matrix[rows] = block
    norm = float(matrix.square().sum() + texels * mean.double().square().sum()) ** 0.5
    # Values rounded to float32 carry white noise, whose largest singular value is about this.
    floor = EPSILON * norm * (features**-0.5 + texels**-0.5)
    if texels <= features:
        values, vectors = torch.linalg.eigh(matrix.T @ matrix)
        coefficients = vectors[:, _largest(values, rank, floor)]
        basis = matrix @ coefficients
    else:
        values, vectors = torch.linalg.eigh(matrix @ matrix.T)
        basis = vectors[:, _largest(values, rank, floor)]
        coefficients = matrix.T @ basis
    return _balanced(mean, basis, coefficients)


def _centred(blocks: Iterator[Tensor], mean: Tensor, first: bool) -> Iterator[tuple[slice, Tensor]]:
    """The blocks less the mean of each row, with the rows they hold; the first reading finds the means."""
    start = 0
    for block in blocks:
        rows = slice(start, start + len(block))
        if first:
            # In double, so that a constant row centres to exact zeros.
            mean[rows] = block.mean(1, dtype=torch.float64)
        yield rows, block.sub_(mean[rows, None])
        start = rows.stop


def _largest(values: Tensor, rank: int, floor: float) -> Tensor:
    """Columns of the at most `rank` largest eigenvalues, falling, whose roots stand above the floor."""
    order = values.argsort(descending=True)[:rank]
    return order[values[order] > floor**2]


def _balanced(mean: Tensor, basis: Tensor, coefficients: Tensor) -> Factors:
    """The same product with coefficients in [−1, 1] and a sign that does not hang on the solver's whim."""
    peak = coefficients.abs().argmax(0, keepdim=True)
    scale = coefficients.gather(0, peak)
    return Factors(mean, (basis * scale).float(), (coefficients / scale).float())
