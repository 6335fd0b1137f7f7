from pathlib import Path

import pytest

import baselines
from bench import cli
from bench.btf.npz import write_npz
from bench.codecs import loading, shared
from bench.codecs.registry import load_codec
from bench.conformance.check import tiny_btf
from bench.runs.library import MATERIALS

FOLDER = Path(next(iter(baselines.__path__))) / "networks"
CODECS = {"rainer2020": 38_269, "biplane": 136_451}


@pytest.fixture(autouse=True)
def places(tmp_path, monkeypatch):
    monkeypatch.setenv("NEUBTF_SHARED", str(tmp_path / "shared"))
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("name", CODECS)
def test_a_shipped_network_decodes_and_is_the_one_described(name):
    codec = load_codec(name)
    network = shared.find_for(codec)
    assert network.path == FOLDER / f"{name}.nbtf"
    assert network.parts.decoder["weights"].shape == (CODECS[name],)
    assert len(network.origins) == MATERIALS
    assert network.settings == vars(codec.network().settings)  # `pretrain` makes the same
    assert f"| {network.file_bytes:,} | `{network.sha256}` |" in (FOLDER / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(("name", "settings"), [("rainer2020", []), ("biplane", ["--set", "steps=20"])])
def test_a_codec_with_a_shared_network_runs_out_of_the_box(name, settings, tmp_path):
    write_npz(tiny_btf(4, 4, 4), tmp_path / "tiny.npz")
    assert cli.main(["encode", "tiny.npz", "--codec", name, *settings, "-o", "tiny.nbtf"]) == 0
    assert loading.load(tmp_path / "tiny.nbtf").network.path == FOLDER / f"{name}.nbtf"
