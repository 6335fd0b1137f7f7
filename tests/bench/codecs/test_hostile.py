"""Codec files whose hash is sound and whose content is not: refused by name, or they answer with numbers."""

import json
import random
import struct

import fuzz_codec_files
import pytest
import torch

from bench.codec import Fit, Parts
from bench.codecs import container, loading
from bench.codecs.registry import load_codec
from bench.conformance.check import tiny_btf
from bench.errors import ContainerError


def resealed(path, change):
    """The file with its metadata and header changed, its hash computed again."""
    content = path.read_bytes()
    length = struct.unpack("<Q", content[:8])[0]
    header = json.loads(content[8 : 8 + length])
    metadata = json.loads(header.pop("__metadata__")[container.KEY])
    change(metadata, header)
    path.write_bytes(fuzz_codec_files.sealed(header, metadata, content[8 + length :]))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("codec", ["pca"]),
        ("version", "1"),
        ("version", 1e300),
        ("settings", [1]),
        ("settings", {"half": {"deep": 1}}),
        ("settings", {"half": float("nan")}),
        ("kind", 3),
        ("shared", 5),
        ("scene", "satin"),
        ("provenance", [1]),
    ],
)
def test_a_field_of_the_wrong_type_is_named(field, value, tmp_path):
    path = container.save(
        tmp_path / "a.nbtf", load_codec("mean-colour")(), Parts(texture={"mean": torch.ones(2, 2, 3)})
    )
    resealed(path.path, lambda metadata, header: metadata.update({field: value}))
    with pytest.raises(ContainerError, match=rf"a\.nbtf.*{field}"):
        loading.load(path.path)


def saved(tmp_path, name, **settings):
    codec = load_codec(name)(**settings)
    return codec, codec.encode(tiny_btf(5, 3, 3), Fit(seed=1))


def refused(tmp_path, codec, parts):
    with pytest.raises(ContainerError) as raised:
        loading.load(container.save(tmp_path / "a.nbtf", codec, parts).path)
    return str(raised.value)


def test_missing_bits_of_an_index_are_noticed(tmp_path):
    codec, parts = saved(tmp_path, "vq", codes=5)
    parts.texture["index0"] = parts.texture["index0"][:-1]
    assert "a texture of this file holds" in refused(tmp_path, codec, parts)


def test_sizes_that_no_byte_holds_are_refused_before_memory_is_taken(tmp_path):
    codec, parts = saved(tmp_path, "vq", codes=1)
    parts.other["size"] = torch.tensor([2**30, 2**30], dtype=torch.int32)
    assert "an index of" in refused(tmp_path, codec, parts)
    codec, parts = saved(tmp_path, "neumip", steps=1, batch=16)
    parts.other["size"] = torch.tensor([2**30, 2**30], dtype=torch.int32)
    assert "not what codec neumip wrote" in refused(tmp_path, codec, parts)


def test_a_table_of_other_pairs_is_refused(tmp_path):
    codec, parts = saved(tmp_path, "pca", components=2)
    parts.other["pairs"] = parts.other["pairs"][:-1]
    assert "its pairs are not those of its table" in refused(tmp_path, codec, parts)


def test_numbers_that_are_not_finite_are_refused(tmp_path):
    path = container.save(
        tmp_path / "a.nbtf", load_codec("mean-colour")(), Parts(texture={"mean": torch.ones(2, 2, 3)})
    )
    content = path.path.read_bytes()
    length = struct.unpack("<Q", content[:8])[0]
    path.path.write_bytes(content[: 8 + length] + torch.full((12,), torch.nan).numpy().tobytes())
    resealed(path.path, lambda metadata, header: None)
    with pytest.raises(ContainerError, match="texture/mean holds numbers that are not finite"):
        loading.load(path.path)


def test_random_mutations_are_the_same_in_every_run(tmp_path):
    fuzz_codec_files.small("pca", tmp_path)
    content = next(tmp_path.iterdir()).read_bytes()
    assert fuzz_codec_files.mutated(content, random.Random("a")) == fuzz_codec_files.mutated(
        content, random.Random("a")
    )


def test_a_compressed_part_that_is_not_bytes_is_refused(tmp_path):
    path = container.save(
        tmp_path / "a.nbtf", load_codec("mean-colour")(), Parts(texture={"zstd": torch.ones(8, dtype=torch.bfloat16)})
    ).path
    resealed(path, lambda metadata, header: metadata["settings"].update(zstd=True))
    with pytest.raises(ContainerError, match=r"a\.nbtf: a compressed part is torch\.bfloat16, not bytes"):
        loading.load(path)
