"""Local PCA (Müller, Meseth and Klein, "Compression and real-time rendering of measured BTFs using local PCA", 2003).

Clusters are those of Kambhatla and Leen ("Dimension reduction by local principal component analysis", Neural
Computation 9(7), 1997): from k-means on, each texel moves to the cluster whose components give it the least error.

The clustering does not see log ABRDFs but *points*: each texel's coefficients of the principal components of all
texels.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from baselines.clusters import cluster_labels, pack_index, reduced_abrdfs, unpack_index
from baselines.components import probed_texels, probed_values, radiance_under
from bench.btf import BTF
from bench.codec import Codec, Fit, Parts
from bench.directions.interpolation import PairInterpolator, pack_layout, picture_of_pairs, unpack_layout
from bench.inputs.settings import Count, Range
from bench.material import DecoderCost, Material, at_least_float32, saturated, texel_corners
from bench.training import Bits, Rounding, gain_of, load_table, load_texture, round_after, store_table, store_texture

SPANNING_COMPONENTS = 64  # principal components of all texels, in which the clusters' means and components are found
ROUNDS = 30  # of moving texels and finding components; most fits end earlier


class LocalPCA(Codec):
    """Local PCA: clusters of ABRDFs, each with principal components of its own, interpolated over directions.

    Cited as `pca`.
    """

    name, version = "local-pca", 2
    interpolates, sizes = True, ("components", "clusters")

    @dataclass(frozen=True)
    class Settings:
        clusters: Annotated[int, Range(1, 4096)] = 4  # groups of texels; fewer if the texels are fewer
        components: Count = 4  # of each cluster, beside its mean
        bits: Bits = 0  # bits of a stored number on average; 0: chosen by the data; 16, 32: floats

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        """Store coefficients (H, W, k), each texel's cluster, and of N pairs the components of all clusters.

        These are (V, L, clusters · (k + 1), 3) of N = V · L: one cluster after the other, of each its mean, then its k
        components.
        """
        gain = gain_of(btf, fit)
        settings = self.settings
        mean, directions, points = reduced_abrdfs(btf, gain, max(SPANNING_COMPONENTS, settings.components), fit)
        local = local_components(points, settings.clusters, settings.components, fit.seed)
        count = len(local.means)
        table = _table(local, mean, directions)  # (N, 3, clusters · (k + 1))
        texture = torch.from_numpy(local.coefficients).unflatten(0, btf.shape)  # (H, W, k)
        pairs, values = probed_values(btf, fit, gain)
        table_rounding, texture_rounding = self._roundings(table, texture, local, pairs, values)
        coefficients = store_texture("coefficients", texture, texture_rounding)
        # The colours of a component follow each other, so that one predicts the next.
        picture = table.transpose(1, 2).unflatten(0, picture_of_pairs(btf.layout))
        return Parts(
            decoder=store_table("components", picture, table_rounding, axis=2),
            texture=coefficients | {"clusters": pack_index(local.label, count)},
            other={"gain": torch.tensor([gain]), "count": torch.tensor([count]), **pack_layout(btf.layout)},
        )

    def _roundings(
        self, table: Tensor, texture: Tensor, local: "LocalComponents", pairs: Tensor, values: Tensor
    ) -> tuple[Rounding, Rounding]:
        """How a table (N, 3, clusters · (k + 1)) and coefficients (H, W, k) are rounded, each by the error that it adds
        while the other is exact.

        The errors are those of the values (3 · P, texels) of P probed `pairs`.
        """
        label = torch.from_numpy(local.label)
        some_texels = probed_texels(len(label))
        probed_labels = label[some_texels]  # (n,)
        probed_coefficients = texture.flatten(0, 1)[some_texels]  # (n, k)
        probed_table = table[pairs]  # (P, 3, clusters · (k + 1))
        target = values[:, some_texels].cpu()  # (3 · P, n)

        def answers(components: Tensor, coefficients: Tensor) -> Tensor:
            """Log radiance (3 · P, n), from components and coefficients like the probed ones."""
            by_cluster = components.flatten(0, 1).unflatten(1, (len(local.means), -1))  # (3 · P, clusters, k + 1)
            rows = by_cluster[:, probed_labels]  # (3 · P, n, k + 1)
            return (rows * functional.pad(coefficients, (1, 0), value=1.0)).sum(2)

        bits = self.settings.bits
        of_table = round_after(probed_table, bits, lambda rounded: answers(rounded, probed_coefficients), target)
        of_texture = round_after(probed_coefficients, bits, lambda rounded: answers(probed_table, rounded), target)
        return of_table.fit_to(table), of_texture.fit_to(texture)

    def decode(self, parts: Parts, device: torch.device) -> Material:
        """The material of a file's parts, on a device. `ValueError` if clusters and components do not fit."""
        texture = load_texture("coefficients", parts.texture)
        # (N, 3, clusters · (k + 1))
        table = load_table("components", parts.decoder, axis=2).flatten(0, 1).transpose(1, 2)
        count = int(parts.other["count"])
        height, width, components = texture.shape
        if count < 1 or table.shape[1:] != (3, count * (components + 1)):
            raise ValueError(f"components {tuple(table.shape)} for {count} clusters and {components} coefficients")
        label = unpack_index(parts.texture["clusters"], height * width, count)
        interpolator = PairInterpolator(unpack_layout(parts.other, len(table)))
        return LocalPCAMaterial(label, texture, table, interpolator, float(parts.other["gain"])).to(device)


@dataclass(frozen=True)
class LocalComponents:
    """Of each cluster a mean and orthogonal components; of each point its cluster and its coefficients.

    A point is about its cluster's mean + axes · its coefficients, which are from −1 to 1.
    """

    means: np.ndarray  # (clusters, k)
    axes: np.ndarray  # (clusters, k, components)
    label: np.ndarray  # (n,)
    coefficients: np.ndarray  # (n, components)


def local_components(points: np.ndarray, clusters: int, components: int, seed: int) -> LocalComponents:
    """At most `clusters` clusters of points (n, k), float32, and at most `components` components of each.

    Components are found for the clusters, and clusters for the components, by turns, until no point moves or `ROUNDS`
    are over. `seed` is that of the first clusters.
    """
    components = min(components, points.shape[1])
    label = cluster_labels(points, clusters, seed)
    for _ in range(ROUNDS):
        means, axes = _means_and_axes(points, label, components)
        # Of each cluster the errors (n,) of all points; each point takes the cluster of the least.
        errors = []
        for mean, cluster_axes in zip(means, axes, strict=True):
            errors.append(_squared_distances(points - mean, cluster_axes))
        _, new_label = np.unique(np.argmin(errors, 0), return_inverse=True)  # the inverse numbers without gaps
        if np.array_equal(new_label, label):
            break
        label = new_label
    means, axes = _means_and_axes(points, label, components)  # anew, because the last round may have moved points
    coefficients = np.einsum("nk,nkc->nc", points - means[label], axes[label])
    # Coefficients are divided by the largest of their component, which is multiplied by it instead.
    peak = np.abs(coefficients).max(0, initial=0)  # (components,)
    peak[peak == 0] = 1  # so that nothing is divided by 0
    return LocalComponents(means, axes * peak, label, coefficients / peak)


def _table(local: LocalComponents, mean: Tensor, directions: Tensor) -> Tensor:
    """The components (N, 3, clusters · (k + 1)) of all clusters at N pairs, of each its mean first.

    `mean` (3 · N,) and `directions` (3 · N, spanned) are those of `reduced_abrdfs`, on which clusters were found.
    """
    # The mean of each cluster is its first component, whose coefficient is 1: (clusters, spanned, k + 1).
    components = torch.cat([torch.from_numpy(local.means)[..., None], torch.from_numpy(local.axes)], 2)
    table = directions @ components.movedim(0, 1).flatten(1)  # (3 · N, clusters · (k + 1))
    table[:, :: components.shape[2]] += mean[:, None]  # the mean of all texels, to the first component of each cluster
    return table.unflatten(0, (-1, 3))


def _means_and_axes(points: np.ndarray, label: np.ndarray, components: int) -> tuple[np.ndarray, np.ndarray]:
    """The mean (clusters, k) of each cluster of points (n, k), and its strongest directions (clusters, k, components).

    `label` (n,) is each point's cluster. Directions are orthonormal, the strongest first.
    """
    means, axes = [], []
    for cluster in range(label.max() + 1):
        members = points[label == cluster].astype(np.float64)
        mean = members.mean(0)
        members -= mean
        _, directions = np.linalg.eigh(members.T @ members)
        means.append(mean)
        axes.append(directions[:, ::-1][:, :components])  # reversed, because the last is the strongest
    return np.stack(means).astype(np.float32), np.stack(axes).astype(np.float32)


def _squared_distances(points: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """The squared distance (n,) of points (n, k) from the span of orthonormal directions (k, components)."""
    # Pythagoras: the squared length without that within the span.
    return np.square(points).sum(1) - np.square(points @ axes).sum(1)


class LocalPCAMaterial(Material):
    """Clusters and coefficients of texels. Each texel is decoded by its cluster's components, then interpolated."""

    def __init__(self, label: Tensor, texture: Tensor, table: Tensor, interpolator: PairInterpolator, gain: float):
        """Count the cost of an answer term by term, and keep the parts.

        `label` (H · W,) is the cluster of each texel, `texture` (H, W, k) its coefficients, and `table` (N, 3,
        clusters · (k + 1)) has the components of each pair.
        """
        pairs = len(table)
        components = texture.shape[2]
        row = 3 * (components + 1)  # numbers that a cluster has of a pair
        # Of each of the four texels: its coefficients, its label, and its cluster's rows of some pairs.
        numbers_read = 4 * (components + interpolator.reads * row)
        label_bytes = 4 * label.element_size()
        # Rows are mixed over the pairs, and the mixed row is multiplied by the coefficients.
        multiply_adds = 4 * (interpolator.reads * row + row)
        cost = DecoderCost(
            texture_channels=components + 1,  # the label is one more
            texture_floats=texture.numel() + label.numel(),
            table_floats=table.numel(),
            flops_per_sample=2 * multiply_adds,
            bytes_per_sample=4 * numbers_read + label_bytes,  # numbers are float32
        )
        super().__init__((texture.shape[0], texture.shape[1]), cost)
        self.label = label
        self.coefficients = texture.flatten(0, 1)  # (H · W, k)
        self.pairs = pairs
        # (clusters · N, 3 · (k + 1)): a row for each pair of a cluster, one cluster after the other.
        of_clusters = table.unflatten(2, (-1, components + 1)).permute(2, 0, 1, 3)  # (clusters, N, 3, k + 1)
        self.table = of_clusters.flatten(0, 1).flatten(1).contiguous()
        self.interpolator = interpolator
        self.gain = gain

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        """Linear radiance (n, 3) of queries, each (n, …); see `Material`. The footprint is ignored: there is one level
        of detail.

        Each of the four texels is decoded by its own cluster; their log radiances are mixed.
        """
        texel, texel_weight = texel_corners(self.size, uv)
        pair, share = self.interpolator.shares(wo, wi)
        row = self.label[texel][..., None] * self.pairs + pair[:, None]  # (n, 4, P), of the table, for P pairs
        weight = share[:, None].expand(row.shape).to(self.table.dtype)  # (n, 4, P)
        rows = functional.embedding_bag(
            row.flatten(0, 1), self.table, per_sample_weights=weight.flatten(0, 1), mode="sum"
        )
        # Products of halves may overflow a half with either sign, so they are added in float32.
        dtype = at_least_float32(rows.dtype)
        components = saturated(rows).to(dtype).unflatten(0, row.shape[:2]).unflatten(2, (3, -1))  # (n, 4, 3, k + 1)
        # The mean's coefficient, 1, comes first. All are weighted by the texels' shares: (n, 4, k + 1).
        coefficients = functional.pad(self.coefficients[texel], (1, 0), value=1.0).to(dtype)
        coefficients *= texel_weight[..., None].to(dtype)
        level = (components * coefficients[:, :, None]).sum((1, 3)).clamp_min(0)
        return radiance_under(wi, level, self.gain, self.interpolator, pair, share)
