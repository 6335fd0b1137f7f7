"""Bjøntegaard deltas against the `bjontegaard` package, and curves of which none can be given."""

import bjontegaard
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.errors import InputError
from bench.metrics.bd import bd_psnr, bd_rate

ANCHOR = np.array([[1000, 30.0], [2000, 33.1], [4000, 35.9], [8000, 38.0], [16000, 39.2]])


def raised(by):
    return ANCHOR + np.array([0, by])


@st.composite
def curves(draw):
    """Two rising curves with at least three quarters of each axis in common."""
    both = []
    for _ in range(2):
        rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
        count = draw(st.integers(4, 8))
        rate = 10 ** (np.linspace(3, 5, count) + rng.uniform(-0.02, 0.02, count))
        quality = np.linspace(25, 45, count) + rng.uniform(-0.5, 0.5, count)
        both.append(np.stack([rate, quality], 1))
    return both


@settings(derandomize=True, max_examples=60, deadline=None)
@given(curves())
def test_deltas_are_those_of_the_oracle(both):
    anchor, test = both
    columns = (*anchor.T, *test.T)
    theirs = bjontegaard.bd_rate(*columns, method="pchip", require_matching_points=False)
    assert bd_rate(anchor, test).value == pytest.approx(theirs, abs=1e-9)
    theirs = bjontegaard.bd_psnr(*columns, method="pchip", require_matching_points=False)
    assert bd_psnr(anchor, test).value == pytest.approx(theirs, abs=1e-9)


def test_half_the_bytes_at_every_quality_is_minus_50_percent():
    halved = ANCHOR * [0.5, 1]
    delta = bd_rate(ANCHOR, halved)
    assert delta.value == pytest.approx(-50)
    assert (delta.low, delta.high, delta.overlap) == (30.0, 39.2, 1.0)
    assert bd_rate(ANCHOR, ANCHOR).value == pytest.approx(0)


def test_two_decibels_more_at_every_rate_are_two():
    delta = bd_psnr(ANCHOR, raised(2))
    assert delta.value == pytest.approx(2)
    assert (delta.low, delta.high, delta.overlap) == pytest.approx((1000, 16000, 1))


def test_the_overlap_says_what_the_delta_rests_on():
    delta = bd_rate(ANCHOR, raised(4.6))
    assert (delta.low, delta.high) == (34.6, 39.2)
    assert delta.overlap == pytest.approx(4.6 / 13.8)


def test_points_may_come_in_any_order():
    assert bd_rate(ANCHOR[::-1], ANCHOR[[2, 0, 4, 1, 3]] * [2, 1]).value == pytest.approx(100)


@pytest.mark.parametrize(
    ("test", "message"),
    [
        (ANCHOR[:2], "test has 2 points.*at least 3"),
        (raised(50), "share no quality"),
        (ANCHOR * [0, 1], "positive rates"),
        (raised(np.inf), "finite qualities"),
        (np.repeat(ANCHOR[:2], 2, 0), "test has two points of equal quality"),
        (ANCHOR[:, :1], r"test must be \(n, 2\)"),
    ],
)
def test_curves_without_a_delta_are_an_error(test, message):
    with pytest.raises(InputError, match=message):
        bd_rate(ANCHOR, test)


def test_rates_that_do_not_meet_are_an_error_for_psnr():
    with pytest.raises(InputError, match="share no rate"):
        bd_psnr(ANCHOR, ANCHOR * [100, 1])
