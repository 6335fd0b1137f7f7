"""Vector quantisation: every texel points into a codebook of ABRDFs.

Tong et al. introduced the clustering of ABRDFs ("Synthesis of bidirectional texture functions on arbitrary surfaces",
2002). Stages that code the residual of earlier ones are due to Havran, Filip and Myszkowski ("Bidirectional texture
function compression based on multi-level vector quantization", Computer Graphics Forum 29(1), 2010).
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from baselines.clusters import MOST_CODES, clustered, pack_index, reduced, unpack_index
from baselines.components import PROBED_TEXELS, probed
from bench.btf import BTF
from bench.codec import Codec, Fit, Parts
from bench.directions.interpolation import PairInterpolator, pack_layout, unpack_layout
from bench.inputs.settings import Count, Range
from bench.material import DecoderCost, Material, saturated, texel_corners, to_radiance
from bench.training import Bits, gain_of, load_texture, round_after, store_texture
from bench.training.svd import blocks

BLOCK_BYTES = 64 << 20  # slices read together
MOST_LABELS = 1 << 24  # of all stages, if fewer are stored: the index of a one-entry codebook takes no bytes


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

    name, version = "vq", 3
    interpolates, sizes = True, ("codes",)

    @dataclass(frozen=True)
    class Settings:
        codes: Annotated[int, Range(1, MOST_CODES)] = 32  # entries of a stage's codebook, at most the distinct texels
        stages: Annotated[int, Range(1, 64)] = 1  # number of codebooks; each further one codes the residual
        components: Count = 16  # principal components that the clustering sees
        bits: Bits = 0  # bits of a number of the stored codebook on average; 0: chosen by the data; 16, 32: floats

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        """The codebooks (codes of all stages, N, 3), one after the other, and an index (H · W) of each stage."""
        gain = gain_of(btf, fit)
        points = reduced(btf, gain, self.settings.components, fit)[2]
        labels = []
        for stage in fit.progress(range(self.settings.stages), "clustering"):
            # A stage sees what is left after the earlier ones: each point without the mean of its cluster.
            labels.append(clustered(points, self.settings.codes, fit.seed + stage))
            points = points - _means(points, labels[-1])[labels[-1]]
        counts = [int(label.max()) + 1 for label in labels]
        books = _codebooks(btf, gain, labels, fit)
        # Where each stage's entries start: the sum of all counts before its own.
        starts = torch.tensor(counts).cumsum(0) - torch.tensor(counts)
        rows = torch.from_numpy(np.stack(labels, 1)) + starts  # (texels, stages), rows of the codebook
        codebook = torch.cat(books)
        pairs, values = probed(btf, fit, gain)
        # Every so many texels, rounded up, so that at most `PROBED_TEXELS` are taken, evenly.
        some = slice(None, None, -(-len(rows) // PROBED_TEXELS))
        target = values[:, some].T.cpu()  # (n, 3 · P)
        bits = self.settings.bits
        # The lambda looks up (n, stages, P, 3).
        rounding = round_after(codebook[:, pairs], bits, lambda book: book[rows[some]].sum(1).flatten(1), target)
        size, codes = (torch.tensor(numbers, dtype=torch.int32) for numbers in (btf.shape, counts))
        return Parts(
            decoder=store_texture("codebook", codebook, rounding.fit_to(codebook)),
            texture={f"index{s}": pack_index(*each) for s, each in enumerate(zip(labels, counts, strict=True))},
            other={"gain": torch.tensor([gain]), "size": size, "codes": codes, **pack_layout(btf.layout)},
        )

    def decode(self, parts: Parts, device: torch.device) -> Material:
        height, width = parts.other["size"].tolist()
        counts = parts.other["codes"].tolist()
        stored = sum(packed.numel() for name, packed in parts.texture.items() if name.startswith("index"))
        # A label takes at least a bit, but for the labels of a stage of one code: an altered file could ask for any.
        if height * width * len(counts) > max(MOST_LABELS, 8 * stored):
            raise ValueError(f"an index of {stored} bytes for {height} × {width} texels and {len(counts)} stages")
        index = [unpack_index(parts.texture[f"index{s}"], height * width, count) for s, count in enumerate(counts)]
        starts = torch.tensor(counts).cumsum(0) - torch.tensor(counts)
        rows = torch.stack(index, 1) + starts  # (texels, stages)
        codebook = load_texture("codebook", parts.decoder)
        gain = float(parts.other["gain"])
        if min(counts) < 1 or len(codebook) != sum(counts):
            raise ValueError(f"a codebook of {len(codebook)} entries for stages of {counts}")
        interpolator = PairInterpolator(unpack_layout(parts.other, codebook.shape[1]))
        return VQMaterial((height, width), rows, codebook, interpolator, gain).to(device)


class VQMaterial(Material):
    """Rows (H · W, stages) of a codebook (codes, N, 3) of log ABRDFs: bilinear over texels, interpolated over pairs."""

    def __init__(
        self, size: tuple[int, int], rows: Tensor, codebook: Tensor, interpolator: PairInterpolator, gain: float
    ):
        stages = rows.shape[1]
        values = 4 * stages * interpolator.reads * 3  # that a query reads
        cost = DecoderCost(
            texture_channels=stages,
            texture_floats=rows.numel(),
            table_floats=codebook.numel(),
            flops_per_sample=2 * values,
            bytes_per_sample=4 * stages * rows.element_size() + values * codebook.element_size(),
        )
        super().__init__(size, cost)
        self.rows = rows
        self.pairs = codebook.shape[1]
        self.codebook = codebook.flatten(0, 1)  # (codes · N, 3)
        self.interpolator = interpolator
        self.gain = gain

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        """The weighted sum of log radiance over four texels, all stages and some pairs, in one look-up."""
        texel, texel_weight = texel_corners(self.size, uv)
        pair, share = self.interpolator.shares(wo, wi)
        row = self.rows[texel][..., None] * self.pairs + pair[:, None, None]  # (n, 4, stages, P)
        weight = texel_weight[:, :, None, None].to(share.dtype) * share[:, None, None]
        weight = weight.expand(row.shape).to(self.codebook.dtype).flatten(1)  # (n, 4 · stages · P)
        mixed = functional.embedding_bag(row.flatten(1), self.codebook, per_sample_weights=weight, mode="sum")
        level = saturated(mixed).to(share.dtype).clamp_min(0)  # shares in halves may add up to more than 1
        return to_radiance(level, self.gain) * (wi[:, 2:] / self.interpolator.mean_cosine(pair, share, level))


def _means(points: np.ndarray, label: np.ndarray) -> np.ndarray:
    """The mean (codes, k) of the points (n, k) of each cluster."""
    sums = np.zeros((label.max() + 1, points.shape[1]), points.dtype)
    np.add.at(sums, label, points)
    return sums / np.bincount(label)[:, None]


def _codebooks(btf: BTF, gain: float, labels: list[np.ndarray], fit: Fit) -> list[Tensor]:
    """The codebook (codes, N, 3) of each stage: the mean of its members, less the answers of earlier stages.

    `labels` holds the cluster (n,) of each texel, of each stage.
    """
    counts = [torch.from_numpy(np.bincount(label)) for label in labels]
    rows = [torch.from_numpy(label).to(fit.device) for label in labels]
    sums = [torch.empty(len(count), 3 * len(btf)) for count in counts]
    start = 0
    for block in blocks(btf, fit, "codebook", gain, BLOCK_BYTES):
        for row, out in zip(rows, sums, strict=True):
            part = torch.zeros(len(out), len(block), device=fit.device)
            part.index_add_(0, row, block.T)  # a block has a row a channel of a pair, a column a texel
            out[:, start : start + len(block)] = part.cpu()
        start += len(block)
    books: list[Tensor] = []
    for stage, (out, count) in enumerate(zip(sums, counts, strict=True)):
        book = out / count[:, None]
        for earlier in range(stage):
            # How many members of each cluster are in each cluster of the earlier stage, then which share of them.
            members = np.zeros((len(count), len(counts[earlier])), np.float32)
            np.add.at(members, (labels[stage], labels[earlier]), 1)
            shares = torch.from_numpy(members) / count[:, None]
            book = book - shares @ books[earlier].flatten(1)
        books.append(book.reshape(len(count), -1, 3))
    return books
