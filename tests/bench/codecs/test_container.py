import random
import struct

import fuzz_codec_files
import pytest
import torch
from fuzzing import damaged
from safetensors.torch import load

from bench.codec import Codec, Fit, Parts
from bench.codecs import container, loading
from bench.codecs.registry import load_codec
from bench.conformance.check import tiny_btf
from bench.inputs.errors import ContainerError, InputError


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
        (lambda metadata, _: metadata.update(format=99), "newer than this version reads"),
        (lambda metadata, _: metadata.update(version=99), "written by version 99 of codec pca"),
        (lambda metadata, _: metadata.update(codec="pcb"), "no codec named 'pcb' is installed; did you mean 'pca'?"),
        (lambda metadata, _: metadata.update(settings={"colour": 1}), "not what codec pca wrote"),
        (lambda metadata, _: metadata.update(settings={"half": [1]}), "is not sound: settings is"),
        (lambda metadata, _: metadata.pop("settings"), "metadata is incomplete"),
        (lambda _, header: header.update({"texture/other": header.popitem()[1]}), "not what codec pca wrote"),
    ],
)
def test_a_file_that_is_whole_but_foreign_is_explained(encoded, tmp_path, change, message):
    _, data = encoded
    path = tmp_path / "foreign.nbtf"
    path.write_bytes(data)
    fuzz_codec_files.resealed(path, change)
    with pytest.raises(InputError) as error:
        loading.load(path)
    assert message in str(error.value)
    assert str(path) in str(error.value)


@pytest.mark.parametrize(
    "data",
    [b"", b"\x89PNG\r\n\x1a\n" + b"\0" * 100, b"{}", struct.pack("<Q", 2) + b"{}", struct.pack("<Q", 1 << 60) + b"{}"],
)
def test_what_is_no_codec_file_is_called_so(tmp_path, data):
    path = tmp_path / "picture.nbtf"
    path.write_bytes(data)
    with pytest.raises(ContainerError, match=r"not a codec file|not one of this suite"):
        container.read_header(path)


def test_a_missing_file_is_a_container_error(tmp_path):
    with pytest.raises(ContainerError, match="cannot be read"):
        loading.load(tmp_path / "absent.nbtf")


def test_numbers_that_are_not_finite_are_never_written(tmp_path):
    codec: Codec = load_codec("mean-colour")()
    parts = Parts(texture={"mean": torch.full((2, 2, 3), float("nan"))})
    with pytest.raises(ValueError, match="not finite: texture/mean"):
        container.save(tmp_path / "nan.nbtf", codec, parts)
    assert not list(tmp_path.iterdir())


def test_an_encoder_is_a_part_of_its_own(encoded, tmp_path):
    header, _ = encoded
    assert "encoder" not in header.part_bytes()
    parts = Parts(texture={"t": torch.ones(5)}, encoder={"weights": torch.arange(7.0)})
    header = container.save(tmp_path / "file", load_codec("pca")(), parts)
    sizes = {"decoder": 0, "texture": 20, "other": 0, "encoder": 28, "header": header.file_bytes - 48}
    assert header.part_bytes() == sizes
    assert container.read_parts(header.path)[1].encoder["weights"].equal(torch.arange(7.0))


def test_every_dtype_and_shape_comes_back():
    codec = load_codec("mean-colour")()
    dtypes = torch.float32, torch.float16, torch.bfloat16, torch.float64, torch.uint8, torch.int8, torch.int64
    tensors = {str(dtype): torch.ones(2, 3, dtype=dtype) for dtype in dtypes}
    tensors |= {"empty": torch.zeros(0, 3), "scalar": torch.tensor(1.0)}
    back = load(container.to_bytes(codec, Parts(other=tensors)))
    expected = {f"other/{name}": (tensor.dtype, tensor.shape) for name, tensor in tensors.items()}
    assert {name: (tensor.dtype, tensor.shape) for name, tensor in back.items()} == expected
