"""A codec file in a kernel of Dr.Jit answers as the material does."""

import numpy as np
import pytest

import bench
from bench.inputs.errors import InputError
from bench.program import llvm
from bench.program.recording import program_of
from tests.tiers import short_for

dr = pytest.importorskip("drjit", reason="Dr.Jit is not installed (the extra mitsuba)")
CODECS = {
    "mean-colour": {},
    "table": {},
    "pca": {"components": 3},
    "vq": {"codes": 8},
    "hsh": {},
    "neumip": {"steps": 5},
    "neubtf-direct": {"steps": 5, "width": 8},
    "relief": {"steps": 5, "width": 8},
}


def queries(n):
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(2, n, 3))
    directions[..., 2] = np.abs(directions[..., 2]) + 0.02
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    return rng.random((n, 2)).astype("f4"), *directions.astype("f4"), (0.3 * rng.random(n)).astype("f4")


@pytest.fixture(scope="module")
def btf():
    return bench.open("cable-knit", size=12, views=9, lights=9, heldout=8)


def answers(material, given):
    """A kernel of a material, and what it and the material answer."""
    if reason := llvm.unusable(plugins=True):
        pytest.skip(reason)
    import drjit.llvm as kind

    from bench.program.kernel import Kernel

    kernel = Kernel(program_of(material), kind)
    columns = ([kind.Float(column) for column in each.T] for each in given[:3])
    rgb = np.stack([np.asarray(dr.maximum(x, 0)) for x in kernel(*columns, kind.Float(given[3]))], 1)
    return kernel, kind, rgb, material.query(*given)


@pytest.mark.parametrize("codec", short_for(CODECS, "pca", "relief"))
def test_each_codec_answers_alike(tmp_path, btf, codec):
    bench.encode(btf, codec, tmp_path / "a.nbtf", **CODECS[codec])
    kernel, kind, rgb, wanted = answers(bench.load(tmp_path / "a.nbtf"), queries(2000))
    off = np.abs(rgb - wanted) > 1e-4 * np.abs(wanted) + 1e-5
    assert wanted.std() > 0.01
    assert off.any(1).mean() <= 1e-3  # a march may step over an edge by the last bit
    assert np.abs(kernel(*([kind.Float(0.3)] * k for k in (2, 3, 3)), kind.Float(0))[0][0]) < np.inf


def test_a_large_network_is_of_functions_that_the_kernel_calls(tmp_path, btf, monkeypatch):
    """Whatever the number of outputs, which functions share out; a small network counts as large here."""
    from bench.program import kernel as module

    monkeypatch.setattr(module, "MOST_LITERALS", 10)
    file, calls = tmp_path / "a.nbtf", []
    bench.encode(btf, "neubtf-direct", file, steps=3, width=30)
    product = module.called_product
    monkeypatch.setattr(module, "called_product", lambda *given: calls.append(given[2].shape) or product(*given))
    _, _, rgb, wanted = answers(bench.load(file), queries(500))
    np.testing.assert_allclose(rgb, wanted, rtol=1e-4, atol=1e-5)
    assert any(columns % module.BLOCK for _, columns in calls)
    assert max(columns for _, columns in calls) > module.BLOCK


def test_an_operation_that_no_kernel_knows_is_named(tmp_path, btf):
    from dataclasses import replace

    from bench.program.kernel import Kernel

    file = tmp_path / "a.nbtf"
    bench.encode(btf, "mean-colour", file)
    program = program_of(bench.load(file))
    strange = replace(program, steps=(replace(program.steps[0], operation="erfinv"), *program.steps[1:]))
    with pytest.raises(InputError, match="erfinv"):
        Kernel(strange, None)
