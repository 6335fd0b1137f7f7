"""Scores materials in a scene: compares frames of the decoded material with those of the reference table.

A frame is the sum of the answers to a demand by pixel. The reference table is the BTF. Its radiance is interpolated
over directions as in `bench.directions.interpolation`, and over the texture in a pyramid of box filters: bilinear and
periodic within the two levels around a footprint, linear between them.
"""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import torch

from bench import metrics, records
from bench.btf import BTF, Array, box_filter
from bench.codec import Progress, silent
from bench.demand.demand import Demand
from bench.demand.needed_part import pair_shares, pair_weights
from bench.material import Material, sample_texture
from bench.metrics.angular import as_number
from bench.metrics.base import Prepared, SliceMetric
from bench.metrics.display import exposure_of, to_display

NAMES = metrics.chosen_names(metrics.DEFAULTS, periodic=False)  # a frame has borders
PROBED = 1024  # queries that tell whether a material filters
KEPT_FRAMES, KEPT_SIDE = 3, 320  # frames that a run stores, and pixels along their longer side, at most
PSNR, FLIP = (metrics.metric_of(NAMES, family) for family in (records.PSNR, records.FLIP))


def table_of(btf: BTF) -> BTF:
    """The reference table of a BTF: all of it if its pairs form a product, else its training pairs. Held-out pairs
    scattered between the others would make the interpolated table uneven."""
    if btf.layout.grid is not None:
        return btf
    return btf.subset(btf.split().train)


def truth(btf: BTF, demand: Demand, show: Progress = silent) -> Array:
    """Linear radiance (n, 3) float32, not negative, for the queries of a demand. Each slice is read at most once."""
    weights = pair_weights(btf.layout, demand, radiance=True)
    around = weights.sample.shape[1]  # pairs around each query
    # A row for each pair around each query, (n · around,): row r belongs to query r // around.
    pair = weights.sample.numpy().ravel()
    weight = weights.weight.numpy().ravel()
    used = np.flatnonzero(weight > 0)
    used = used[np.argsort(pair[used], kind="stable")]  # the rows of one pair stand together
    starts = np.searchsorted(pair[used], np.arange(len(btf) + 1))  # in `used`: of each pair, and the end of the last
    uv = torch.from_numpy(demand.uv(btf.shape))
    level = _levels(demand.footprint, btf.shape)
    answers = np.zeros((len(demand), 3), np.float32)
    for index in range(len(btf)):
        show(f"reference of {demand.name}", index + 1, len(btf))
        rows = used[starts[index] : starts[index + 1]]
        if len(rows):
            query = rows // around
            values = _filtered_at(btf[index], uv[query], level[query])
            np.add.at(answers, query, values.numpy() * weight[rows, None])
    return np.maximum(answers, 0)


def _levels(footprint: Array, size: tuple[int, int]) -> torch.Tensor:
    """The levels of detail (n,) of footprints (n,): log2 of each in texels, within the pyramid of a texture (H, W)."""
    deepest = int(np.log2(min(size)))  # the last level of which a box fits into the picture
    texels = np.maximum(footprint, 1e-9) * max(size)
    return torch.from_numpy(np.clip(np.log2(texels), 0, deepest).astype(np.float32))


def _filtered_at(picture: Array, uv: torch.Tensor, level: torch.Tensor) -> torch.Tensor:
    """A slice (H, W, 3) at uv (n, 2), each averaged over a box: (n, 3). Levels (n,) are log2 of its side in texels."""
    out = torch.zeros(len(uv), 3)
    for number in range(int(level.max()) + 2):  # whole levels up to the one above the deepest
        # A level between two whole ones is a linear mixture of these: shares fall from 1 to 0 over one level.
        share = (1 - (level - number).abs()).clamp_min(0)
        some = share > 0
        if not some.any():
            continue
        texture = torch.from_numpy(np.ascontiguousarray(box_filter(picture, 2**number), np.float32))
        # A level omits texels on the right and at the bottom that do not fill a box, so uv is stretched from the top
        # left corner, where v is 1.
        height, width = picture.shape[:2]
        down = height / (height // 2**number * 2**number)
        across = width / (width // 2**number * 2**number)
        uv_of_level = torch.stack([uv[some, 0] * across, 1 - (1 - uv[some, 1]) * down], 1)
        out[some] += share[some, None] * sample_texture(texture, uv_of_level)
    return out


@dataclass
class FrameScorer:
    """A scene with the frames of the reference table; scores any number of decoded materials."""

    btf: BTF  # the reference table
    demand: Demand
    show: Progress = silent
    prepared: dict[str, list[Prepared]] = field(default_factory=dict)  # by metric: the frames of the reference

    @cached_property
    def truth(self) -> Array:
        """The frames (frames, H, W, 3) of the reference table, linear RGB."""
        return self.demand.pictures(truth(self.btf, self.demand, self.show))

    @cached_property
    def at_points(self) -> Array:
        """The frames of the reference table when it is asked at points: all of its texels, and no level of detail."""
        demand = replace(self.demand, footprint=np.zeros_like(self.demand.footprint))
        return self.demand.pictures(truth(self.btf, demand, self.show))

    def filters(self, material: Material) -> bool:
        """Whether a material's answers depend on the footprint, at the queries with the widest footprints."""
        widest = np.argsort(self.demand.footprint, kind="stable")[-PROBED:]
        columns = self.demand.queries(self.btf.shape)
        uv, wo, wi, footprint = (torch.from_numpy(column[widest]) for column in columns)
        answers = material.query(uv, wo, wi, footprint)
        at_points = material.query(uv, wo, wi, 0.0)
        return not torch.allclose(answers, at_points, rtol=1e-4)

    @cached_property
    def seen(self) -> Array:
        """Mask (frames, H, W) of the pixels that show the material."""
        mask = np.zeros(int(np.prod(self.demand.frames)), bool)
        mask[self.demand.pixel] = True
        return mask.reshape(self.demand.frames)

    @cached_property
    def exposure(self) -> float:
        """The exposure of the frames, from the pixels that show the material."""
        return exposure_of(self.truth[self.seen][None])

    @cached_property
    def shares(self) -> Array:
        """The share (N,) of each pair of the reference table in the demand."""
        return pair_shares(self.btf.layout, self.demand)

    def frames(self, material: Material) -> Array:
        """The frames (frames, H, W, 3) of a decoded material."""
        return self.demand.pictures(material.query(*self.demand.queries(self.btf.shape)))

    def score(self, material: Material, names: tuple[str, ...] = NAMES) -> dict[str, float | None]:
        """Each metric of the frames over the pixels that show the material, pooled over frames. A metric whose window
        is larger than a frame is left out; None means no pixel of the material inside its window or, in dB, no error.
        """
        return self.compare(self.frames(material), names)

    def compare(self, frames: Array, names: tuple[str, ...] = NAMES) -> dict[str, float | None]:
        """Each metric of given frames (frames, H, W, 3), linear RGB; see `score`."""
        scores = {}
        _, height, width = self.demand.frames
        for name in names:
            metric = metrics.get(name).load()
            if min(height, width) < metric.smallest:
                continue
            sides = self._prepared_truth(name, metric)
            maps = np.stack([metric.error_map(side, frame) for side, frame in zip(sides, frames, strict=True)])
            values = maps[_middle_of(self.seen, maps.shape[1:])]  # (n,) of the pixels that show the material
            scores[name] = as_number(metric.pool(values)) if len(values) else None
        return scores

    def _prepared_truth(self, name: str, metric: SliceMetric) -> list[Prepared]:
        """The reference's frames as a metric prepares them, once for all materials."""
        if name not in self.prepared:
            self.prepared[name] = [metric.prepare(picture, self.exposure) for picture in self.truth]
        return self.prepared[name]

    def record(self, frames: Array) -> records.Scene:
        """The fields of a job's record about the scene, from a material's frames (frames, H, W, 3), linear RGB."""
        return {
            "name": self.demand.name,
            "queries": len(self.demand),
            "frames": list(self.demand.frames),
            "exposure": self.exposure,
            "metrics": self.compare(frames),
        }

    def pictures(self, frames: Array) -> dict[str, Array]:
        """A few frames, `truth` and `decoded`: small, display-transformed, 8 bit (at most `KEPT_FRAMES`, h, w, 3)."""
        chosen = np.unique(np.linspace(0, len(frames) - 1, KEPT_FRAMES).round().astype(int))
        factor = math.ceil(max(frames.shape[1:3]) / KEPT_SIDE)
        kept = {}
        for name, whole in (("truth", self.truth), ("decoded", frames)):
            small = np.stack([box_filter(whole[frame], factor) for frame in chosen])
            kept[name] = np.round(to_display(small, self.exposure) * 255).astype(np.uint8)
        return kept


def _middle_of(mask: Array, size: tuple[int, ...]) -> Array:
    """The middle (frames, *size) of a mask (frames, H, W): a metric with a window may have no values at the border."""
    height, width = size
    top = (mask.shape[1] - height) // 2
    left = (mask.shape[2] - width) // 2
    return mask[:, top : top + height, left : left + width]
