import pytest

from bench.runs import runner
from bench.runs.runner import Estimate


@pytest.fixture
def clock(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(runner.time, "monotonic", lambda: now[0])
    return now


def ended(name, status="ok"):
    return {"job": name, "status": status}


def test_after_each_job_it_says_how_long_the_others_take_at_the_mean(clock):
    run = Estimate("abcd", "")
    clock[0] = 120
    run.ended(ended("a"), "")
    assert run.progress == "1 of 4 jobs, about 6 min left"
    clock[0] = 360
    run.ended(ended("b"), "file")
    assert run.progress == "2 of 4 jobs, about 6 min left"
    run.ended(ended("c"), "")
    run.ended(ended("d"), "")
    assert (run.progress, run.left) == ("4 of 4 jobs", "")


def test_jobs_that_did_nothing_tell_nothing_of_the_others(clock):
    run = Estimate("abcd", "a")
    clock[0] = 60
    run.ended(ended("a"), "record")
    run.ended(ended("b", "unavailable"), "")
    assert run.progress == "2 of 4 jobs"
    run.ended(ended("c"), "")
    assert run.progress == "3 of 4 jobs, about 1 min left"
