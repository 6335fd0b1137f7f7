"""A reader of codec files that shares no code with the suite: what "Reading a file in another language" says is enough.

It is the section of docs/sharing.md, in the standard library and NumPy.
"""

import hashlib
import json
import struct
import zlib

import numpy as np
import pytest
import torch

from bench.codec import Fit
from bench.codecs import container
from bench.codecs.registry import load_codec
from bench.conformance.check import tiny_btf

DTYPES = {"F64": "<f8", "F32": "<f4", "F16": "<f2", "BF16": "<u2", "I64": "<i8", "I32": "<i4", "I16": "<i2"}
DTYPES |= {"I8": "i1", "U8": "u1", "BOOL": "?"}


def other_reader(data):
    """The header of a codec file, and its tensors by part and name; BF16 as the upper half of a float32."""
    magic, version, deflated, expanded, digest = struct.unpack("<4sBII32s", data[:45])
    assert (magic, version) == (b"NBTF", 2)
    assert hashlib.sha256(data[:13] + bytes(32) + data[45:]).digest() == digest
    text = zlib.decompress(data[45 : 45 + deflated], wbits=-15)
    assert len(text) == expanded
    header = json.loads(text)
    tensors, at = {}, 45 + deflated
    for part, named in header["tensors"].items():
        for name, (dtype, *shape) in named.items():
            count = int(np.prod(shape, dtype=np.int64))
            values = np.frombuffer(data, DTYPES[dtype], count, at)
            at += values.nbytes
            if dtype == "BF16":
                values = (values.astype(np.uint32) << 16).view(np.float32)
            tensors[part, name] = values.reshape(shape)
    assert at == len(data)
    return header, tensors


@pytest.mark.parametrize(
    ("name", "settings"), [("relief", {"steps": 1, "batch": 16}), ("pca", {"components": 2}), ("vq", {"codes": 5})]
)
def test_it_finds_what_was_written(name, settings, tmp_path):
    codec = load_codec(name)(**settings)
    parts = codec.encode(tiny_btf(5, 3, 3), Fit(seed=1))
    parts.other.update(brain=torch.tensor([1.5, -2]).bfloat16(), truth=torch.tensor([True, False]))
    written = container.save(tmp_path / "a.nbtf", codec, parts)
    header, tensors = other_reader(written.path.read_bytes())
    assert (header["codec"], header["version"], header["settings"]) == (name, codec.version, written.settings)
    assert len(tensors) == len(written.tensors)
    for part in container.PARTS:
        for each, tensor in getattr(parts, part).items():
            found = tensors[part, each]
            assert found.shape == tensor.shape
            assert np.array_equal(found, tensor.float() if tensor.dtype == torch.bfloat16 else tensor)
