import gc
import resource
import sys
from unittest.mock import Mock

import pytest
import torch

from bench.inputs.errors import InputError
from bench.material import CHUNK, DecoderCost, Material
from bench.timing import execution
from bench.timing.execution import Variant, exists_on, prepared
from bench.timing.fused import lean
from bench.training.decoder import Architecture, Decoder
from tests.bench.test_material import queries


class Textured(Material):
    def __init__(self):
        super().__init__((8, 8), DecoderCost())
        generator = torch.Generator().manual_seed(0)
        self.network = Decoder(Architecture(10, (16, 16), activation="sine", norm=True, residual=True), generator)
        self.network.requires_grad_(False)
        self.texture = torch.randn(8, 8, 6, generator=generator)

    def evaluate(self, uv, wo, wi, footprint):
        return self.network.at(self.texture, uv, wo[:, :2], wi[:, :2]).exp()


def assert_same(ours: Material, tolerance: float, counts=(1, 100)) -> None:
    for count in counts:
        expected = Textured().query(*queries(count))
        torch.testing.assert_close(ours.query(*queries(count)), expected, rtol=tolerance, atol=tolerance)


def test_the_fused_execution_is_of_float32_on_every_device():
    assert exists_on(Variant("fused"), torch.device("cuda")) is (torch.version.hip is None)
    assert not any(exists_on(Variant("fused", "tf32"), torch.device(kind)) for kind in ("cpu", "cuda"))


def test_a_variant_is_named_by_execution_and_precision():
    assert Variant.parse("compiled") == Variant("compiled", "float32")
    assert Variant.parse(str(Variant("fused", "bfloat16"))) == Variant("fused", "bfloat16")
    with pytest.raises(InputError, match="'compiled'"):
        Variant.parse("compile float32")
    with pytest.raises(InputError, match="no 'float8'"):
        Variant.parse("eager float8")


@pytest.mark.parametrize(("precision", "tolerance"), [("float32", 0), ("float16", 0.02), ("bfloat16", 0.1)])
def test_eager_answers_in_any_precision_and_leaves_the_material_as_it_was(precision, tolerance):
    material = Textured()
    assert_same(prepared(material, Variant("eager", precision)), tolerance)
    assert material.dtype == torch.float32
    assert type(material.network) is Decoder


@pytest.mark.timeout(400)
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # PyTorch's own, when it compiles
@pytest.mark.long
def test_compiled_answers_the_same_for_slices_parts_and_whole_chunks():
    compiled = prepared(Textured(), Variant("compiled"))
    assert_same(compiled, 1e-5, (CHUNK + 7,))
    picture = compiled.slice([0, 0, 1], [0.6, 0, 0.8])
    torch.testing.assert_close(picture, Textured().slice([0, 0, 1], [0.6, 0, 0.8]), rtol=1e-5, atol=1e-5)


def fused():
    try:
        return prepared(Textured(), Variant("fused"))
    except InputError as error:
        pytest.skip(str(error))


@pytest.fixture
def old_llvm(monkeypatch):
    monkeypatch.setattr(execution, "target_of", lambda device: None)
    monkeypatch.setattr(execution, "unusable", lambda plugins: "too old" if plugins else "")


def test_what_cannot_be_computed_is_refused_with_the_remedy(old_llvm, monkeypatch):
    with pytest.raises(InputError, match="NVIDIA"):
        prepared(Textured(), Variant("eager", "tf32"))
    with pytest.raises(InputError, match="float32, not bfloat16"):
        prepared(Textured(), Variant("fused", "bfloat16"))
    monkeypatch.setattr(execution.shutil, "which", lambda name: None)
    with pytest.raises(InputError, match=r"C\+\+"):
        prepared(Textured(), Variant("compiled"))
    with pytest.raises(InputError, match="use compiled"):
        prepared(Textured(), Variant("fused"))
    with pytest.raises(InputError, match=r"GPUs.*fused"):
        prepared(Textured(), Variant("network"))


@pytest.mark.skipif(sys.platform != "linux", reason="counts the page faults of Linux")
@pytest.mark.parametrize("execution", ["eager", "fused"])
def test_a_query_maps_no_memory_but_for_its_answers(execution):
    """After two chunks, sixteen need new pages for their answers alone: buffers are used again, whatever the batch."""
    material = fused() if execution == "fused" else prepared(Textured(), Variant(execution))
    gc.collect()  # what recording and compiling left behind: freed later, it would shrink the heap in the middle
    material.query(*queries(2 * material.chunk))
    batch = queries(16 * material.chunk)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    rgb = material.query(*batch)
    mapped = (resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before) * resource.getpagesize()
    assert mapped <= rgb.numel() * rgb.element_size() + (1 << 20)


@pytest.mark.parametrize(("capability", "bits"), [("default", 1), ("avx2", 256), ("avx512", 512), ("", None)])
def test_code_that_was_compiled_for_one_capability_is_not_taken_for_another(capability, bits, monkeypatch):
    """PyTorch keeps compiled code by its options, and not by ATEN_CPU_CAPABILITY."""
    monkeypatch.setenv("ATEN_CPU_CAPABILITY", capability)
    given = {}
    monkeypatch.setattr(torch, "compile", lambda call, **words: given.update(words) or call)
    lean.compiled(len, dynamic=True)
    assert given["options"].get("cpp.simdlen") == bits


@pytest.mark.long
def test_a_compiler_that_fails_is_told_with_the_remedy():
    compiled = prepared(Textured(), Variant("compiled"))
    compiled.rest = Mock(side_effect=torch._dynamo.exc.TorchDynamoException("file too short"))
    with pytest.raises(InputError, match=r"file too short.*cache"):
        compiled.query(*queries(3))
