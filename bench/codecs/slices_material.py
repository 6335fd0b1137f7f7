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
        """Find the decoded slice of each pair of the truth."""
        super().__init__(decoded.shape, DecoderCost())
        self.decoded = decoded
        # Pairs as points (N, 6), whose distances are angles in radians where they are small.
        decoded_pairs = np.concatenate([decoded.wo, decoded.wi], 1)
        wanted = np.concatenate([truth.wo, truth.wi], 1)
        distance, nearest = cKDTree(decoded_pairs).query(wanted)  # to the nearest decoded pair, and its index
        absent = int((distance > SAME).sum())
        if absent:
            pair = int(distance.argmax())
            angles = [*to_degrees(truth.wo[pair]), *to_degrees(truth.wi[pair])]
            listed = ", ".join(f"{angle:.1f}" for angle in angles)
            raise InputError(
                f"{decoded.name}: it has no slice for {absent:,} of the {len(truth):,} pairs of {truth.name}, such as "
                f"theta_o, phi_o, theta_i, phi_i = {listed}: decode every pair of {truth.name}"
            )
        self.pair_of: dict[tuple[float, ...], int] = {}  # by (*wo, *wi) of the truth: index of the decoded slice
        for directions, pair in zip(wanted.tolist(), nearest.tolist(), strict=True):
            self.pair_of[tuple(directions)] = pair

    def boxes(
        self, wo: Sequence[float], wi: Sequence[float], factors: Sequence[int], size: tuple[int, int] | None = None
    ) -> dict[int, Tensor]:
        """The stored slice of a pair, which must be one of `truth`, at each factor: (H // factor, W // factor, 3).

        It is linear RGB, the mean over boxes of factor × factor texels. Its size is its own, whatever `size` is.
        """
        decoded = self.decoded[self.pair_of[*wo, *wi]]
        return {factor: torch.from_numpy(box_filter(decoded, factor)).clamp_min(0) for factor in factors}
