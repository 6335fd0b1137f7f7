import time

import numpy as np
import pytest
import torch

from bench.material import DecoderCost, Material
from bench.timing import BATCH, FLOOR, SAMPLES, Timing, compare, conditions, torch_threads


class Sleeper(Material):
    """Takes a known time a batch."""

    def __init__(self, seconds):
        super().__init__((4, 4), DecoderCost())
        self.seconds = seconds

    def evaluate(self, uv, wo, wi, footprint):
        time.sleep(self.seconds)
        return torch.zeros(len(uv), 3)


@pytest.fixture(scope="module")
def timings():
    return compare({"slow": Sleeper(0.02), "fast": Sleeper(0.01)}, threads=1)


def test_every_contestant_and_the_floor_give_all_their_samples(timings):
    assert list(timings) == [FLOOR, "slow", "fast"]
    assert all(len(timing.samples) == len(timing.ratios) == SAMPLES for timing in timings.values())
    assert (timings[FLOOR].ratios == 1).all()


def test_a_batch_cannot_take_less_than_it_sleeps(timings):
    assert timings["slow"].samples.min() >= 0.02e9 / BATCH
    assert timings["fast"].samples.min() >= 0.01e9 / BATCH


def test_the_summary_is_of_the_samples():
    summary = Timing(np.arange(1.0, 31.0), np.full(30, 2.0)).summary()
    assert summary["ns_per_sample"] == 15.5
    assert summary["iqr_ns"] == 14.5
    assert summary["ratio_to_floor"] == 2.0
    low, high = summary["interval95_ns"]
    assert 1 <= low < 15.5 < high <= 30


def test_threads_are_limited_inside_and_restored_after():
    before = torch.get_num_threads()
    with torch_threads(1):
        assert torch.get_num_threads() == 1
    assert torch.get_num_threads() == before


def test_conditions_say_what_a_figure_holds_for():
    assert {"batch", "dtype", "threads", "device", "execution", "texture_fetch"} <= conditions(2, "cpu").keys()
