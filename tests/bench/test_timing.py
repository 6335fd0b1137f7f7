import time

import numpy as np
import pytest
import torch

from bench import timing
from bench.machine.threads import torch_threads
from bench.material import DecoderCost, Material
from bench.runs.runner import timings_here
from bench.timing import BATCH, FLOOR, TURNS, Timing, calibrated, in_turns, random_queries, time_materials
from bench.timing.roofline import limit_ns, roofline


class Sleeper(Material):
    def __init__(self, seconds):
        super().__init__((4, 4), DecoderCost())
        self.seconds = seconds

    def evaluate(self, uv, wo, wi, footprint):
        begun = time.process_time()
        while time.process_time() - begun < self.seconds:
            pass
        return torch.zeros(len(uv), 3)


@pytest.fixture(scope="module")
def timings():
    return time_materials({"slow": Sleeper(0.02), "fast": Sleeper(0.01)}, threads=1)


def test_a_batch_cannot_take_less_than_it_works_and_is_stored_with_its_floor(timings):
    assert list(timings) == [FLOOR, "slow", "fast"]
    assert all(len(timing.samples) == len(timing.ratios) == TURNS for timing in timings.values())
    summary = timings["slow"].summary()
    assert 0 < summary["floor_ns"] < summary["ns_per_sample"]
    low, high = summary["ratio_interval95"]
    assert summary["ratio_least"] <= low <= summary["ratio_to_floor"] <= high
    assert timings["slow"].samples.min() >= 0.02e9 / BATCH
    assert timings["fast"].samples.min() >= 0.01e9 / BATCH


def test_the_summary_is_of_the_samples():
    summary = Timing(np.arange(1.0, 31.0), np.full(30, 2.0)).summary()
    assert summary["ns_per_sample"] == 15.5
    assert summary["iqr_ns"] == 14.5
    assert summary["ratio_to_floor"] == 2.0
    low, high = summary["interval95_ns"]
    assert 1 <= low < 15.5 < high <= 30


def test_a_ratio_is_to_the_mean_of_the_floors_timed_before_and_after_it(monkeypatch):
    """A clock whose every turn is the number of turns before it; the floor is every other one."""
    ticks = iter(range(1, 10_000))
    monkeypatch.setattr("bench.timing.calibrated", lambda call, device, clock: lambda: float(next(ticks)))
    found = in_turns({"a": lambda: None, "b": lambda: None}, 1, (4, 4), 1, torch.device("cpu"))
    for name in ("a", "b"):
        assert (found[name].ratios == 1.0).all()  # i beside (i − 1 + i + 1) / 2
    assert sorted([*found["a"].samples, *found["b"].samples]) == [5.0 * t + k for t in range(TURNS) for k in (2, 4)]
    assert set(np.sign(found["a"].samples - found["b"].samples)) == {-1.0, 1.0}  # the order changes
    assert found[FLOOR].summary()["ratio_to_floor"] == 1.0


class Texels(Sleeper):
    def at_one_texel(self):
        return Sleeper(self.seconds / 4)


def test_a_codec_that_answers_texels_is_timed_at_one_of_them_too(monkeypatch, tmp_path):
    monkeypatch.setattr(timing, "TURNS", 2)
    materials = {"texels": Texels(0.004), "plain": Sleeper(0.001)}
    monkeypatch.setattr("bench.runs.runner.material_of_job", lambda folder, job, device: materials[job["job"]])
    found = {each["job"]: each for each in timings_here(tmp_path, [{"job": name} for name in materials], "cpu", 1)}
    assert {name: "ratio_at_one_texel" in each for name, each in found.items()} == {"texels": True, "plain": False}


def test_warm_up_goes_on_until_two_calls_take_alike():
    milliseconds, calls, now = iter([50, 30, 2.1, 2]), [], 0

    def call():
        nonlocal now
        calls.append(next(milliseconds, 2))
        now += round(calls[-1] * 1e6)

    before = torch.get_num_threads()
    with torch_threads(1):
        assert torch.get_num_threads() == 1
    assert torch.get_num_threads() == before
    turn = calibrated(call, torch.device("cpu"), lambda: now, lambda: now)
    assert calls == [50, 30, 2.1, 2]
    assert turn() == 2e6
    assert calls[4:] == [2] * 2  # 3 ms


def test_queries_are_random_and_the_same_each_time():
    uv, wo, _, footprint = random_queries(40, torch.device("cpu"))
    assert len(wo.unique(dim=0)) == len(uv.unique(dim=0)) == 40
    assert not footprint.any()
    assert torch.equal(uv, random_queries(40, torch.device("cpu"))[0])


def test_the_roofline_bounds_a_sample_by_arithmetic_or_by_reads():
    ceiling = {"flops_per_ns": 100.0, "bytes_per_ns": 10.0}
    assert limit_ns(DecoderCost(flops_per_sample=1000, bytes_per_sample=10), ceiling) == 10
    assert limit_ns(DecoderCost(flops_per_sample=10, bytes_per_sample=500), ceiling) == 50
    measured = roofline(torch.device("cpu"), 1)
    assert 0.1 < measured["flops_per_ns"] < 1e5
    assert 0.1 < measured["bytes_per_ns"] < 1e4
