"""The fields that `info --json` writes: the numbers that its text shows."""

import json
from pathlib import Path

import numpy as np
import pytest

from bench import cli
from bench.codecs.container import read_header
from bench.codecs.loading import load
from bench.conformance.check import tiny_btf
from bench.data.readers import open_btf
from bench.material import layers, parameters


def written(*words):
    """What `info` writes as JSON, without any NaN."""
    assert cli.main(["info", *words, "--json", "about.json"]) == 0
    return json.loads(Path("about.json").read_text(), parse_constant=pytest.fail)


@pytest.fixture
def measured(tmp_path, monkeypatch):
    """A small BTF in a file whose notes hold a number that JSON lacks."""
    monkeypatch.chdir(tmp_path)
    btf = tiny_btf(12, 6, 6)
    notes = json.dumps({"gain": float("nan"), "lamp": "LED"})
    np.savez("cloth.npz", radiance=np.stack(list(btf)), wo=btf.wo, wi=btf.wi, provenance=notes)
    return "cloth.npz"


@pytest.mark.usefixtures("brief")
def test_of_a_codec_file(measured, monkeypatch):
    fit = ["--codec", "neubtf-direct", "--set", "steps=2"]
    assert cli.main(["encode", measured, *fit, "-o", "a.nbtf"]) == 0
    file, header, material = written("a.nbtf"), read_header(Path("a.nbtf")), load(Path("a.nbtf")).material
    assert (file["codec"], file["version"], file["settings"]) == (header.codec, header.version, header.settings)
    assert file["bytes"] == {"total": Path("a.nbtf").stat().st_size, **header.part_bytes()}
    assert sum(size for part, size in file["bytes"].items() if part != "total") == file["bytes"]["total"]
    assert file["sha256"] == header.sha256
    assert file["tensors"].keys() == header.tensors.keys()
    assert file["material"]["size"] == list(material.size)
    assert file["material"]["parameters"] == parameters(material)
    assert file["material"]["flops_per_sample"] == material.cost.flops_per_sample
    assert [tuple(layer.values()) for layer in file["material"]["layers"]] == layers(material)
    monkeypatch.setattr(type(material), "opaque", True)
    assert "another program" in written("a.nbtf")["material"]["decoder"]


def test_of_a_btf(measured):
    about, btf = written(measured), open_btf(Path(measured))
    split = btf.split()
    assert (about["name"], about["shape"], about["pairs"]) == (btf.name, list(btf.shape), len(btf))
    assert about["training"]["pairs"] == len(split.train)
    assert {name: part["pairs"] for name, part in about["heldout"].items()} == {
        name: len(pairs) for name, pairs in split.heldout.items()
    }
    every = np.stack(list(btf))
    assert about["values"]["minimum"] == pytest.approx(float(every.min()))
    assert about["values"]["maximum"] == pytest.approx(float(every.max()))
    assert about["fingerprint"] == btf.fingerprint
    assert (about["provenance"]["gain"], about["provenance"]["lamp"]) == (None, "LED")
    assert isinstance(about["warnings"], list)
