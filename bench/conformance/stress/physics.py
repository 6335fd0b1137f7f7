"""Reciprocity and conservation of energy of a decoder, measured against the small material's closed form.

No codec here is built to keep either, so the figure is reported; that of a mean colour, which ignores directions, is
the bound.
"""

import math
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from bench.btf import Array
from bench.conformance.check import tiny_radiance
from bench.conformance.stress.case import Measured, Subject, require
from bench.conformance.stress.data import values
from bench.conformance.stress.queries import Queries, spread
from bench.directions.hemisphere import uniform
from bench.material import sample_texture

PAIRS = 10_000  # pairs for reciprocity
VIEWS, LIGHTS = 128, 1024  # views and lights for an albedo
NO_WORSE = 1.01  # times the error of a mean colour, which halves round by 2⁻¹¹
RECIPROCAL = "exchanging view and light changes f_r no more than a mean colour's"
CONSERVES = "at most 1, the truth's, or what a mean colour reflects more than these"

Answer = Callable[[Queries], Tensor]


def mean_colour() -> Answer:
    """The answers of the mean-colour codec on the ordinary material, without the rounding to halves."""
    texture = torch.from_numpy(values().mean(0))
    return lambda queries: sample_texture(texture, queries.uv)


def reciprocity(subject: Subject) -> Measured:
    """Root mean square of f_r(ω_o, ω_i) − f_r(ω_i, ω_o) over the mean of f_r, at pairs up to 75°.

    The closed form of the ordinary material is reciprocal, so all of it is the codec's error.
    """
    queries = spread(PAIRS, 75.0, seed=12)
    there = queries._replace(wo=queries.wi, wi=queries.wo)

    def asymmetry(answer: Answer) -> Tensor:
        ours, theirs = (answer(q) / q.wi[:, 2:] for q in (queries, there))
        return (ours - theirs).square().mean().sqrt() / ((ours + theirs) / 2).mean().clamp_min(1e-30)

    error = asymmetry(subject.answers)
    require(error.isfinite(), "not finite", "the error of reciprocity is not finite")
    most = asymmetry(mean_colour()) * NO_WORSE
    detail = f"the exchange of view and light changes f_r by {error:.1%} of its mean, a mean colour's by {most:.1%}"
    require(error <= most, f"{error:.0%}", detail)
    return Measured(f"{error:.0%}")


def energy(subject: Subject) -> Measured:
    """The directional albedo at random texels and views, as a share of the truth's, or of 1 if that is more.

    Light comes evenly from all around. The truth is the ordinary material's closed form under the same lights.
    """
    rng = np.random.default_rng(14)
    size = subject.tested.btf.shape[0]
    place = rng.integers(0, size, (VIEWS, 2))
    uv = torch.from_numpy(np.stack([place[:, 1] + 0.5, size - place[:, 0] - 0.5], 1) / size).float()
    wo, wi = uniform(rng, VIEWS, 89.9), uniform(rng, LIGHTS, 89.9)
    row, col = place.T[:, :, None] / size
    true = np.maximum(tiny_radiance(row, col, wo[:, None], wi[None]).mean(1) * 2 * np.pi, 1)

    def excess(answer: Answer) -> Array:
        queries = Queries(
            uv.repeat_interleave(LIGHTS, 0),
            torch.from_numpy(wo).repeat_interleave(LIGHTS, 0),
            torch.from_numpy(wi).repeat(VIEWS, 1),
            torch.zeros(VIEWS * LIGHTS),
        )
        albedo: Array = answer(queries).view(VIEWS, LIGHTS, 3).mean(1).numpy() * 2 * np.pi / true
        return albedo

    ours = excess(subject.answers)
    most = max(1.0, float(excess(mean_colour()).max())) * NO_WORSE
    worst = int(ours.max(1).argmax())
    theta, share = math.degrees(math.acos(wo[worst, 2])), ours.max()
    detail = f"reflects {share:.1%} of what the truth does, or of all light, at θ = {theta:.0f}°; allowed {most:.1%}"
    require(share <= most, f"{share:.0%}", detail)
    return Measured(f"{share:.0%}")
