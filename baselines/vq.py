"""Vector quantisation: every texel points into a codebook of ABRDFs.

Tong et al. introduced the clustering of ABRDFs ("Synthesis of bidirectional texture functions on arbitrary surfaces",
2002). Stages that code the residual of earlier ones are due to Havran, Filip and Myszkowski ("Bidirectional texture
function compression based on multi-level vector quantization", Computer Graphics Forum 29(1), 2010).

A *code* is an entry of a *stage*'s codebook, (N, 3) of N pairs; a *label* is the number of a texel's code in a stage,
hence also of its cluster. A texel's log ABRDF is about the sum of its codes, one of each stage.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from baselines.clusters import BLOCK_BYTES, MOST_CODES, cluster_labels, pack_index, reduced_abrdfs, unpack_index
from baselines.components import probed_texels, probed_values, radiance_under
from bench.btf import BTF
from bench.codec import Codec, Fit, Parts
from bench.directions.interpolation import PairInterpolator, pack_layout, picture_of_pairs, unpack_layout
from bench.inputs.settings import Count, Range
from bench.material import DecoderCost, Material, saturated, texel_corners
from bench.training import Bits, Rounding, gain_of, load_table, round_after, store_table
from bench.training.svd import blocks

MOST_LABELS = 1 << 24  # of all stages, if their indices hold fewer: an index into a codebook of one entry has no bytes
MOST_CODES_AS_CHANNELS = 64  # codes that are stored as channels of one picture: many take minutes to write


class VQ(Codec):
    """Vector quantisation of the log ABRDFs: an index image and a codebook, found by k-means.

    @article{havran2010bidirectional,
      author = {Havran, Vlastimil and Filip, Jiří and Myszkowski, Karol},
      title = {Bidirectional Texture Function Compression Based on Multi-Level Vector Quantization},
      journal = {Computer Graphics Forum},
      volume = {29},
      number = {1},
      pages = {175--190},
      year = {2010},
      doi = {10.1111/j.1467-8659.2009.01585.x}
    }
    """

    name, version = "vq", 4
    interpolates, sizes = True, ("codes",)

    @dataclass(frozen=True)
    class Settings:
        codes: Annotated[int, Range(1, MOST_CODES)] = 32  # entries of a stage's codebook, at most the distinct texels
        stages: Annotated[int, Range(1, 64)] = 1  # number of codebooks; each further one codes the residual
        components: Count = 16  # principal components that the clustering sees
        bits: Bits = 0  # bits of a number of the stored codebook on average; 0: chosen by the data; 16, 32: floats

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        """Store the codebooks (V, L, codes of all stages, 3) of N = V · L pairs, one after the other, and of each stage
        an index, the labels (H · W,). More than `MOST_CODES_AS_CHANNELS` codes are stored as (codes, N, 1, 3)."""
        gain = gain_of(btf, fit)
        labels = self._labels(btf, gain, fit)
        counts = [int(label.max()) + 1 for label in labels]  # entries of each stage's codebook
        rows = torch.from_numpy(np.stack(labels, 1)) + _starts(counts)  # (texels, stages), rows of the codebook
        codebook = torch.cat(_codebooks(btf, gain, labels, fit))
        pairs, values = probed_values(btf, fit, gain)
        rounding = self._rounding(codebook, rows, pairs, values)
        indices: dict[str, Tensor] = {}
        for stage, (label, count) in enumerate(zip(labels, counts, strict=True)):
            indices[f"index{stage}"] = pack_index(label, count)
        other = {
            "gain": torch.tensor([gain]),
            "size": torch.tensor(btf.shape, dtype=torch.int32),
            "codes": torch.tensor(counts, dtype=torch.int32),
            **pack_layout(btf.layout),
        }
        if len(codebook) <= MOST_CODES_AS_CHANNELS:  # entries lie side by side, so that one predicts the next
            table = codebook.transpose(0, 1).unflatten(0, picture_of_pairs(btf.layout))
        else:
            table = codebook[:, :, None]  # (codes, N, 1, 3)
        decoder = store_table("codebook", table, rounding, axis=3)
        return Parts(decoder=decoder, texture=indices, other=other)

    def _labels(self, btf: BTF, gain: float, fit: Fit) -> list[np.ndarray]:
        """Of each stage the cluster (texels,) of each texel. A stage sees what is left after the earlier ones: each
        point without the mean of its cluster."""
        _, _, points = reduced_abrdfs(btf, gain, self.settings.components, fit)
        labels: list[np.ndarray] = []
        for stage in fit.progress(range(self.settings.stages), "clustering"):
            label = cluster_labels(points, self.settings.codes, fit.seed + stage)  # a seed of its own
            points = points - _means(points, label)[label]
            labels.append(label)
        return labels

    def _rounding(self, codebook: Tensor, rows: Tensor, pairs: Tensor, values: Tensor) -> Rounding:
        """How a codebook (codes, N, 3) is rounded, by the errors in the values (3 · P, texels) of P probed `pairs`.

        `rows` (texels, stages) are the texels' rows of the codebook.
        """
        some_texels = probed_texels(len(rows))
        target = values[:, some_texels].T.cpu()  # (n, 3 · P)

        def answers(book: Tensor) -> Tensor:
            """Log radiance (n, 3 · P) of n probed texels, from a codebook (codes, P, 3) of P probed pairs."""
            of_stages = book[rows[some_texels]]  # (n, stages, P, 3)
            return of_stages.sum(1).flatten(1)

        return round_after(codebook[:, pairs], self.settings.bits, answers, target).fit_to(codebook)

    def decode(self, parts: Parts, device: torch.device) -> Material:
        """The material of a file's parts, on a device. `ValueError` if labels and codebook do not fit."""
        height, width = parts.other["size"].tolist()
        counts = parts.other["codes"].tolist()
        index_bytes = sum(packed.numel() for name, packed in parts.texture.items() if name.startswith("index"))
        # A label takes at least a bit. Only those of a stage of one code take none, so an altered file could claim any
        # number of them: hence the limit.
        if height * width * len(counts) > max(MOST_LABELS, 8 * index_bytes):
            raise ValueError(f"an index of {index_bytes} bytes for {height} × {width} texels and {len(counts)} stages")
        labels = []
        for stage, count in enumerate(counts):
            labels.append(unpack_index(parts.texture[f"index{stage}"], height * width, count))
        rows = torch.stack(labels, 1) + _starts(counts)  # (texels, stages)
        table = load_table("codebook", parts.decoder, axis=3)
        if sum(counts) <= MOST_CODES_AS_CHANNELS:
            codebook = table.flatten(0, 1).transpose(0, 1)  # (codes, N, 3)
        else:
            codebook = table.flatten(2)
        gain = float(parts.other["gain"])
        if min(counts) < 1 or len(codebook) != sum(counts) or codebook.shape[2] != 3:
            raise ValueError(f"a codebook of {len(codebook)} entries for stages of {counts}")
        interpolator = PairInterpolator(unpack_layout(parts.other, codebook.shape[1]))
        return VQMaterial((height, width), rows, codebook, interpolator, gain).to(device)


class VQMaterial(Material):
    """Of each texel the rows (H · W, stages) of a codebook (codes, N, 3) of log ABRDFs, whose sum is its log ABRDF.

    Answers are bilinear over texels, and interpolated over pairs.
    """

    def __init__(
        self, size: tuple[int, int], rows: Tensor, codebook: Tensor, interpolator: PairInterpolator, gain: float
    ):
        """Count the cost of an answer, and keep the parts."""
        stages = rows.shape[1]
        labels_read = 4 * stages  # of four texels
        numbers_read = labels_read * interpolator.reads * 3  # of the codebook: three colours of some pairs
        cost = DecoderCost(
            texture_channels=stages,
            texture_floats=rows.numel(),
            table_floats=codebook.numel(),
            flops_per_sample=2 * numbers_read,  # each is multiplied and added
            bytes_per_sample=labels_read * rows.element_size() + numbers_read * codebook.element_size(),
        )
        super().__init__(size, cost)
        self.rows = rows
        self.pairs = codebook.shape[1]
        self.codebook = codebook.flatten(0, 1)  # (codes · N, 3)
        self.interpolator = interpolator
        self.gain = gain

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        """Linear radiance (n, 3) of queries, each (n, …); see `Material`. The footprint is ignored: there is one level
        of detail.

        Log radiance is a weighted sum over four texels, all stages and some pairs, in one look-up.
        """
        texel, texel_weight = texel_corners(self.size, uv)
        pair, share = self.interpolator.shares(wo, wi)
        row = self.rows[texel][..., None] * self.pairs + pair[:, None, None]  # (n, 4, stages, P)
        # A stage's weight is 1, because the codes of all stages are added.
        weight = texel_weight[:, :, None, None].to(share.dtype) * share[:, None, None]  # (n, 4, 1, P)
        weight = weight.expand(row.shape).to(self.codebook.dtype).flatten(1)  # (n, 4 · stages · P)
        weighted_sum = functional.embedding_bag(row.flatten(1), self.codebook, per_sample_weights=weight, mode="sum")
        level = saturated(weighted_sum).to(share.dtype).clamp_min(0)  # shares in halves may add up to more than 1
        return radiance_under(wi, level, self.gain, self.interpolator, pair, share)


def _starts(counts: list[int]) -> Tensor:
    """The row (stages,) of the codebook at which each stage's entries start, from the count of each stage's entries."""
    return torch.tensor(counts).cumsum(0) - torch.tensor(counts)


def _means(points: np.ndarray, label: np.ndarray) -> np.ndarray:
    """The mean (codes, k) of the points (n, k) of each cluster; `label` (n,) is each point's, none is empty."""
    sums = np.zeros((label.max() + 1, points.shape[1]), points.dtype)
    np.add.at(sums, label, points)
    return sums / np.bincount(label)[:, None]


def _codebooks(btf: BTF, gain: float, labels: list[np.ndarray], fit: Fit) -> list[Tensor]:
    """The codebook (codes, N, 3) of each stage: the mean log ABRDF of a code's members, less what earlier stages give.

    `labels` has for each stage the cluster (texels,) of each texel.
    """
    member_counts = [torch.from_numpy(np.bincount(label)) for label in labels]  # of each stage, (codes,)
    device_labels = [torch.from_numpy(label).to(fit.device) for label in labels]
    # Of each stage the sum of each cluster's ABRDFs, (codes, 3 · N), filled block by block.
    sums = [torch.empty(len(counts), 3 * len(btf)) for counts in member_counts]
    start = 0
    for block in blocks(btf, fit, "codebook", gain, BLOCK_BYTES):  # (rows, texels), a row a channel of a pair
        for label, stage_sums in zip(device_labels, sums, strict=True):
            block_sums = torch.zeros(len(stage_sums), len(block), device=fit.device)
            block_sums.index_add_(0, label, block.T)
            stage_sums[:, start : start + len(block)] = block_sums.cpu()
        start += len(block)
    books: list[Tensor] = []
    for stage, counts in enumerate(member_counts):
        book = sums[stage] / counts[:, None]  # the means
        for earlier in range(stage):
            # The earlier stage gives a cluster the mean of its members' codes there.
            # How many members of each cluster are in each cluster of the earlier stage, then which share of them.
            members_in_common = np.zeros((len(counts), len(member_counts[earlier])), np.float32)
            np.add.at(members_in_common, (labels[stage], labels[earlier]), 1)
            shares = torch.from_numpy(members_in_common) / counts[:, None]
            book = book - shares @ books[earlier].flatten(1)
        books.append(book.reshape(len(counts), -1, 3))
    return books
