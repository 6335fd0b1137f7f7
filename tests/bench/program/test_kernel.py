from dataclasses import replace

import numpy as np
import pytest

import bench
from bench.directions.hemisphere import uniform
from bench.inputs.errors import InputError
from bench.program import llvm
from bench.program.recording import program_of

dr = pytest.importorskip("drjit", reason="Dr.Jit is not installed (the extra mitsuba)")


@pytest.fixture(scope="module")
def btf():
    return bench.open("cable-knit", size=12, views=9, lights=9, heldout=8)


@pytest.mark.long
@pytest.mark.parametrize("large", [True, False])
def test_a_large_network_is_of_functions_that_the_kernel_calls(tmp_path, btf, monkeypatch, large):
    """Whatever the number of outputs, which functions share out; a small network counts as large here."""
    if reason := llvm.unusable(plugins=True):
        pytest.skip(reason)
    import drjit.llvm as kind

    from bench.program import kernel as module

    calls, product = [], module.called_product
    monkeypatch.setattr(module, "called_product", lambda *given: calls.append(given[2].shape) or product(*given))
    if large:
        monkeypatch.setattr(module, "MOST_LITERALS", 10)
    bench.encode(btf, "neubtf-direct", tmp_path / "a.nbtf", steps=3, width=30)
    material, rng = bench.load(tmp_path / "a.nbtf"), np.random.default_rng(0)
    given = rng.random((500, 2)).astype("f4"), uniform(rng, 500), uniform(rng, 500)
    columns = ([kind.Float(column) for column in each.T] for each in given)
    rgb = module.Kernel(program_of(material), kind)(*columns, kind.Float(0.1))
    ours = np.stack([np.asarray(dr.maximum(x, 0)) for x in rgb], 1)
    np.testing.assert_allclose(ours, material.query(*given, 0.1), rtol=1e-4, atol=1e-5)
    assert any(columns % module.BLOCK for _, columns in calls) == large
    assert max((columns for _, columns in calls), default=0) > module.BLOCK or not large


def test_an_operation_that_no_kernel_knows_is_named(tmp_path, btf):
    from bench.program.kernel import Kernel

    bench.encode(btf, "mean-colour", tmp_path / "a.nbtf")
    program = program_of(bench.load(tmp_path / "a.nbtf"))
    strange = replace(program, steps=(replace(program.steps[0], operation="erfinv"), *program.steps[1:]))
    with pytest.raises(InputError, match="erfinv"):
        Kernel(strange, None)
