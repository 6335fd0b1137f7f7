"""Clusters of texels, found by k-means among the principal components of their log ABRDFs, and their index.

A texel's *point* is its k coefficients of principal components. A *label* is the number of a texel's cluster, a *code*
what a codec stores for a cluster; the *index* holds the labels of all texels.
"""

import numpy as np
import torch
from torch import Tensor

from baselines.components import principal_components
from bench.btf import BTF
from bench.codec import Fit
from bench.training import compress, expand

Array = np.ndarray
BLOCK_BYTES = 64 << 20  # slices read together
PASSES = 4  # passes over the data for the principal components
CLUSTERING_BATCH = 4_096  # points of a step of k-means
MOST_CODES = 65_536  # as many as two bytes can number


def reduced_abrdfs(btf: BTF, gain: float, components: int, fit: Fit) -> tuple[Tensor, Tensor, Array]:
    """The mean (3 · pairs,) of log ABRDFs, principal directions (3 · pairs, k), and the texels' points (H · W, k).

    k is `components`, or the rank of the data if it is lower. A texel's log ABRDF is about mean + directions · its
    point. Directions have length 1, in a fit to a scene with each pair weighted by its demand. So the distance of two
    points is about that of their ABRDFs.
    """
    factors = principal_components(btf, fit, gain, components, PASSES, BLOCK_BYTES)
    weighted_basis = factors.basis  # (3 · pairs, k)
    if fit.row_weights is not None:  # of squares, so the values are weighted by the root
        weighted_basis = weighted_basis * fit.row_weights.to(fit.device).sqrt()[:, None]
    lengths = torch.linalg.vector_norm(weighted_basis, dim=0)  # (k,)
    points: Array = (factors.coefficients.T * lengths).cpu().numpy()
    directions = factors.basis / lengths
    return factors.mean.cpu(), directions.cpu(), points


def cluster_labels(points: Array, clusters: int, seed: int) -> Array:
    """The cluster (n,) of each point (n, k), of at most so many `clusters`, numbered without gaps.

    If no more points than `clusters` are distinct, each distinct point is a cluster. `seed` is that of k-means.
    """
    from sklearn.cluster import MiniBatchKMeans

    if clusters == 1 or points.shape[1] == 0:
        return np.zeros(len(points), np.int64)  # one cluster; points of no numbers are all alike
    # Points are equal if they round to the same steps of 2⁻¹² of the largest number, about the precision of a half.
    step = 2.0**-12 * np.abs(points).max(initial=0)
    if step == 0:  # all points are 0, and any step will do
        step = 1.0
    distinct_points, label = np.unique(np.round(points / step), axis=0, return_inverse=True)
    if len(distinct_points) <= clusters:
        return label.reshape(-1)
    kmeans = MiniBatchKMeans(clusters, batch_size=CLUSTERING_BATCH, n_init=3, random_state=seed % 2**32)
    # A cluster may be empty; the inverse numbers the others without gaps.
    _, without_gaps = np.unique(kmeans.fit_predict(points), return_inverse=True)
    return without_gaps


def pack_index(label: Array, codes: int) -> Tensor:
    """Labels (n,) below `codes` as compressed bytes (m,), uint8, for `unpack_index`.

    They are the low eight bits of each label, and the high ones if `codes` need more.
    """
    bits = _bits_of_bytes(codes)
    shifts = 8 * torch.arange(len(bits))  # the low byte is shifted by 0 bits, the high one by 8
    label_bytes = (torch.from_numpy(label)[:, None] >> shifts) & 255  # (n, bytes)
    return compress(label_bytes, bits)


def _bits_of_bytes(codes: int) -> list[int]:
    """The used bits of each byte of a label below `codes`, the low byte first; a label has one byte or two."""
    bits = max(1, (codes - 1).bit_length())
    return [bits] if bits <= 8 else [8, bits - 8]


def unpack_index(packed: Tensor, count: int, codes: int) -> Tensor:
    """The labels (count,), int64, that `pack_index` packed. Raises `ValueError` if bytes are missing, a label is not
    below `codes`, there is no texel, or there are more codes than `MOST_CODES`."""
    if count < 1 or codes > MOST_CODES:
        raise ValueError(f"an index of {count} texels and {codes} codes")
    byte_count = len(_bits_of_bytes(codes))
    label_bytes = expand(packed, (count, byte_count)).long()  # (n, bytes), the low byte first
    label = (label_bytes << (8 * torch.arange(byte_count))).sum(1)
    if label.amax() >= codes:
        raise ValueError(f"it has an index beyond the codebook of {codes}")
    return label
