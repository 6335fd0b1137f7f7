"""Queries at the extremes, asked of the ordinary material, a small smooth one, after it went through its file.

The docstring of an expectation, such as `bounded`, is what the report shows as expected; it raises `CheckError` with a
message and the measured figure.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from bench.conformance.check import ROUNDING, CheckError
from bench.conformance.stress.case import Case, Subject, require
from bench.directions.hemisphere import from_angles, from_degrees, uniform
from bench.inputs.errors import InputError

COUNT = 64  # queries of a case
UP = torch.tensor([0.0, 0.0, 1.0])
BOUND = 2.0  # an answer above this many times the brightest sample is a firefly


class Queries(NamedTuple):
    """uv (n, 2), ω_o and ω_i (n, 3), footprint (n,)."""

    uv: Tensor
    wo: Tensor
    wi: Tensor
    footprint: Tensor


def spread(count: int = COUNT, theta_max_deg: float = 75.0, seed: int = 0) -> Queries:
    """Random queries: one period of uv, directions uniform in solid angle, footprints up to an eighth."""
    rng = np.random.default_rng(seed)
    uv = torch.from_numpy(rng.random((count, 2), np.float32))
    wo = torch.from_numpy(uniform(rng, count, theta_max_deg))
    wi = torch.from_numpy(uniform(rng, count, theta_max_deg))
    return Queries(uv, wo, wi, torch.from_numpy(rng.random(count, np.float32) / 8))


def grazing(theta_deg: float = 89.99) -> Tensor:
    """Directions (n, 3) at one θ and all azimuths."""
    return torch.from_numpy(from_degrees(np.full(COUNT, theta_deg), np.arange(COUNT) * 360.0 / COUNT))


def barely_above() -> Tensor:
    """Horizontal directions (n, 3) with the smallest positive z of float32."""
    flat = from_angles(np.full(COUNT, math.pi / 2), np.arange(COUNT) * 0.1)
    flat[:, 2] = np.finfo(np.float32).smallest_subnormal
    return torch.from_numpy(flat)


def with_directions(wo: Tensor | None = None, wi: Tensor | None = None) -> Callable[[], Queries]:
    """Random queries with this view, this light, or both: (n, 3), or one for all (3,)."""
    moved = {}
    if wo is not None:
        moved["wo"] = wo.expand(COUNT, 3).clone()
    if wi is not None:
        moved["wi"] = wi.expand(COUNT, 3).roll(7, 0)  # else a view and its light could have the same azimuth
    return lambda: spread()._replace(**moved)


def light_of_view(*signs: float) -> Callable[[], Queries]:
    """Random queries whose light is the view with each coordinate multiplied by a sign."""

    def make() -> Queries:
        """The queries; a new set each time."""
        queries = spread()
        return queries._replace(wi=queries.wo * torch.tensor(signs))

    return make


def bounded(subject: Subject, queries: Queries) -> None:
    """finite, not negative, at most twice the brightest sample"""
    answers = subject.answers(queries)
    bad = ~(answers.isfinite() & (answers >= 0) & (answers <= BOUND * subject.brightest)).all(1)
    if bad.any():
        row = int(bad.nonzero()[0])
        first = answers[row].tolist()
        query_text = query_in_words(queries, row)
        raise CheckError(f"{int(bad.sum())} answers, the first {first} at {query_text}", f"{answers[bad].max():.3g}")


def dark(subject: Subject, queries: Queries) -> None:
    """exactly 0"""
    answers = subject.answers(queries)
    lit = (answers != 0).any(1)
    if lit.any():
        row = int(lit.nonzero()[0])
        largest = float(answers.abs().max())  # answers below 0 are as wrong as those above
        raise CheckError(f"{answers[row].tolist()} at {query_in_words(queries, row)}", f"{largest:.3g}")


def refused(subject: Subject, queries: Queries) -> None:
    """an error that names the row; within 1e-3 of unit length it is answered"""
    bad = queries.wo.clone()
    bad[41] *= 2  # any row in the middle
    try:
        subject.tested.material.query(queries.uv, bad, queries.wi, queries.footprint)
    except InputError as error:
        require("row 41" in str(error), "no row", f"the error does not name the row: {error}")
    else:
        raise CheckError("a direction of length 2 was answered", "answered")
    bounded(subject, queries._replace(wo=queries.wo * (1 + 5e-4)))


def agree(subject: Subject, ours: Queries, theirs: Queries) -> None:
    """Check that two sets of queries get the same answers, within rounding of the brightest sample."""
    answers, wanted = subject.answers(ours), subject.answers(theirs)
    apart = (answers - wanted).abs().amax(1)
    worst = int(apart.argmax())
    allowed = ROUNDING * subject.brightest
    require(
        apart[worst] <= allowed,
        f"{apart[worst]:.2g}",
        f"answers differ by {apart[worst]:.3g}, allowed {allowed:.3g}, at {query_in_words(ours, worst)}",
    )


def far_uv(subject: Subject) -> None:
    """the answer at the same place of the first period"""
    queries = spread()
    there = torch.tensor([1e6, -1e6])
    # At 1e6 a float32 has steps of 1/16: these places (n, 2), in sixteenths, are exact there.
    place = (torch.arange(COUNT)[:, None] * torch.tensor([1, 3]) % 16) / 16
    agree(subject, queries._replace(uv=there + place), queries._replace(uv=place))


def edge_uv(value: float, subject: Subject) -> None:
    """Check that u or v at the edge of a period, such as −0.0, gives the same answers as at 0."""
    queries = spread()
    first = (torch.arange(COUNT) < COUNT // 2)[:, None]
    # A mask (n, 2) of what is moved: u of the first half of the queries, v of the others.
    edge = first == torch.tensor([True, False])
    at_edge, at_zero = queries.uv.masked_fill(edge, value), queries.uv.masked_fill(edge, 0.0)
    agree(subject, queries._replace(uv=at_edge), queries._replace(uv=at_zero))


def footprint(size: float) -> Callable[[], Queries]:
    """Random queries with one footprint, in longer sides of the picture."""
    return lambda: spread()._replace(footprint=torch.full((COUNT,), size))


def batch_of(count: int, subject: Subject) -> None:
    """One batch of so many queries: a few different ones in turns, which are asked again in a small batch."""
    few = spread(1021, seed=3)  # divides no size of a chunk, so equal queries stand at many places of chunks
    turns = torch.arange(count) % len(few.uv)
    many = Queries(*(column[turns] for column in few))
    answers, wanted = subject.answers(many), subject.answers(few)
    require(answers.shape == (count, 3), str(tuple(answers.shape)), f"the answer is {tuple(answers.shape)}")
    apart = (answers - wanted[turns]).abs().max().item() if count else 0.0
    allowed = ROUNDING * subject.brightest
    require(apart <= allowed, f"{apart:.2g}", f"in another batch answers differ by {apart:.3g}, allowed {allowed:.3g}")


def query_in_words(queries: Queries, row: int) -> str:
    """A query as `stress --query` takes it."""
    numbers = torch.cat([column[row].reshape(-1).double() for column in queries])
    listed = " ".join(f"{number:.9g}" for number in numbers.tolist())
    return f'--query "{listed}"'


def case(
    name: str, make: Callable[[], Queries], holds: Callable[[Subject, Queries], None] = bounded, cheap: bool = True
) -> Case:
    """A case of this group: how its queries are made, and the expectation that their answers must meet; see `Case`."""
    return Case("queries", name, holds.__doc__ or "", lambda subject: holds(subject, make()), cheap)


def not_above_horizon() -> Queries:
    """Views and lights in turns at z = 0, at −0 and below."""
    queries = spread()
    moves_view = (torch.arange(COUNT) // 4 % 2 == 0)[:, None]  # of four queries the views, then of four the lights
    flat = grazing(90.0)
    flat[:, 2] = torch.tensor([0.0, -0.0, -1e-30, 0.0]).repeat(COUNT // 4)
    turned_down = queries.wo * torch.tensor([1.0, 1.0, -1.0])
    is_flat = torch.arange(COUNT)[:, None] % 4 < 3  # every fourth one lies far below
    not_above = flat.where(is_flat, turned_down)
    return queries._replace(wo=not_above.where(moves_view, queries.wo), wi=queries.wi.where(moves_view, not_above))


SAME_PLACE = "the answer at 0, within rounding"
CASES = (
    case("view at 89.99°", with_directions(wo=grazing())),
    case("light at 89.99°", with_directions(wi=grazing())),
    case("view and light at 89.99°", with_directions(grazing(), grazing())),
    case("view and light barely above z = 0", with_directions(barely_above(), barely_above())),
    case("ω_o = ω_i", light_of_view(1.0, 1.0, 1.0)),
    case("light mirrored to the view", light_of_view(-1.0, -1.0, 1.0)),
    case("light opposite to the view", light_of_view(-1.0, -1.0, -1.0), dark),
    case("view at the zenith", with_directions(wo=UP)),
    case("light at the zenith", with_directions(wi=UP)),
    case("view and light at the zenith", with_directions(UP, UP)),
    case("z = 0 and below", not_above_horizon, dark),
    case("direction not of unit length", spread, refused),
    Case("queries", "uv = ±1e6", far_uv.__doc__ or "", far_uv, cheap=True),
    Case("queries", "uv = −0.0", SAME_PLACE, partial(edge_uv, -0.0), cheap=True),
    Case("queries", "uv = 1 − 2⁻²⁴", SAME_PLACE, partial(edge_uv, 1 - 2**-24), cheap=True),
    case("footprint 0", footprint(0.0)),
    case("footprint 1e-9", footprint(1e-9)),
    case("footprint 10", footprint(10.0)),
    Case("queries", "batch of 0", "no answer", partial(batch_of, 0), cheap=True),
    Case("queries", "batch of 1", "the same answer as in a larger batch", partial(batch_of, 1), cheap=True),
    Case("queries", "batch of 2²² + 1", "the same answers as in a smaller batch", partial(batch_of, (1 << 22) + 1)),
)
