"""Rules for every decoder at any query, and for every fit, tried on the ordinary material: a small one in closed form.

Reciprocity and conservation of energy are measured against the small material's closed form. No codec here is built to
keep either, so the figure is reported; that of a mean colour, which ignores directions, is the bound.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import get_type_hints

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from bench.btf import Array
from bench.codec import Configured
from bench.codecs import container, shared
from bench.codecs.encoding import fit_to_file
from bench.conformance import check
from bench.conformance.check import CheckError, tiny_radiance
from bench.conformance.stress.case import Case, Measured, Subject, applicable, require, short
from bench.conformance.stress.data import ordinary, values
from bench.conformance.stress.networks import SHORT_FLOATS, decibels, require_valid_answers
from bench.conformance.stress.properties import DATA_HOLDS, QUERIES_HOLD, drawn_data, drawn_queries
from bench.conformance.stress.queries import Queries, query_in_words, spread
from bench.directions.hemisphere import uniform
from bench.material import sample_texture

MANY = 10_000  # queries of a rule
LINES = 2_000  # of `no_jump`
HALVINGS = 20  # 2⁻²⁰ is 1e-6
STEP = 1e-6  # a query moves by this distance
SLOPE = 100.0  # the largest slope of answers, in brightest samples per unit of distance
SHORT_STEPS = 16  # roundings allowed in |Δ|: three layers of linear, norm, ω, sine and sum, and the fetch
HIGH_RATE = 1e30  # a learning rate with which any fit diverges
GROUP = "invariants"
NEAR = f"|Δ| ≤ r · (|x| + mean), r = {SHORT_STEPS}"
SAYS_CONTINUOUS = f"moved by {STEP:g}, answers move by at most {SLOPE:g} × {STEP:g} of the brightest sample"
VIEWS, LIGHTS = 128, 1024  # views and lights for an albedo
NO_WORSE = 1.01  # times the error of a mean colour, which halves round by 2⁻¹¹
RECIPROCAL = "exchanging view and light changes f_r no more than a mean colour's"
CONSERVES = "at most 1, the truth's, or what a mean colour reflects more than these"
Answer = Callable[[Queries], Tensor]


def finite(subject: Subject) -> None:
    """finite and not negative up to 89.9°"""
    require_valid_answers(subject.tested.material, spread(MANY, theta_max_deg=89.9, seed=5))


def tilted(directions: Tensor, angle: float, seed: int) -> Tensor:
    """Unit directions (n, 3) float32, each turned by a small angle in radians towards a random side."""
    generator = torch.Generator().manual_seed(seed)
    random = torch.randn(directions.shape, generator=generator, dtype=torch.float64)
    # Unit vectors across each direction.
    across = functional.normalize(random - directions * (random * directions).sum(1, keepdim=True), dim=1)
    return functional.normalize(directions + angle * across, dim=1).float()


def across_wrap() -> tuple[Queries, Queries]:
    """Places just left and right, or below and above, of the border of the picture."""
    queries = spread(MANY, theta_max_deg=80.0, seed=8)
    # A mask (n, 2) of what lies on the border, at 0: u of even queries, v of odd ones. The other stays as it is.
    border = (torch.arange(MANY) % 2 == 0)[:, None] ^ torch.tensor([False, True])
    on_border = queries.uv * ~border
    before = (on_border - border * (STEP / 2)).float()
    behind = (on_border + border * (STEP / 2)).float()
    return queries._replace(uv=before), queries._replace(uv=behind)


def across_zenith() -> tuple[Queries, Queries]:
    """Views, or lights, just beside the zenith on both sides, at all azimuths."""
    queries = spread(MANY, theta_max_deg=80.0, seed=9)
    azimuth = torch.linspace(0, 2 * torch.pi, MANY, dtype=torch.float64)
    offset = torch.stack([azimuth.cos(), azimuth.sin(), torch.zeros_like(azimuth)], 1) * STEP / 2
    up = torch.tensor([0.0, 0.0, 1.0])
    moves_view = (torch.arange(MANY) % 2 == 0)[:, None]

    def beside(direction: Tensor) -> Queries:
        """The queries with these directions (n, 3) as the view of even ones, and as the light of odd ones."""
        return queries._replace(wo=direction.where(moves_view, queries.wo), wi=queries.wi.where(moves_view, direction))

    return beside((up + offset).float()), beside((up - offset).float())


def at_samples() -> tuple[Queries, Queries]:
    """The pairs of the data, where the triangles of an interpolator meet, and pairs just beside them."""
    queries = spread(MANY, theta_max_deg=80.0, seed=10)
    btf = ordinary()
    pair = torch.arange(MANY) % len(btf)
    wo, wi = torch.from_numpy(btf.wo)[pair], torch.from_numpy(btf.wi)[pair]
    return queries._replace(wo=wo, wi=wi), queries._replace(wo=tilted(wo, STEP, seed=3), wi=tilted(wi, STEP, seed=4))


def continuous(make: Callable[[], tuple[Queries, Queries]], subject: Subject) -> None:
    """Check that answers hardly differ between two sets of queries that are `STEP` apart, one by one."""
    here, there = make()
    apart = (subject.answers(here) - subject.answers(there)).abs().amax(1)
    worst = int(apart.argmax())
    allowed = SLOPE * STEP * subject.brightest
    require(
        apart[worst] <= allowed,
        f"{apart[worst]:.1g}",
        f"the answer moves by {apart[worst]:.3g}, allowed {allowed:.3g}, between {query_in_words(here, worst)} and "
        f"{query_in_words(there, worst)}",
    )


def no_jump(subject: Subject) -> None:
    """Halve random lines again and again towards the part where the answer moves most: this finds a jump."""
    start = spread(LINES, theta_max_deg=80.0, seed=6)
    rng = np.random.default_rng(7)
    end = spread(LINES, theta_max_deg=80.0, seed=13)
    end_uv = start.uv.double() + torch.from_numpy(rng.uniform(-0.5, 0.5, (LINES, 2)))

    def on_line(share: Tensor) -> Queries:
        """The queries at a share (n,) of the way from start to end, 0 to 1."""
        share = share[:, None]
        uv = start.uv + share * (end_uv - start.uv)
        # At most half way to the other direction: about as far as uv moves.
        wo = functional.normalize(start.wo + 0.5 * share * (end.wo - start.wo), dim=1)
        wi = functional.normalize(start.wi + 0.5 * share * (end.wi - start.wi), dim=1)
        return Queries(uv.float(), wo.float(), wi.float(), start.footprint)

    # Of each line the ends of a part, as shares (n,) of the way, and the answers (n, 3) there.
    low = torch.zeros(LINES, dtype=torch.float64)
    high = torch.ones(LINES, dtype=torch.float64)
    at_low = subject.answers(on_line(low))
    at_high = subject.answers(on_line(high))
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        at_middle = subject.answers(on_line(middle))
        change_in_lower = (at_middle - at_low).abs().amax(1)
        change_in_upper = (at_high - at_middle).abs().amax(1)
        # Keep the half in which the answer moves more: where it is the lower one, the middle becomes the high end.
        keep_lower = change_in_lower > change_in_upper
        high = torch.where(keep_lower, middle, high)
        at_high = torch.where(keep_lower[:, None], at_middle, at_high)
        low = torch.where(keep_lower, low, middle)
        at_low = torch.where(keep_lower[:, None], at_low, at_middle)
    # The ends are now less than `STEP` apart, so a large change is a jump.
    continuous(lambda: (on_line(low), on_line(high)), subject)


def near_double(dtype: torch.dtype, subject: Subject) -> Measured:
    """Answers of a short float against float64's: |Δ| ≤ r · (|x| + mean), r = 16 roundings of that float."""
    queries = spread(MANY, theta_max_deg=89.0, seed=11)
    # A query answers in float32 at least; `double` changes no value, and makes the differences exact.
    double = subject.decode(subject.parts).to(dtype=torch.float64).query(*queries).double()
    ours = subject.decode(subject.parts).to(dtype=dtype).query(*queries).double()
    allowed = SHORT_STEPS * torch.finfo(dtype).eps  # r
    relative = (ours - double).abs() / (double.abs() + double.mean())  # (n, 3)
    used = (relative / allowed).amax(1)  # (n,), 1 is just allowed
    worst = int(used.nan_to_num(torch.inf).argmax())  # NaN is the worst of all
    answer, exact = ours[worst].tolist(), double[worst].tolist()
    where = f"{answer}, {exact} in float64: {used[worst]:.2f} of what is allowed, at {query_in_words(queries, worst)}"
    require(used[worst] <= 1, f"{used[worst] * allowed:.1%}", where)
    return Measured(decibels(ours, double), float(used[worst]), where)


def diverges(subject: Subject) -> None:
    """A fit at an absurd learning rate says that it diverged, and leaves no file.

    Of a codec without a learning rate, the fit of its shared network is tried.
    """
    path = subject.tested.folder / f"diverged{container.SUFFIX}"
    codec = subject.tested.codec
    network = subject.tested.codec.network
    wild = wild_rates(type(codec))
    wild_of_network = wild_rates(network) if network else {}
    applicable(wild or wild_of_network, "no learning rate")
    try:
        if wild:
            fit_to_file(subject.codec(**wild), ordinary(), subject.fit(), path)
        elif network:
            wild_network = network(**short(network) | wild_of_network)
            shared.make(wild_network, check.others(ordinary()), subject.fit(), path)
    except Exception as error:  # a codec may raise any kind, but it must say what happened
        message = str(error)
        require("diverged" in message or "not finite" in message, "unclear", f"{type(error).__name__}: {message}")
        files = [file.name for file in subject.tested.folder.glob(f"{path.stem}*")]
        require(not files, "left a file", f"left {files}")
        return
    raise CheckError(f"a fit at a learning rate of {HIGH_RATE:g} ended without an error", "silent")


def wild_rates(kind: type[Configured]) -> dict[str, float]:
    """The learning rates among the settings, each far too high."""
    wild = {}
    kinds = get_type_hints(kind.Settings)  # without the ranges that types of settings may give
    for name, kind_of_setting in kinds.items():
        is_rate = name == "rate" or name.endswith("_rate")
        if is_rate and kind_of_setting is float:
            wild[name] = HIGH_RATE
    return wild


def mean_colour() -> Answer:
    """The answers of the mean-colour codec on the ordinary material, without the rounding to halves."""
    texture = torch.from_numpy(values().mean(0))
    return lambda queries: sample_texture(texture, queries.uv)


def reciprocity(subject: Subject) -> Measured:
    """Root mean square of f_r(ω_o, ω_i) − f_r(ω_i, ω_o) over the mean of f_r, at pairs up to 75°.

    The closed form of the ordinary material is reciprocal, so all of it is the codec's error.
    """
    queries = spread(MANY, theta_max_deg=75.0, seed=12)
    there = queries._replace(wo=queries.wi, wi=queries.wo)

    def asymmetry(answer: Answer) -> Tensor:
        """The root mean square of the change of f_r over its mean; answers are f_r · cos θ_i."""
        ours = answer(queries) / queries.wi[:, 2:]
        theirs = answer(there) / there.wi[:, 2:]
        return (ours - theirs).square().mean().sqrt() / ((ours + theirs) / 2).mean().clamp_min(1e-30)

    error = asymmetry(subject.answers)
    require(error.isfinite(), "not finite", "the error of reciprocity is not finite")
    most = asymmetry(mean_colour()) * NO_WORSE
    detail = f"the exchange of view and light changes f_r by {error:.1%} of its mean, allowed {most:.1%}"
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
    wo = uniform(rng, VIEWS, theta_max_deg=89.9)
    wi = uniform(rng, LIGHTS, theta_max_deg=89.9)
    # Rows count from the top and v from below, hence `size` less the row above. `tiny_btf` has its values at whole rows
    # and columns, the centres of texels in uv.
    row, col = place.T[:, :, None] / size  # (views, 1) each, against (lights,)
    true = np.maximum(tiny_radiance(row, col, wo[:, None], wi[None]).mean(1) * 2 * np.pi, 1)

    def reflected(answer: Answer) -> Array:
        """The albedo (views, 3) over the allowed one: the mean over the hemisphere times its solid angle, 2 π."""
        queries = Queries(
            uv.repeat_interleave(LIGHTS, 0),
            torch.from_numpy(wo).repeat_interleave(LIGHTS, 0),
            torch.from_numpy(wi).repeat(VIEWS, 1),
            torch.zeros(VIEWS * LIGHTS),
        )
        return answer(queries).view(VIEWS, LIGHTS, 3).mean(1).numpy() * 2 * np.pi / true

    ours = reflected(subject.answers)
    most = max(1.0, float(reflected(mean_colour()).max())) * NO_WORSE
    worst = int(ours.max(1).argmax())
    theta = math.degrees(math.acos(wo[worst, 2]))
    share = ours.max()
    detail = f"reflects {share:.1%} of what the truth does, or of all light, at θ = {theta:.0f}°; allowed {most:.1%}"
    require(share <= most, f"{share:.0%}", detail)
    return Measured(f"{share:.0%}")


CASES = (
    Case(GROUP, "10,000 random queries", finite.__doc__ or "", finite, cheap=True),
    Case(GROUP, "continuous anywhere", SAYS_CONTINUOUS, no_jump, cheap=True),
    Case(GROUP, "continuous at the samples", SAYS_CONTINUOUS, partial(continuous, at_samples), cheap=True),
    Case(GROUP, "continuous across the wrap", SAYS_CONTINUOUS, partial(continuous, across_wrap), cheap=True),
    Case(GROUP, "continuous across the zenith", SAYS_CONTINUOUS, partial(continuous, across_zenith), cheap=True),
    # `neubtf-bench check` already has these two.
    Case(GROUP, "size of a batch", check.batches.__doc__ or "", lambda subject: check.batches(subject.tested)),
    Case(GROUP, "order of a batch", check.order.__doc__ or "", lambda subject: check.order(subject.tested)),
    *(
        Case(GROUP, f"{name} against fp64", f"{NEAR} × {torch.finfo(dtype).eps:.2g}", partial(near_double, dtype), True)
        for name, dtype in SHORT_FLOATS.items()
    ),
    Case(GROUP, "Helmholtz reciprocity (reported)", RECIPROCAL, reciprocity),
    Case(GROUP, "a fit that diverges", "says so, and leaves no file", diverges),
    Case(GROUP, "drawn queries", QUERIES_HOLD, drawn_queries),
    Case(GROUP, "drawn data", DATA_HOLDS, drawn_data),
    Case(GROUP, "directional albedo (reported)", CONSERVES, energy),
)
