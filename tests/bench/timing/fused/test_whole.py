import pytest
import torch

import bench
from bench.inputs.errors import InputError
from bench.material import DecoderCost, Material, parameters
from bench.program import llvm
from bench.runs.suite import load_suite
from bench.timing.execution import TOLERANCES, Variant, prepared
from bench.timing.fused.target import Target
from bench.training.decoder import Architecture, Decoder
from tests.bench.test_material import queries
from tests.tiers import short_for

pytest.importorskip("drjit", reason="Dr.Jit is not installed (the extra mitsuba)")
CODECS = {
    "relief": {"steps": 5, "width": 8},
    "relief without a height": {"steps": 5, "width": 8, "relief": False},
    "neubtf-direct": {"steps": 5, "width": 8},
    "neumip": {"steps": 5},
    "neuralbtf": {"steps": 5, "width": 8},
    "neuralbtf as published": {"recipe": "paper", "steps": 5, "batch": 256, "width": 8},
    "ntc": {"steps": 5, "width": 8},  # its network answers four texels of a query
    "zeltner2024": {"steps": 5, "width": 8},
    "zeltner2024 as published": {"recipe": "paper", "steps": 5, "width": 8},
    "triple-plane": {"steps": 5},
    "bcf": {},
    "svbrdf": {"steps": 5},
    "pca": {"components": 3},
    "vq": {},
    "table": {},
    "tucker": {},
    "hsh": {},
    "ptm": {},
    "mean-colour": {},
}


TOO_LARGE = "rainer2019"


def test_a_network_that_is_too_large_is_told_to_use_another_execution(tmp_path, btf):
    bench.encode(btf, TOO_LARGE, tmp_path / "a.nbtf", steps=5)
    with pytest.raises(InputError, match=r"36,255.*compiled"):
        prepared(bench.load(tmp_path / "a.nbtf"), Variant("fused"))


def test_every_codec_of_the_suite_trade_is_here():
    assert {spec.codec for spec in load_suite("trade").codecs} <= {name.split()[0] for name in CODECS} | {TOO_LARGE}


@pytest.fixture(scope="module")
def btf():
    if reason := llvm.unusable(plugins=True):
        pytest.skip(reason)
    return bench.open("cable-knit", size=12, views=9, lights=9, heldout=8)


@pytest.mark.parametrize("name", short_for(CODECS, "relief", "pca", "ntc"))
def test_each_codec_answers_as_in_eager(tmp_path, btf, name):
    file = tmp_path / "a.nbtf"
    bench.encode(btf, name.split()[0], file, **CODECS[name])
    material = bench.load(file)
    if name.startswith("relief"):
        assert (material.relief is None) == ("without" in name)
    whole = prepared(material, Variant("fused"))
    assert type(whole).__name__ == "Whole"
    assert (parameters(whole), whole.cost, whole.size) == (parameters(material), material.cost, material.size)
    absolute, relative = TOLERANCES["float32"]
    for count in (1, 3000):
        uv, wo, wi = queries(count)
        expected, rgb = (each.query(3 * uv - 1, wo, wi, 0.3 * uv[:, 0]) for each in (material, whole))
        error = (rgb - expected).abs().amax(1)
        # A march may step over an edge of the height by the last bit.
        assert (error > absolute + relative * expected.max()).float().mean() <= 1e-3
    assert expected.std() > 0.01


@pytest.mark.parametrize("name", short_for(CODECS, "relief", "pca"))
def test_with_networks_in_line_as_on_a_gpu_the_answers_are_the_same(tmp_path, btf, monkeypatch, name):
    """A GPU has the same kernel, compiled from other arrays: here those of the processor stand for them."""
    import drjit as dr

    in_line = Target(dr.llvm, dr.JitBackend.LLVM, calls=False, device=torch.device("cpu"))
    monkeypatch.setattr("bench.timing.execution.target_of", lambda device: in_line)
    bench.encode(btf, name.split()[0], tmp_path / "a.nbtf", **CODECS[name])
    material = bench.load(tmp_path / "a.nbtf")
    whole = prepared(material, Variant("fused"))
    assert whole.target == in_line
    uv, wo, wi = queries(500)
    expected, rgb = (each.query(3 * uv - 1, wo, wi, 0.3 * uv[:, 0]) for each in (material, whole))
    absolute, relative = TOLERANCES["float32"]
    assert ((rgb - expected).abs().amax(1) > absolute + relative * expected.max()).float().mean() <= 2e-3
    assert expected.std() > 0.01


class Mixed(Material):
    def __init__(self, width):
        super().__init__((4, 4), DecoderCost())
        generator = torch.Generator().manual_seed(0)
        self.matrix = torch.randn(6, width, generator=generator)
        self.network = Decoder(Architecture(width, (8,)), generator).requires_grad_(False)

    def evaluate(self, uv, wo, wi, footprint):
        return self.network(torch.cat([wo, wi], 1) @ self.matrix).square()


def test_too_many_products_outside_of_networks_are_refused_or_left_to_pytorch(btf):
    from bench.timing.fused.whole import MOST_PRODUCTS, Whole

    assert isinstance(prepared(Mixed(20), Variant("fused")), Whole)
    large = Mixed(MOST_PRODUCTS // 6 + 1)
    large.network = None
    large.evaluate = lambda uv, wo, wi, footprint: (torch.cat([wo, wi], 1) @ large.matrix)[:, :3]
    with pytest.raises(InputError, match=r"10,000 .*10,002.*compiled"):
        prepared(large, Variant("fused"))
