"""Slices that another program decoded, as a material that can be scored: it answers whole slices at their pairs."""

from collections.abc import Sequence

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from bench.btf import BTF, box_filter
from bench.directions.hemisphere import to_degrees
from bench.inputs.errors import InputError
from bench.material import DecoderCost, Material

SAME = 1e-3  # radians: nearer directions count as equal, because angles in file names are rounded


class SlicesMaterial(Material):
    """The slices of `decoded` at the pairs of `truth`. Answers over several texels are means of the slice's texels.

    Raises `InputError` if `decoded` lacks a pair of `truth`.
    """

    opaque = True

    def __init__(self, decoded: BTF, truth: BTF):
        super().__init__(decoded.shape, DecoderCost())
        self.decoded = decoded
        have, wanted = (np.concatenate([btf.wo, btf.wi], 1) for btf in (decoded, truth))
        distance, nearest = cKDTree(have).query(wanted)
        if absent := int((distance > SAME).sum()):
            pair = int(distance.argmax())
            angles = [f"{angle:.1f}" for w in (truth.wo[pair], truth.wi[pair]) for angle in to_degrees(w)]
            raise InputError(
                f"{decoded.name}: it has no slice for {absent:,} of the {len(truth):,} pairs of {truth.name}, such as "
                f"theta_o, phi_o, theta_i, phi_i = {', '.join(angles)}: decode every pair of {truth.name}"
            )
        self.pair_of = dict(zip(map(tuple, wanted.tolist()), nearest.tolist(), strict=True))

    def boxes(
        self, wo: Sequence[float], wi: Sequence[float], factor: int, size: tuple[int, int] | None = None
    ) -> Tensor:
        return torch.from_numpy(box_filter(self.decoded[self.pair_of[*wo, *wi]], factor)).clamp_min(0)
