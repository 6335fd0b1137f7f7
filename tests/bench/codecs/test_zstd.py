import json
import sys
import zlib

import numpy as np
import pytest
import torch
import zstandard
from fuzz_codec_files import resealed

from bench.codec import Fit, Parts, settings_dict
from bench.codecs import container, loading
from bench.codecs.container import compressed, expanded
from bench.codecs.registry import load_codec
from bench.conformance.check import tiny_btf
from bench.inputs.errors import ContainerError, InputError
from bench.runs.suite import parse_suite, with_changes


def saved(path, **settings):
    codec = load_codec("table")(**settings)
    return container.save(path, codec, codec.encode(tiny_btf(), Fit()))


def test_a_compressed_file_is_smaller_and_decodes_to_the_same(tmp_path):
    plain, packed = saved(tmp_path / "plain.nbtf"), saved(tmp_path / "packed.nbtf", zstd="true")
    assert packed.file_bytes < plain.file_bytes
    assert sum(packed.part_bytes().values()) == packed.file_bytes == packed.path.stat().st_size
    assert packed.tensors["texture/zstd"][0] == "U8"
    assert (packed.settings.get("zstd"), "zstd" in plain.settings) == (True, False)
    one, other = (loading.load(header.path)[1].slice([0, 0, 1], [0, 0, 1]) for header in (plain, packed))
    assert one.equal(other)
    names = [sorted(container.read_parts(header.path)[1].other) for header in (plain, packed)]
    assert names[0] == names[1]


def test_a_suite_may_sweep_it_and_the_command_line_set_it():
    suite = parse_suite("test", '[[codecs]]\ncodec = "vq"\nzstd = [false, true]\n')
    assert [spec.label for spec in suite.codecs] == ["vq zstd=false", "vq zstd=true"]
    keys = [settings_dict(load_codec(spec.codec)(**spec.settings)).get("zstd") for spec in suite.codecs]
    assert keys == [None, True]
    changed = with_changes(parse_suite("test", '[[codecs]]\ncodec = "pca"\n'), [], [], {"pca.zstd": "yes"})
    assert changed.codecs[0].settings == {"zstd": True}
    with pytest.raises(InputError, match=r"zstd.*pca.*'maybe'"):
        load_codec("pca")(zstd="maybe")


def test_without_the_package_it_is_said_what_to_install(tmp_path, monkeypatch):
    header = saved(tmp_path / "packed.nbtf", zstd=True)
    monkeypatch.setitem(sys.modules, "zstandard", None)
    with pytest.raises(InputError, match=r"packed\.nbtf: .*neubtf-bench\[zstd\]"):
        loading.load(header.path)
    with pytest.raises(InputError, match=r"zstd.*neubtf-bench\[zstd\]"):
        compressed(b"data")
    loading.load(saved(tmp_path / "plain.nbtf").path)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"no frame at all",
        zstandard.ZstdCompressor().compress(b"no tensors at all"),
        zstandard.ZstdCompressor(write_content_size=False).compress(b"x" * 1000),
        zstandard.ZstdCompressor().compress(b"x" * 1000)[:-3],
    ],
)
def test_a_payload_that_is_not_sound_is_refused(tmp_path, data):
    payload = torch.from_numpy(np.frombuffer(data, np.uint8).copy())
    with pytest.raises(ContainerError, match=f"{tmp_path}"):
        expanded(payload, tmp_path, 1 << 20)


def a_part(tensors, body):
    """The bytes of a part before its compression."""
    text = json.dumps({"tensors": tensors}).encode()
    deflated = zlib.compress(text, wbits=-15)
    return container.LENGTHS.pack(len(deflated), len(text)) + deflated + body


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("zstd", a_part({"texture": {"mean": ["U8", 3]}}, b"12"), "compressed part.* 1 bytes"),
        ("zstd", a_part({"texture": {"mean": ["U8", 1]}}, b"12"), "compressed part.* 1 bytes"),
        ("zstd", a_part({"other": {"mean": ["U8", 2]}}, b"12"), "compressed part.*another"),
        ("mean", a_part({"texture": {"mean": ["U8", 2]}}, b"12"), "alone"),
    ],
)
def test_a_part_that_does_not_hold_what_it_says_is_refused(tmp_path, name, data, message):
    parts = Parts(texture={name: compressed(data)})
    path = container.save(tmp_path / "a.nbtf", load_codec("mean-colour")(), parts).path
    resealed(path, lambda fields, tensors: fields["settings"].update(zstd=True))
    with pytest.raises(ContainerError, match=message):
        container.read_parts(path)


def test_a_file_that_would_fill_the_memory_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("bench.codecs.container.LEAST_EXPANDED", 10_000)
    monkeypatch.setattr("bench.codecs.container.MOST_EXPANSION", 10)
    codec = load_codec("mean-colour")(zstd=True)
    header = container.save(tmp_path / "file", codec, Parts(texture={"mean": torch.zeros(64, 64, 3)}))
    assert header.file_bytes < 1000
    with pytest.raises(ContainerError, match=r"file.*too large"):
        loading.load(header.path)
