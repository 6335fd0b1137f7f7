import random
import subprocess
import sys

import pytest
import safetensors.torch
import torch
from fuzz_codec_files import resealed, sealed_text
from fuzzing import damaged

from bench.codec import Codec, Fit, Parts
from bench.codecs import container, loading
from bench.codecs.registry import load_codec
from bench.conformance.check import tiny_btf
from bench.inputs.errors import ContainerError, EncodeError, InputError


@pytest.fixture(scope="module")
def encoded(tmp_path_factory):
    codec = load_codec("pca")(components=4)
    path = tmp_path_factory.mktemp("files") / "tiny.nbtf"
    header = container.save(path, codec, codec.encode(tiny_btf(), Fit()))
    return header, path.read_bytes()


def test_the_header_says_what_was_written_and_parts_add_up_to_the_file(encoded):
    header, data = encoded
    assert (header.codec, header.version, header.settings["components"]) == ("pca", load_codec("pca").version, 4)
    assert sum(header.part_bytes().values()) == header.file_bytes == len(data) == header.path.stat().st_size


def test_a_thousand_mutations_are_each_refused(encoded, tmp_path):
    """Changed bytes, cuts, insertions, deletions and swaps: `ContainerError` each time, never a picture."""
    _, data = encoded
    rng = random.Random(0)
    path = tmp_path / "mutated.nbtf"
    for trial in range(1000):
        while (mutated := damaged(data, rng)) == data:
            pass
        path.write_bytes(mutated)
        with pytest.raises(ContainerError) as error:
            loading.load(path)
        assert str(path) in str(error.value), trial


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda fields, _: fields.update(version=99), "version 99 .*pca"),
        (lambda fields, _: fields.update(codec="pcb"), "'pcb'.*'pca'"),
        (lambda fields, _: fields.update(settings={"colour": 1}), "codec pca"),
        (lambda fields, _: fields.update(settings={"half": [1]}), "settings/half"),
        (lambda fields, _: fields.pop("settings"), "settings.*missing"),
        (lambda _, tensors: tensors["texture"].update(x=tensors["texture"].popitem()[1]), "codec pca"),
    ],
)
def test_a_file_that_is_whole_but_foreign_is_explained(encoded, tmp_path, change, message):
    _, data = encoded
    path = tmp_path / "foreign.nbtf"
    path.write_bytes(data)
    resealed(path, change)
    with pytest.raises(InputError, match=message) as error:
        loading.load(path)
    assert str(path) in str(error.value)


@pytest.mark.parametrize("data", [b"", b"\x89PNG\r\n\x1a\n" + b"\0" * 100, b"{}", b"NBT", b"NBTF\1" + bytes(99)])
def test_what_is_no_codec_file_is_called_so(tmp_path, data):
    path = tmp_path / "picture.nbtf"
    path.write_bytes(data)
    with pytest.raises(ContainerError, match=r"picture\.nbtf.*codec file"):
        container.read_header(path)


def test_a_file_of_another_format_is_named_with_its_remedy(encoded, tmp_path):
    path = tmp_path / "old.nbtf"
    path.write_bytes(safetensors.torch.save({"mean": torch.ones(3)}, {"another": "{}"}))
    with pytest.raises(ContainerError, match=r"old\.nbtf.*codec file"):
        container.read_header(path)
    _, data = encoded
    path.write_bytes(data[:4] + b"\3" + data[5:])
    with pytest.raises(ContainerError, match=r"old\.nbtf.*format 3.*\b2\b"):
        container.read_header(path)


HEADER = b'{"codec":"c","settings":{},"tensors":%s,"version":1}'
NONE, ONE = HEADER % b"{}", HEADER % b'{"other":{"a":["U8",2]}}'
LIMIT = container.HEADER_LIMIT


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (sealed_text(ONE, b"12"), ""),
        (sealed_text(ONE, b"12")[:44], "truncated: .*44 .*45"),
        (sealed_text(ONE, b"12")[:50], "truncated: .*5 of"),
        (sealed_text(ONE, b"1"), "truncated: 1"),
        (sealed_text(ONE, b"123"), "1 bytes .*last"),
        (sealed_text(ONE, b"12")[:-1] + b"3", "altered"),
        (sealed_text(ONE, b"12", garbage=b"x"), "header .*sound"),
        (sealed_text(ONE, b"12", claimed=len(ONE) - 1), "header .*sound"),
        (sealed_text(ONE, b"12", claimed=len(ONE) + 1), "header .*sound"),
        (sealed_text(ONE, b"12", claimed=0), "header .*sound"),
        (sealed_text(ONE + b" " * LIMIT, b"12"), "header.* 4,194,304"),
        (sealed_text(ONE + b" " * LIMIT, b"12", claimed=LIMIT), "header .*sound"),
        (sealed_text(ONE[:-1], b"12"), "header .*sound"),
        (sealed_text(b"[]", b""), "header .*sound"),
        (sealed_text(b"[" * 100_000, b""), "header .*sound"),
        (sealed_text(b'{"version":1,' + NONE[1:], b""), "name.*twice"),
        (sealed_text(HEADER % b'{"other":{"a":["U8",1],"a":["U8",1]}}', b"12"), "name.*twice"),
        (sealed_text(b"{}", b""), "no tensors"),
        (sealed_text(HEADER % b'{"others":{}}', b""), "part 'others'"),
        (sealed_text(HEADER % b'{"other":[]}', b""), "part 'other'"),
        (sealed_text(HEADER % b'{"other":{"a":["BOOL",2]}}', b"\1\2"), "other/a .*0 and"),
        (sealed_text(HEADER % b'{"other":{"a":["F32",281474976710655]}}', b"12"), "tensor 'other/a'"),
        (sealed_text(HEADER % b'{"other":{"a":["U8",281474976710655]}}', b"12"), "truncated: 2814749767106"),
        *(
            (sealed_text(HEADER % (b'{"other":{%s}}' % entry), b"12"), "tensor 'other/")
            for entry in (
                b'"a":["U9",2]',
                b'"a":[]',
                b'"a":"U8"',
                b'"a":{"U8":2}',
                b'"a":[["U8"],2]',
                b'"a":["U8",-1]',
                b'"a":["U8",true,2]',
                b'"a":["U8",2.0]',
                b'"a":["U8",null]',
                b'"a":["U8",[2]]',
                b'"a":["U8",0,140737488355328,140737488355328]',
                b'"a":["U8"%s]' % (b",1" * 65),
                b'"\\ud800":["U8",2]',
            )
        ),
    ],
)
def test_a_file_that_is_not_laid_out_so_is_refused(tmp_path, data, message):
    path = tmp_path / "a.nbtf"
    path.write_bytes(data)
    if not message:
        assert container.read_parts(path)[1].other["a"].tolist() == [49, 50]
        return
    with pytest.raises(ContainerError, match=message):
        container.read_parts(path)


def test_a_header_beyond_the_limit_is_not_written(monkeypatch):
    monkeypatch.setattr(container, "HEADER_LIMIT", 100)
    with pytest.raises(EncodeError, match=r"header.*\b100\b"):
        container.to_bytes(load_codec("mean-colour")(), Parts(other={"a" * 100: torch.ones(1)}))


def test_a_missing_file_is_a_container_error(tmp_path):
    with pytest.raises(ContainerError, match=r"absent\.nbtf"):
        loading.load(tmp_path / "absent.nbtf")


def test_numbers_that_are_not_finite_are_never_written(tmp_path):
    codec: Codec = load_codec("mean-colour")()
    parts = Parts(texture={"mean": torch.full((2, 2, 3), float("nan"))})
    with pytest.raises(EncodeError, match=r"texture/mean.* 12 .*12.*finite"):
        container.save(tmp_path / "nan.nbtf", codec, parts)
    assert not list(tmp_path.iterdir())


SOME = torch.arange(12.0)


@pytest.mark.parametrize(
    ("tensors", "says"),
    [
        ({"a": SOME.to(torch.float8_e4m3fn)}, "texture/a .*float8_e4m3fn.*float64"),
        ({"a": SOME.to(torch.uint16)}, "texture/a .*uint16"),
        ({"a": SOME.to(torch.uint32)}, "texture/a .*uint32"),
        ({"a": SOME.to(torch.complex64)}, "texture/a .*complex64"),
        ({3: SOME}, ".*texture.*name 3"),
        ({"\udcff": SOME}, r".*texture.*name '\\udcff'"),
        ({"a": torch.nested.nested_tensor([SOME, SOME], layout=torch.jagged)}, "texture/a .*nested"),
        ({"a": SOME.to_sparse()}, "texture/a .*sparse"),
        ({"a": SOME.to("meta")}, "texture/a .*meta"),
    ],
)
def test_a_tensor_that_no_file_can_hold_is_named_with_its_remedy(tensors, says, tmp_path):
    with pytest.raises(EncodeError, match=f"codec mean-colour: {says}"):
        container.save(tmp_path / "a.nbtf", load_codec("mean-colour")(), Parts(texture=tensors))
    assert not list(tmp_path.iterdir())


def test_halves_of_one_tensor_are_no_shared_memory_and_every_kept_dtype_is_read_again(tmp_path):
    tensors = {"first": SOME[:6], "second": SOME[6:], "columns": SOME.view(3, 4)[:, :2]}
    tensors |= {
        name: SOME.to(getattr(torch, name)) for name in ("float64", "half", "bfloat16", "int16", "uint8", "bool")
    }
    path = tmp_path / "a.nbtf"
    container.save(path, load_codec("mean-colour")(), Parts(texture=tensors))
    stored = container.read_parts(path)[1].texture
    assert all(torch.equal(stored[name], values) for name, values in tensors.items())


def test_a_file_of_another_kind_is_never_replaced(tmp_path):
    codec, parts = load_codec("mean-colour")(), Parts(texture={"mean": torch.ones(2, 2, 3)})
    path = tmp_path / "measured.npz"
    path.write_bytes(b"a measurement")
    with pytest.raises(InputError, match=r"measured\.npz"):
        container.save(path, codec, parts)
    assert path.read_bytes() == b"a measurement"
    path.unlink()
    container.save(path, codec, parts)
    container.save(path, codec, parts)  # over a codec file, whatever its name


def test_an_encoder_is_a_part_of_its_own(encoded, tmp_path):
    header, _ = encoded
    assert "encoder" not in header.part_bytes()
    parts = Parts(texture={"t": torch.ones(5)}, encoder={"weights": torch.arange(7.0)})
    header = container.save(tmp_path / "file", load_codec("pca")(), parts)
    sizes = {"decoder": 0, "texture": 20, "other": 0, "encoder": 28, "header": header.file_bytes - 48}
    assert header.part_bytes() == sizes
    assert container.read_parts(header.path)[1].encoder["weights"].equal(torch.arange(7.0))


def test_every_dtype_and_shape_comes_back_in_memory_of_its_own(tmp_path):
    codec = load_codec("mean-colour")()
    dtypes = torch.float32, torch.float16, torch.bfloat16, torch.float64, torch.uint8, torch.int8, torch.int64
    tensors = {str(dtype): torch.ones(2, 3, dtype=dtype) for dtype in dtypes}
    tensors |= {"a": torch.tensor([True]), "empty": torch.zeros(0, 3), "scalar": torch.tensor(1.0)}
    back = container.read_parts(container.save(tmp_path / "a.nbtf", codec, Parts(other=tensors)).path)[1].other
    assert {name: (each.dtype, each.shape) for name, each in back.items()} == {
        name: (each.dtype, each.shape) for name, each in tensors.items()
    }
    for name, tensor in back.items():
        assert tensor.data_ptr() % tensor.element_size() == 0
        assert tensor.untyped_storage().nbytes() == tensor.nbytes, name
        tensor.zero_()


def test_a_header_is_read_without_pytorch(encoded):
    header, _ = encoded
    script = "import sys; from bench.codecs.container import read_header; read_header(sys.argv[1]); "
    script += "sys.exit('torch' in sys.modules)"
    subprocess.run([sys.executable, "-c", script, str(header.path)], check=True)
