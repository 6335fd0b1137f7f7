"""Truncated singular value decomposition of a matrix read in blocks of rows, in a fixed number of passes.

The matrix A is features × texels (a slice gives three rows), each row centred over the texels. With rows Q in texel
space, one pass gives both A Qᵀ and its image under Aᵀ: a whole power iteration. The images of all passes together span
a Krylov space, in which the last pass finds the components: Musco and Musco, "Randomized Block Krylov Methods for
Stronger and Faster Approximate Singular Value Decomposition", NeurIPS 2015; Halko et al., SIAM Review 53 (2011).
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from torch import Tensor

from bench.btf import BTF
from bench.codec import Fit

OVERSAMPLE = 10  # rows beyond the rank: Halko et al. recommend five to ten
EPSILON = torch.finfo(torch.float32).eps
CHUNK = 1 << 15  # columns converted to double at once
EXACT_SIDE, EXACT_BYTES = 1024, 64 << 20  # a smaller side and a matrix up to these are decomposed exactly: 0.4 s
LEAST_WEIGHT = 1e-6  # rows of weight 0 are stored too, and divided by the root of their weight
SPACE_BYTES = 512 << 20  # memory for images; with many texels only those of the last passes are kept, at least two

Blocks = Callable[[str], Iterator[Tensor]]  # reads a matrix once; the words name the pass in a progress bar
BLOCK_BYTES = 16 << 20  # slices read together: enough for fast products, few enough for the cache


@dataclass(frozen=True)
class Factors:
    """The mean and the factors, basis · coefficients, of a centred matrix (F, T), in falling order of energy."""

    mean: Tensor  # (F,)
    basis: Tensor  # (F, k)
    coefficients: Tensor  # (k, T), 1 the entry of largest magnitude in each row


def truncated_svd(
    read: Blocks,
    shape: tuple[int, int],
    rank: int,
    passes: int,
    generator: torch.Generator,
    device: torch.device,
    weight: Tensor | None = None,
) -> Factors:
    """The `rank` strongest components of a matrix of `shape` (F, T), or all above rounding error if fewer.

    A `weight` (F,) weights the squared error of each row. `read(label)` yields the matrix in float32 blocks of rows, in
    order, which will be overwritten; it is called `passes` ≥ 2 times. Memory: for each pass except the last an image
    of (rank + 10) · T numbers, as `SPACE_BYTES` holds but at least two; one or two more; and the same for F. A small
    matrix, and one that all images together would hold, is read once and decomposed exactly.
    """
    if weight is not None:
        root = weight.clamp_min(LEAST_WEIGHT).sqrt().to(device)
        scaled = truncated_svd(partial(_scaled, read, root), shape, rank, passes, generator, device)
        return Factors(scaled.mean / root, scaled.basis / root[:, None], scaled.coefficients)
    features, texels = shape
    size = rank + OVERSAMPLE  # rows of an image
    bytes_of_matrix = 4 * features * texels
    small = min(shape) <= EXACT_SIDE and bytes_of_matrix <= EXACT_BYTES
    if small or size * (passes - 1) >= min(shape):  # the space of all images would be the whole one
        return _exact(read, shape, rank, device)
    mean, rows_of_space = _mean_and_krylov_space(read, shape, size, passes, generator, device)
    # The last pass projects the matrix on the space; the components of this smaller matrix are those wanted.
    projected = torch.empty(features, len(rows_of_space), device=device)
    energy = 0.0
    for rows, block in _centred(read(f"pass {passes} of {passes}"), mean, first=False):
        torch.mm(block, rows_of_space.T, out=projected[rows])
        energy += float(torch.linalg.vector_norm(block)) ** 2
    values, vectors = torch.linalg.eigh(_gram(projected.T))
    # What is below the rounding error of the matrix as it was read says nothing. Its energy is that of the centred
    # matrix and that of the means.
    floor = EPSILON * (energy + texels * float(mean.square().sum())) ** 0.5
    turn = vectors[:, _largest(values, rank, floor)].float()
    return _balanced(mean, projected @ turn, turn.T @ rows_of_space)


def _mean_and_krylov_space(
    read: Blocks, shape: tuple[int, int], size: int, passes: int, generator: torch.Generator, device: torch.device
) -> tuple[Tensor, Tensor]:
    """The mean (F,) of each row of a matrix of `shape` (F, T), and orthonormal rows (n, T) in which its strongest
    components lie, from all passes but the last.

    They span the images of `size` random rows under AᵀA, under its square, and so on.
    """
    features, texels = shape
    mean = torch.zeros(features, device=device)
    bytes_of_image = 4 * size * texels
    depth = min(passes - 1, max(2, SPACE_BYTES // bytes_of_image))  # images that are kept
    space = torch.zeros(depth, size, texels, device=device)
    image = torch.randn(size, texels, generator=generator).to(device)
    for step in range(passes - 1):
        power = space[step % depth].zero_()  # the oldest image gives way
        for _, block in _centred(read(f"pass {step + 1} of {passes}"), mean, first=step == 0):
            power.addmm_(image @ block.T, block)
        _orthonormalise(power)
        image = power
    rows = space.flatten(0, 1)  # (depth · size, T)
    _orthonormalise(rows)
    return mean, rows


def strongest(factors: Factors, rank: int) -> Factors:
    """The `rank` strongest components of a product of factors, whose rows need not be orthogonal.

    The coefficients are (vectors · root) times orthonormal rows, which are `inverse` times the coefficients. So the
    product is `whole` times these rows, and its strongest components are those of `whole`.
    """
    if not len(factors.coefficients):
        return factors
    values, vectors = torch.linalg.eigh(_gram(factors.coefficients))
    root = values.clamp_min(0).sqrt()
    inverse = (vectors / root.clamp_min(EPSILON * root.max())).T
    whole = factors.basis.double() @ (vectors * root)
    energies, turn = torch.linalg.eigh(whole.T @ whole)
    turn = turn[:, _largest(energies, rank, 0.0)]
    rows = (turn.T @ inverse).float() @ factors.coefficients
    return _balanced(factors.mean, (whole @ turn).float(), rows)


def _scaled(read: Blocks, root: Tensor, label: str) -> Iterator[Tensor]:
    """The blocks of rows that `read(label)` yields, each row times its root (F,) of a weight."""
    start = 0
    for block in read(label):
        yield block.mul_(root[start : start + len(block), None])
        start += len(block)


def _exact(read: Blocks, shape: tuple[int, int], rank: int, device: torch.device) -> Factors:
    """The `rank` strongest components, from the eigenvectors of the smaller Gram matrix in double precision."""
    features, texels = shape
    mean = torch.zeros(features, device=device)
    matrix = torch.empty(features, texels, device=device)
    for rows, block in _centred(read("reading"), mean, first=True):
        matrix[rows] = block
    norm = float(torch.linalg.vector_norm(matrix) ** 2 + texels * mean.square().sum()) ** 0.5
    # Values rounded to float32 carry white noise, whose largest singular value is about this.
    floor = EPSILON * norm * (features**-0.5 + texels**-0.5)
    values, vectors = torch.linalg.eigh(_gram(matrix if features < texels else matrix.T))
    vectors = vectors[:, _largest(values, rank, floor)].float()
    if features < texels:  # they are the basis, else the coefficients
        return _balanced(mean, vectors, vectors.T @ matrix)
    return _balanced(mean, matrix @ vectors, vectors.T)


def _centred(blocks: Iterator[Tensor], mean: Tensor, first: bool) -> Iterator[tuple[slice, Tensor]]:
    """The blocks minus the mean of each row, with their rows; the first reading writes the means to `mean` (F,)."""
    start = 0
    for block in blocks:
        rows = slice(start, start + len(block))
        if first:
            # Relative to the first entry, so that a constant row centres to exact zeros.
            mean[rows] = block[:, 0] + (block - block[:, :1]).mean(1)
        yield rows, block.sub_(mean[rows, None])
        start = rows.stop


def _gram(rows: Tensor) -> Tensor:
    """rows · rowsᵀ in double precision, of rows (n, m) float32."""
    gram = torch.zeros(len(rows), len(rows), dtype=torch.float64, device=rows.device)
    for chunk in rows.split(CHUNK, 1):
        wide = chunk.double()
        gram.addmm_(wide, wide.T)
    return gram


def _orthonormalise(rows: Tensor) -> None:
    """Make rows (n, m) orthonormal in place, without a second copy; rows that are only rounding error stay short.

    Uses the eigenvectors of the Gram matrix, twice: Stathopoulos and Wu, "A block orthogonalization procedure with
    constant synchronization requirements", SIAM J. Sci. Comput. 23 (2002).
    """
    for _ in range(2):
        values, vectors = torch.linalg.eigh(_gram(rows))
        floor = values[-1].clamp_min(torch.finfo(torch.float64).tiny) * EPSILON**2
        turn = (vectors / values.maximum(floor).sqrt()).T
        for chunk in rows.split(CHUNK, 1):
            chunk.copy_(turn @ chunk.double())


def _largest(values: Tensor, rank: int, floor: float) -> Tensor:
    """Places of the at most `rank` largest eigenvalues, falling, whose roots stand above the floor."""
    order = values.argsort(descending=True)[:rank]
    return order[values[order] > floor**2]


def _balanced(mean: Tensor, basis: Tensor, coefficients: Tensor) -> Factors:
    """The factors rescaled to the same product, so that the entry of largest magnitude in each row of coefficients is
    1: then their sign does not depend on the solver."""
    if len(coefficients) == 0:
        return Factors(mean, basis, coefficients)
    low, high = coefficients.aminmax(dim=1, keepdim=True)
    scale = torch.where(high + low < 0, low, high)  # (k, 1): of the two, that of larger magnitude
    return Factors(mean, basis * scale.T, coefficients.div_(scale))


def blocks(btf: BTF, fit: Fit, label: str, gain: float | None, block_bytes: int = 0) -> Iterator[Tensor]:
    """The slices of a BTF as new blocks (3 · slices, texels), float32, on the device of the fit.

    `label` names the pass in a progress bar. A block has at most `block_bytes` (0: `BLOCK_BYTES`), but at least one
    slice. With a `gain` its numbers are log1p(gain · radiance), negative radiance counting as 0; without, radiance.
    """
    texels = btf.shape[0] * btf.shape[1]
    bytes_of_slice = 12 * texels  # three float32 a texel
    step = max(1, (block_bytes or BLOCK_BYTES) // bytes_of_slice)  # slices of a block
    for pair, picture in enumerate(fit.progress(btf, label, len(btf))):
        place = pair % step  # in the block
        if place == 0:  # a new block; the last may be shorter
            block = np.empty((min(step, len(btf) - pair), 3, texels), np.float32)
        block[place] = picture.reshape(texels, 3).T
        if place == len(block) - 1:
            values = torch.from_numpy(block).flatten(0, 1).to(fit.device)
            if gain is not None:
                values.clamp_min_(0).mul_(gain).log1p_()
            yield values
