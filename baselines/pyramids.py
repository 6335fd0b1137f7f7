"""A texture and its coarser levels in one table, fetched trilinearly, and a step of a fit to all levels of detail.

A *table* (rows, C) holds the texels of all levels, the finest first, a row a texel, row by row of each level. A
*sample* is the radiance of one texel of a level at one pair.
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional

from bench.btf import BTF
from bench.codec import Fit
from bench.machine.devices import is_gpu
from bench.material import sample_texture
from bench.training import Batch, Samples

Queries = tuple[Tensor, Tensor, Tensor, Tensor]  # uv (n, 2) in [0, 1], wo and wi (n, 3), level of detail (n,)


def level_count(size: tuple[int, int]) -> int:
    """The number of levels over a picture of `size` (H, W): each halves both sides, but not below a texel."""
    return int(math.log2(min(size))) + 1


def level_of(footprint: Tensor, side: int, count: int) -> Tensor:
    """The level (n,), a float, of footprints (n,): log2 of their side in finest texels, within the `count` levels.

    Footprints are shares of the picture's longer side, which has `side` texels.
    """
    return (footprint.float() * side).log2().clamp(0, count - 1)


def fitted_level_count(btf: BTF, fit: Fit, count: int) -> int:
    """The number of levels of detail that are fitted: all `count`, or in a fit to a scene those that it sees."""
    return min(count, fit.density.levels(max(btf.shape))) if fit.density else count


def drawn_samples(
    levels: Sequence[Samples], count: int, coarse_one_in: int, generator: torch.Generator
) -> tuple[Queries, Tensor, Tensor]:
    """`count` random samples: their queries, their targets (count, 3) of log radiance, and their pairs (count,).

    `levels` are the samples of each level. If there are coarser ones, one sample in `coarse_one_in` is of one of them,
    which is drawn once for all.
    """
    coarse_count = count // coarse_one_in if len(levels) > 1 else 0
    batches = [levels[0].draw(count - coarse_count, generator)]
    queries = [queries_of(levels, 0, batches[0])]
    if coarse_count:
        level = int(torch.randint(1, len(levels), (), generator=generator))
        batches.append(levels[level].draw(coarse_count, generator))
        queries.append(queries_of(levels, level, batches[1]))
    uv, wo, wi, level_of_detail = zip(*queries, strict=True)  # of each the tensors of all batches
    target = torch.cat([batch.target for batch in batches])
    pair = torch.cat([batch.pair for batch in batches])
    return (torch.cat(uv), torch.cat(wo), torch.cat(wi), torch.cat(level_of_detail)), target, pair


def queries_of(levels: Sequence[Samples], level: int, batch: Batch) -> Queries:
    """The queries of a batch of samples of a level, an index into `levels`, which are the samples of all.

    A texel of the level is a box of finest texels. The finest picture may end with texels that fill no box, so places
    are counted in boxes from its top left corner.
    """
    samples = levels[level]
    factor = 2**level  # finest texels a side of one of the level
    height, width = levels[0].shape
    row = batch.texel.div(samples.shape[1], rounding_mode="floor")
    col = batch.texel - row * samples.shape[1]
    u = (col + 0.5) * (factor / width)
    v = 1 - (row + 0.5) * (factor / height)  # rows count downwards
    uv = torch.stack([u, v], 1)
    return uv, samples.wo[batch.pair], samples.wi[batch.pair], torch.full_like(batch.texel, level)


class Levels(nn.Module):
    """The layout of some levels in one table, the finest first: level i has (H // 2ⁱ, W // 2ⁱ) texels."""

    def __init__(self, size: tuple[int, int], levels: int):
        """Lay out so many `levels` of a picture of `size` (H, W)."""
        super().__init__()
        self.level_sizes = [(size[0] >> level, size[1] >> level) for level in range(levels)]  # (rows, columns) of each
        self.counts = counts = [height * width for height, width in self.level_sizes]  # texels of each
        self.side = max(size)
        starts = [sum(counts[:i]) for i in range(levels)]  # the row of each level's first texel
        self.sizes = nn.Buffer(torch.tensor(self.level_sizes), persistent=False)  # (levels, 2)
        self.starts = nn.Buffer(torch.tensor(starts), persistent=False)  # (levels,)

    def level(self, footprint: Tensor) -> Tensor:
        """The level (n,), a float, of footprints (n,): see `level_of`."""
        return level_of(footprint, self.side, len(self.level_sizes))

    def corners(self, uv: Tensor, level: Tensor) -> tuple[Tensor, Tensor]:
        """Rows of the table (n, 4) and bilinear weights (n, 4) around uv (n, 2), at levels (n,) of an integer type.

        `bench.btf` says where texels lie in uv.
        """
        size = self.sizes[level]  # (n, 2), as all pairs of row and column here
        # The place in texels; whole numbers are texel centres. Half precision cannot address texels, so places are
        # computed in float32 for any dtype.
        place = torch.stack([1 - uv[:, 1].float(), uv[:, 0].float()], 1) * size - 0.5
        floor = place.detach().floor()
        shares = place - floor  # of the way to the next texel
        first = floor.long()  # row and column of the texel at the upper left
        top, left = first.remainder(size).unbind(1)
        bottom, right = (first + 1).remainder(size).unbind(1)
        down, across = shares.unbind(1)  # the shares of the lower row and of the right column
        start = self.starts[level]
        width = size[:, 1]
        upper, lower = start + top * width, start + bottom * width  # the row of the table of each row's first texel
        index = torch.stack([upper + left, upper + right, lower + left, lower + right], 1)
        up, back = 1 - down, 1 - across  # the shares of the upper row and of the left column
        weight = torch.stack([up * back, up * across, down * back, down * across], 1)
        return index, weight

    def around(self, uv: Tensor, level: Tensor) -> tuple[Tensor, Tensor]:
        """Rows of the table and their weights around uv (n, 2) at levels (n,).

        Levels of an integer type have four rows each, (n, 4). Floats may lie between two levels: (n, 8), four rows of
        the finer, then four of the coarser.
        """
        finer = level.long()
        index, weight = self.corners(uv, finer)
        if level.is_floating_point():
            share = (level - finer)[:, None]  # of the way to the coarser level
            # The coarsest level has no coarser one; the share of that is 0.
            coarser = (finer + 1).clamp_max(len(self.level_sizes) - 1)
            coarser_index, coarser_weight = self.corners(uv, coarser)
            index = torch.cat([index, coarser_index], 1)
            weight = torch.cat([weight * (1 - share), coarser_weight * share], 1)
        return index, weight


def mixed_rows(table: Tensor, index: Tensor, weight: Tensor) -> Tensor:
    """The sums (n, C) of rows of a table (rows, C), of k rows `index` (n, k) each, times their weights (n, k).

    It is for a fit: an embedding bag's gradient takes more than twice as long.
    """
    corners = table.index_select(0, index.flatten()).unflatten(0, index.shape)  # (n, k, C)
    return (corners * weight[..., None].to(table.dtype)).sum(1)


def sample_levels(levels: Levels, table: Tensor, uv: Tensor, level: Tensor) -> Tensor:
    """Values (n, C) of a table (rows, C) at uv (n, 2) and levels (n,), for answers, which need no gradient.

    If all levels are the finest, it is one bilinear fetch.
    """
    # A recording and a GPU take no branch: the first cannot, the second would have to wait for `level.any()`.
    can_branch = not (torch.compiler.is_exporting() or is_gpu(uv.device))
    if can_branch and not level.any():
        finest = table[: levels.counts[0]].unflatten(0, levels.level_sizes[0])  # (H, W, C)
        return sample_texture(finest, uv)
    index, weight = levels.around(uv, level)
    return functional.embedding_bag(index, table, per_sample_weights=weight.to(table.dtype), mode="sum")


class Pyramid(Levels):
    """A texture and its box-filtered levels; a file holds only the finest."""

    def __init__(self, size: tuple[int, int]):
        """Lay out all levels of a picture of `size` (H, W)."""
        super().__init__(size, level_count(size))

    def table(self, finest: Tensor) -> Tensor:
        """The table (rows, C) of all levels of a texture (H · W, C), each the means of 2 × 2 texels of the last."""
        picture = finest.reshape(1, *self.level_sizes[0], -1).permute(0, 3, 1, 2)  # (1, C, H, W)
        tables = [finest]
        for _ in self.level_sizes[1:]:
            picture = functional.avg_pool2d(picture, 2)
            tables.append(picture[0].flatten(1).T)
        return torch.cat(tables)

    def fetch(self, table: Tensor, uv: Tensor, level: Tensor) -> Tensor:
        """Values (n, C) of a table (rows, C) at uv (n, 2) in [0, 1], bilinear, periodic, and linear between two levels.

        Levels (n,) are floats or of an integer type: see `around`.
        """
        if not (table.requires_grad or uv.requires_grad):
            return sample_levels(self, table, uv, level)
        return mixed_rows(table, *self.around(uv, level))  # the gradient of `sample_levels` would take longer
