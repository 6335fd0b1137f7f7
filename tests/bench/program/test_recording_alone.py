import threading

import numpy as np
import pytest
import torch

from bench.btf import BTF, ArraySource
from bench.codec import Fit
from bench.codecs.registry import load_codec
from bench.conformance.check import tiny_btf
from bench.directions.hemisphere import product, uniform
from bench.inputs.errors import InputError
from bench.program.operations import OPERATIONS
from bench.program.recording import program_of
from tests.bench.program.test_operations import Made
from tests.tiers import short_for


@pytest.fixture(scope="module")
def material():
    codec = load_codec("pca")()
    return codec.decode(codec.encode(tiny_btf(), Fit()), torch.device("cpu"))


def steps(program):
    return [(step.operation, step.shape) for step in program.steps]


@pytest.mark.long
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


def drawn(count):
    return uniform(np.random.default_rng(count), count)


LINE = np.stack([np.sin(x := np.linspace(-1, 1, 30)), np.zeros(30), np.cos(x)], 1).astype(np.float32)
LAYOUTS = {
    "one pair": (drawn(1), drawn(1)),
    "2 x 2": product(drawn(2), drawn(3)[:2]),
    "one view": product(drawn(1), drawn(12)),
    "lights in a line": product(drawn(5), LINE),
    "three scattered": (drawn(3), drawn(4)[:3]),
    "scattered": (drawn(20), drawn(21)[:20]),
}


@pytest.mark.parametrize("layout", short_for(LAYOUTS, "one pair", "lights in a line", "scattered"))
@pytest.mark.parametrize("name", short_for(["table", "pca"], "table"))
def test_any_layout_of_few_pairs_is_recorded_in_operations_that_back_ends_know(name, layout):
    wo, wi = LAYOUTS[layout]
    values = np.random.default_rng(0).random((len(wo), 4, 4, 3), np.float32)
    codec = load_codec(name)()
    material = codec.decode(codec.encode(BTF("few", wo, wi, ArraySource(values)), Fit()), torch.device("cpu"))
    assert {step.operation for step in program_of(material).steps} <= OPERATIONS.keys()


def test_too_many_numbers_to_rank_are_refused():
    numbers = torch.rand(300, 3)
    made = Made(lambda uv, wo, wi: torch.cdist(wo, numbers).topk(3).values)
    with pytest.raises(InputError, match="300 numbers"):
        program_of(made)
