"""Finds the pairs of a BTF around each query of a demand, and the share of the demand on each pair."""

import numpy as np
import torch

from bench.btf import Array, Layout
from bench.demand.demand import Demand
from bench.directions.interpolation import PairInterpolator, Weights

CHUNK = 8_192  # queries at once, because a search among scattered pairs computes all distances


def pair_weights(layout: Layout, demand: Demand, radiance: bool = False) -> Weights:
    """Pairs and shares (n, k) of each query, as `bench.directions.interpolation` interpolates. Shares add up to one;
    with `radiance` they are the interpolation weights of radiance, including cosines."""
    interpolator = PairInterpolator(layout)
    search = interpolator if radiance else interpolator.shares
    wo, wi = torch.from_numpy(demand.wo), torch.from_numpy(demand.wi)
    parts = [search(o, i) for o, i in zip(wo.split(CHUNK), wi.split(CHUNK), strict=True)]
    return Weights(torch.cat([part.sample for part in parts]).int(), torch.cat([part.weight for part in parts]).float())


def pair_shares(layout: Layout, demand: Demand) -> Array:
    """The share (N,) of the demand that falls on each pair; they add up to one."""
    return shares_from_weights(pair_weights(layout, demand), demand.importance, len(layout.view))


def shares_from_weights(weights: Weights, importance: Array, count: int) -> Array:
    """The share (count,) of each pair, from known corners."""
    weight = weights.weight.numpy() * importance[:, None]
    return np.bincount(weights.sample.numpy().ravel(), weight.ravel(), count)
