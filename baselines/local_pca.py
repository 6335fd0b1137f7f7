"""Local PCA (Müller, Meseth and Klein, "Compression and real-time rendering of measured BTFs using local PCA", 2003).

Clusters are those of Kambhatla and Leen ("Dimension reduction by local principal component analysis", Neural
Computation 9(7), 1997): from k-means on, each texel moves to the cluster whose components give it the least error.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from baselines.clusters import clustered, pack_index, reduced, unpack_index
from baselines.components import PROBED_TEXELS, probed
from bench.btf import BTF
from bench.codec import Codec, Fit, Parts
from bench.directions.interpolation import PairInterpolator, pack_layout, unpack_layout
from bench.inputs.settings import Count, Range
from bench.material import DecoderCost, Material, at_least_float32, saturated, texel_corners, to_radiance
from bench.training import Bits, gain_of, load_texture, round_after, store_texture

SPANNED = 64  # principal components of all texels, in which the clusters' means and components are found
ROUNDS = 30  # of moving texels and finding components; most fits end earlier


class LocalPCA(Codec):
    """Local PCA: clusters of ABRDFs, each with principal components of its own, interpolated over directions.

    Cited as `pca`.
    """

    name, version = "local-pca", 1
    interpolates, sizes = True, ("components", "clusters")

    @dataclass(frozen=True)
    class Settings:
        clusters: Annotated[int, Range(1, 4096)] = 4  # groups of texels; fewer if the texels are fewer
        components: Count = 4  # of each cluster, beside its mean
        bits: Bits = 0  # bits of a stored number on average; 0: chosen by the data; 16, 32: floats

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        """Coefficients (H, W, k), each texel's cluster, and components (N, 3, clusters · (k + 1)), each mean first."""
        gain = gain_of(btf, fit)
        settings = self.settings
        mean, directions, points = reduced(btf, gain, max(SPANNED, settings.components), fit)
        found = local_components(points, settings.clusters, settings.components, fit.seed)
        count = len(found.means)
        components = found.axes.shape[2]
        # The mean of each cluster is its first component, whose coefficient is 1.
        own = torch.cat([torch.from_numpy(found.means)[..., None], torch.from_numpy(found.axes)], 2)
        table = directions @ own.movedim(0, 1).flatten(1)  # (3 · pairs, clusters · (components + 1))
        table[:, :: components + 1] += mean[:, None]  # to the first component of each cluster, its mean
        table = table.unflatten(0, (-1, 3))  # (pairs, 3, clusters · (components + 1))
        texture = torch.from_numpy(found.coefficients).unflatten(0, btf.shape)  # (H, W, components)

        label = torch.from_numpy(found.label)
        pairs, values = probed(btf, fit, gain)
        # Every so many texels, rounded up, so that at most `PROBED_TEXELS` are taken, evenly.
        some = slice(None, None, -(-len(label) // PROBED_TEXELS))
        mine = label[some]  # (n,)
        seen = texture.flatten(0, 1)[some]  # (n, k)
        target = values[:, some].cpu()  # (3 · P, n)

        def answers(table: Tensor, coefficients: Tensor) -> Tensor:
            """Log radiance (3 · P, n) of a table (P, 3, clusters · (k + 1)) and the coefficients (n, k) of `some`."""
            rows = table.flatten(0, 1).unflatten(1, (count, -1))[:, mine]  # (3 · P, n, k + 1)
            return (rows * functional.pad(coefficients, (1, 0), value=1.0)).sum(2)

        of_table = round_after(table[pairs], settings.bits, lambda each: answers(each, seen), target)
        of_texture = round_after(seen, settings.bits, lambda each: answers(table[pairs], each), target)
        stored = store_texture("coefficients", texture, of_texture.fit_to(texture))
        return Parts(
            decoder=store_texture("components", table, of_table.fit_to(table)),
            texture=stored | {"clusters": pack_index(found.label, count)},
            other={"gain": torch.tensor([gain]), "count": torch.tensor([count]), **pack_layout(btf.layout)},
        )

    def decode(self, parts: Parts, device: torch.device) -> Material:
        texture = load_texture("coefficients", parts.texture)
        table = load_texture("components", parts.decoder)
        count = int(parts.other["count"])
        height, width, components = texture.shape
        if count < 1 or table.ndim != 3 or table.shape[2] != count * (components + 1):
            raise ValueError(f"components {tuple(table.shape)} for {count} clusters and {components} coefficients")
        label = unpack_index(parts.texture["clusters"], height * width, count)
        interpolator = PairInterpolator(unpack_layout(parts.other, len(table)))
        return LocalPCAMaterial(label, texture, table, interpolator, float(parts.other["gain"])).to(device)


@dataclass(frozen=True)
class LocalComponents:
    """Of each cluster a mean and orthogonal components; of each point its cluster and its coefficients (at most 1)."""

    means: np.ndarray  # (clusters, k)
    axes: np.ndarray  # (clusters, k, components)
    label: np.ndarray  # (n,)
    coefficients: np.ndarray  # (n, components)


def local_components(points: np.ndarray, clusters: int, components: int, seed: int) -> LocalComponents:
    """Clusters of points (n, k), float32, and the components of each, by turns until no point moves."""
    components = min(components, points.shape[1])
    label = clustered(points, clusters, seed)
    for _ in range(ROUNDS):
        means, axes = _fitted(points, label, components)
        # Errors (clusters, n), of which each point takes the least.
        moved = np.stack([_error(points - mean, axis) for mean, axis in zip(means, axes, strict=True)]).argmin(0)
        moved = np.unique(moved, return_inverse=True)[1]  # numbered without gaps
        if np.array_equal(moved, label):
            break
        label = moved
    means, axes = _fitted(points, label, components)
    coefficients = np.einsum("nk,nkc->nc", points - means[label], axes[label])
    peak = np.abs(coefficients).max(0, initial=0)
    peak[peak == 0] = 1
    # Coefficients are divided by the largest of their component, which is multiplied by it instead.
    return LocalComponents(means, axes * peak, label, coefficients / peak)


def _fitted(points: np.ndarray, label: np.ndarray, components: int) -> tuple[np.ndarray, np.ndarray]:
    """The mean (clusters, k) of each cluster, and its strongest directions (clusters, k, components), unit vectors."""
    means, axes = [], []
    for cluster in range(label.max() + 1):
        members = points[label == cluster].astype(np.float64)
        means.append(members.mean(0))
        members -= means[-1]
        _, directions = np.linalg.eigh(members.T @ members)
        axes.append(directions[:, ::-1][:, :components])  # reversed, because the last is the strongest
    return np.stack(means).astype(np.float32), np.stack(axes).astype(np.float32)


def _error(points: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """The squared distance (n,) of points (n, k) from the span of orthonormal directions (k, components)."""
    # Pythagoras: the squared length without that within the span.
    return np.square(points).sum(1) - np.square(points @ axes).sum(1)


class LocalPCAMaterial(Material):
    """Clusters (H · W) and coefficients (H, W, k) of texels, each decoded by its own components, then bilinear.

    Components of pairs are (N, 3, clusters · (k + 1)).
    """

    def __init__(self, label: Tensor, texture: Tensor, table: Tensor, interpolator: PairInterpolator, gain: float):
        pairs = len(table)
        components = texture.shape[2]
        row = 3 * (components + 1)  # numbers that a cluster has of a pair
        cost = DecoderCost(
            texture_channels=components + 1,
            texture_floats=texture.numel() + label.numel(),
            table_floats=table.numel(),
            flops_per_sample=4 * 2 * row * (interpolator.reads + 1),
            bytes_per_sample=4 * (4 * (components + interpolator.reads * row) + label.element_size()),
        )
        super().__init__((texture.shape[0], texture.shape[1]), cost)
        self.label = label
        self.coefficients = texture.flatten(0, 1)
        self.pairs = pairs
        # (clusters · N, 3 · (k + 1)): a row for each pair of a cluster, one cluster after the other.
        self.table = table.unflatten(2, (-1, components + 1)).permute(2, 0, 1, 3).flatten(0, 1).flatten(1).contiguous()
        self.interpolator = interpolator
        self.gain = gain

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        """Each of the four texels is decoded by its own cluster; their log radiances are mixed."""
        texel, texel_weight = texel_corners(self.size, uv)
        pair, share = self.interpolator.shares(wo, wi)
        row = self.label[texel][..., None] * self.pairs + pair[:, None]  # (n, 4, P)
        weight = share[:, None].expand(row.shape).to(self.table.dtype)  # (n, 4, P)
        rows = functional.embedding_bag(
            row.flatten(0, 1), self.table, per_sample_weights=weight.flatten(0, 1), mode="sum"
        )
        # Products of halves may overflow a half with either sign, so they are added in float32.
        dtype = at_least_float32(rows.dtype)
        numbers = saturated(rows).to(dtype).unflatten(0, row.shape[:2]).unflatten(2, (3, -1))  # (n, 4, 3, k + 1)
        known = functional.pad(self.coefficients[texel], (1, 0), value=1.0).to(dtype)  # (n, 4, k + 1)
        known *= texel_weight[..., None].to(dtype)
        level = (numbers * known[:, :, None]).sum((1, 3)).clamp_min(0)
        return to_radiance(level, self.gain) * (wi[:, 2:] / self.interpolator.mean_cosine(pair, share, level))
