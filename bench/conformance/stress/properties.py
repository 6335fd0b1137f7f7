"""Queries and materials drawn by the package Hypothesis; a failure is shrunk to the smallest case, as a command.

Hypothesis calls a test with many drawn values of a *strategy*, which says what to draw. When one fails, it tries
simpler values until none simpler fails.
"""

import importlib.util
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch

from bench.btf import BTF, ArraySource
from bench.conformance.check import ROUNDING, CheckError
from bench.conformance.stress.case import Subject, applicable, require
from bench.conformance.stress.queries import BOUND, Queries, spread
from bench.directions.hemisphere import from_degrees, thinned_product, ubo2003

QUERIES_HOLD = "finite, not negative, bounded, 0 below the horizon, periodic, the same alone as among others"
DATA_HOLDS = "finite, not negative, at most twice the brightest sample"
LEAST_EXPONENT, LARGEST_EXPONENT = -8, 6  # of ten: the brightest of a drawn material


def query_holds(subject: Subject, numbers: Sequence[float]) -> list[float]:
    """The answer to one query: u v, ω_o, ω_i, footprint, as `query_in_words` writes it. `CheckError` if it is wrong."""
    row = torch.tensor(numbers, dtype=torch.float32)
    query = Queries(uv=row[None, :2], wo=row[None, 2:5], wi=row[None, 5:8], footprint=row[8:])
    material = subject.tested.material
    (answer,) = material.query(*query)
    listed = str(answer.tolist())
    require(answer.isfinite().all() and (answer >= 0).all(), "bad", f"{listed} is negative or not finite")
    require((answer <= BOUND * subject.brightest).all(), f"{answer.max():.3g}", f"{listed}: a firefly")
    if min(query.wo[0, 2], query.wi[0, 2]) <= 0:
        require(not answer.any(), f"{answer.max():.3g}", f"{listed} is not 0 below the horizon")
    allowed = ROUNDING * max(1.0, subject.brightest)
    # Sixteenths are exact in float32, here and three periods away.
    place = query._replace(uv=(query.uv * 16).round().remainder(16) / 16)
    there = place._replace(uv=place.uv + torch.tensor([3.0, -2.0]))
    apart = (material.query(*there) - material.query(*place)).abs().max().item()
    require(apart <= allowed, f"{apart:.2g}", f"three periods away the answer differs by {apart:.3g}")
    # Behind other queries, so its answer is the last.
    others = [column.flip(0) for column in spread()]
    batch = Queries(*(torch.cat([column, last]) for column, last in zip(others, query, strict=True)))
    apart = (material.query(*batch)[-1] - answer).abs().max().item()
    require(apart <= allowed, f"{apart:.2g}", f"in a batch with others the answer differs by {apart:.3g}")
    return answer.tolist()


def noise(height: int, width: int, views: int, lights: int, exponent: int, seed: int) -> BTF:
    """A material of that size, of noise up to 10 to the power of `exponent`."""
    values = np.random.default_rng(seed).random((views * lights, height, width, 3)) * 10.0**exponent
    source = ArraySource(values.astype(np.float32))
    return BTF("drawn", *thinned_product(ubo2003(), views, lights), source, periodic=True)


def data_hold(subject: Subject, numbers: Sequence[int]) -> float:
    """The largest decoded value of a material that `noise` makes from six numbers; `CheckError` if a value is wrong."""
    changes = {"steps": 10} if subject.has_steps else {}  # dozens of materials are fitted; quality is not asked here
    encoded = subject.encode(noise(*numbers), **changes)
    decoded = encoded.decoded
    brightest = encoded.truth.max()
    require(np.isfinite(decoded).all() and (decoded >= 0).all(), "bad", "a value is negative or not finite")
    require(decoded.max() <= BOUND * brightest, f"{decoded.max() / brightest:.2g} ×", f"{decoded.max():.3g}: a firefly")
    return float(decoded.max())


def drawn_queries(subject: Subject) -> None:
    """`query_holds` of drawn queries: any place, views and lights up to and below the horizon, any footprint."""
    st = _hypothesis().strategies
    places = st.floats(-1e6, 1e6, width=32)
    angles = st.tuples(st.floats(0, 100), st.floats(0, 360))
    footprints = st.one_of(st.just(0.0), st.floats(2**-30, 10, width=32))
    strategy = st.builds(_numbers, places, places, angles, angles, footprints)
    _search(subject, "query", strategy, count=200, holds=query_holds)


def drawn_data(subject: Subject) -> None:
    """`data_hold` of drawn materials: up to 5 × 5 texels and 4 × 4 pairs, from 1e-8 to 1e6."""
    st = _hypothesis().strategies
    side = st.integers(1, 5)
    few = st.integers(1, 4)
    strategy = st.tuples(side, side, few, few, st.integers(LEAST_EXPONENT, LARGEST_EXPONENT), st.integers(0, 1000))
    _search(subject, "data", strategy, 12 if subject.has_steps else 60, data_hold)  # fits in steps take longer


def _hypothesis() -> Any:
    """The package Hypothesis; `NotApplicable` without it."""
    applicable(importlib.util.find_spec("hypothesis"), "needs hypothesis: pip install 'neubtf-bench[test]'")
    return importlib.import_module("hypothesis")


def _numbers(
    u: float, v: float, view: tuple[float, float], light: tuple[float, float], footprint: float
) -> tuple[float, ...]:
    """A query of nine numbers from places, angles in degrees and a footprint."""
    wo, wi = from_degrees(*view).tolist(), from_degrees(*light).tolist()
    return (u, v, *wo, *wi, footprint)


def _search(subject: Subject, word: str, strategy: Any, count: int, holds: Callable[[Subject, Any], object]) -> None:
    """Try drawn numbers; the error gives the smallest that fail, as a command that tries them again."""
    hypothesis = _hypothesis()
    failing = []

    @hypothesis.settings(
        max_examples=count,
        derandomize=True,  # the same values in each process
        database=None,  # remembers nothing from one run to the next
        deadline=None,  # a test may take any time
        suppress_health_check=list(hypothesis.HealthCheck),
        phases=(hypothesis.Phase.generate, hypothesis.Phase.shrink),
    )
    @hypothesis.given(strategy)
    def attempt(numbers: tuple[float, ...]) -> None:
        """Try one set of numbers, and note it if it fails: the last note is the smallest."""
        try:
            holds(subject, numbers)
        except Exception as error:
            failing.append((numbers, error))
            raise

    try:
        attempt()
    except Exception as raised:  # a codec may raise any kind; Hypothesis tries the smallest case last
        if not failing:
            raise
        numbers, error = failing[-1]
        listed = " ".join(f"{number:.9g}" for number in numbers)
        again = f'neubtf-bench stress --codec {subject.tested.codec.name} --{word} "{listed}"'
        raise CheckError(f"{error}: {again}", getattr(error, "figure", "") or type(error).__name__) from raised
