"""Clusters of texels, found by k-means among the principal components of their log ABRDFs, and their index."""

import numpy as np
import torch
from torch import Tensor

from baselines.components import principal
from bench.btf import BTF
from bench.codec import Fit
from bench.training import compress, expand

Array = np.ndarray
BLOCK_BYTES = 64 << 20  # slices read together
PASSES = 4  # passes over the data for the principal components
CLUSTERING_BATCH = 4_096
MOST_CODES = 65_536


def reduced(btf: BTF, gain: float, components: int, fit: Fit) -> tuple[Tensor, Tensor, Array]:
    """The mean (3 · pairs,) of log ABRDFs, principal directions (3 · pairs, k), and the texels' places (H · W, k).

    Distances between places are those of the ABRDFs, as far as the directions show them: the directions, weighted by
    the scene's demand if there is one, have length 1.
    """
    factors = principal(btf, fit, gain, components, PASSES, BLOCK_BYTES)
    weight = 1 if fit.row_weights is None else fit.row_weights.to(fit.device).sqrt()[:, None]  # (3 · pairs, 1), or 1
    lengths = torch.linalg.vector_norm(factors.basis * weight, dim=0)  # (k,)
    points: Array = (factors.coefficients.T * lengths).cpu().numpy()
    return factors.mean.cpu(), (factors.basis / lengths).cpu(), points


def clustered(points: Array, codes: int, seed: int) -> Array:
    """The cluster (n,) of each point (n, k), numbered without gaps; points that are equal as halves share one."""
    from sklearn.cluster import MiniBatchKMeans

    if codes == 1 or points.shape[1] == 0:
        return np.zeros(len(points), np.int64)
    # Points are equal if they are in steps of 2⁻¹² of the largest number, about the precision of a half. If all points
    # are 0, any step will do: `or` makes it 1.
    step = 2.0**-12 * np.abs(points).max(initial=0) or 1.0
    distinct, label = np.unique(np.round(points / step), axis=0, return_inverse=True)
    if len(distinct) <= codes:
        return label.reshape(-1)
    means = MiniBatchKMeans(codes, batch_size=CLUSTERING_BATCH, n_init=3, random_state=seed % 2**32)
    # A cluster may be empty; the inverse numbers the others without gaps.
    _, without_gaps = np.unique(means.fit_predict(points), return_inverse=True)
    return without_gaps


def pack_index(label: Array, codes: int) -> Tensor:
    """Labels (n,) below `codes` as bytes: the low eight bits of each, and the high ones if there are more."""
    bits = _bits(codes)
    # (n, bytes): shifted right by no bits and by 8; & 255 keeps the lowest eight.
    planes = torch.from_numpy(label)[:, None] >> 8 * torch.arange(len(bits)) & 255
    return compress(planes, bits)


def _bits(codes: int) -> list[int]:
    """The bits of a label below `codes`: of its low byte, and of its high byte if it needs one."""
    bits = max(1, (codes - 1).bit_length())
    return [bits] if bits <= 8 else [8, bits - 8]


def unpack_index(packed: Tensor, count: int, codes: int) -> Tensor:
    """The `count` labels, int64, that `pack_index` packed. Raises `ValueError` if bytes are missing."""
    if count < 1 or codes > MOST_CODES:
        raise ValueError(f"an index of {count} texels and {codes} codes")
    planes = expand(packed, (count, len(_bits(codes)))).long()  # (n, bytes)
    label = (planes << 8 * torch.arange(planes.shape[1])).sum(1)  # each byte back in its place
    if label.amax() >= codes:
        raise ValueError(f"it has an index beyond the codebook of {codes}")
    return label
