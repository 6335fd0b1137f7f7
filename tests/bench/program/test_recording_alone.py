"""A program is the same whatever else the process does while it is recorded."""

import sys
import threading

import pytest
import torch

from bench.codec import Fit
from bench.codecs.registry import load_codec
from bench.conformance.check import tiny_btf
from bench.program.recording import program_of


@pytest.fixture(scope="module")
def material():
    codec = load_codec("pca")()
    return codec.decode(codec.encode(tiny_btf(), Fit()), torch.device("cpu"))


def steps(program):
    return [(step.operation, step.shape) for step in program.steps]


def test_frames_that_somebody_keeps_change_no_program(material):
    """As a profiler of the asking thread does: Dask's workers have one."""
    expected, frames = steps(program_of(material)), []
    sys.setprofile(lambda frame, event, _: frames.append(frame))
    try:
        recorded = steps(program_of(material))
    finally:
        sys.setprofile(None)
    assert recorded == expected


def test_threads_that_record_at_once_give_what_one_gives(material):
    expected, recorded, together = steps(program_of(material)), [], threading.Barrier(3)

    def record():
        together.wait()
        recorded.append(steps(program_of(material)))

    threads = [threading.Thread(target=record) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert recorded == [expected] * 3
