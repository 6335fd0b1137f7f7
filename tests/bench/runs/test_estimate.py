import re

import pytest

from bench.runs import estimate
from bench.runs.estimate import Effort, Estimate
from bench.runs.suite import CodecSpec


@pytest.fixture
def clock(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(estimate.time, "monotonic", lambda: now[0])
    return now


def ended(name, status="ok"):
    return {"job": name, "status": status}


def numbers(text):
    return [int(digits) for digits in re.findall(r"\d+", text)]


def of_one_codec(names):
    return dict.fromkeys(names, Effort("pca"))


def test_after_each_job_it_says_how_long_the_others_take_at_the_mean(clock):
    run = Estimate(of_one_codec("abcd"), "")
    clock[0] = 120
    run.count_ended(ended("a"), "")
    assert numbers(run.progress) == [1, 4, 6]
    clock[0] = 360
    run.count_ended(ended("b"), "")
    assert numbers(run.progress) == [2, 4, 6]
    run.count_ended(ended("c"), "")
    run.count_ended(ended("d"), "")
    assert (numbers(run.progress), run.time_left) == ([4, 4], "")


def test_jobs_that_did_nothing_tell_nothing_of_the_others(clock):
    run = Estimate(of_one_codec("abcd"), "a")
    clock[0] = 60
    run.count_ended(ended("a"), "record")
    run.count_ended(ended("b", "unavailable"), "")
    assert numbers(run.progress) == [2, 4]
    clock[0] = 120
    run.count_ended(ended("c"), "")
    assert numbers(run.progress) == [3, 4, 1]


def test_no_time_is_told_while_a_codec_is_left_that_no_job_has_shown(clock):
    """Linear codecs, which come first, take seconds; of networks that take an hour they tell nothing."""
    run = Estimate({"a": Effort("pca"), "b": Effort("neumip", 1_000), "c": Effort("neumip", 10_000)}, "")
    clock[0] = 2
    run.count_ended(ended("a"), "")
    assert numbers(run.progress) == [1, 3]
    clock[0] = 62
    run.count_ended(ended("b"), "")
    assert numbers(run.progress) == [2, 3, 10]


def test_jobs_side_by_side_share_the_time(clock):
    run = Estimate(of_one_codec("abcdef"), "", at_once=2)
    for name, now in (("a", 60), ("b", 60), ("c", 120), ("d", 120)):
        clock[0] = now
        run.count_ended(ended(name), "")
    assert numbers(run.progress) == [4, 6, 1]


def test_the_effort_of_a_job_is_its_codec_and_the_steps_of_its_fit():
    assert Effort.of(CodecSpec("pca")) == ("pca", 1)
    assert Effort.of(CodecSpec("neumip", {"steps": 70})) == ("neumip", 70)
