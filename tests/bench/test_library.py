"""`import bench` as a library: the example of docs/api.md, and what each function promises."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

import bench
from bench import cli
from bench.codecs import container
from bench.codecs.registry import load_codec
from bench.conformance.check import tiny_btf
from bench.data.readers.folder import write_folder
from bench.errors import ContainerError, InputError
from bench.records import load_run
from tests.bench.outside import install

PAGE = Path(__file__).parents[2] / "docs" / "api.md"


@pytest.fixture(autouse=True)
def small(tmp_path, monkeypatch):
    monkeypatch.setenv("NEUBTF_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("bench.timing.SAMPLES", 3)
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def folder(tmp_path):
    write_folder(tiny_btf(12, 6, 6), tmp_path / "btf")
    return tmp_path / "btf"


def test_the_example_of_the_page_runs_and_has_ten_lines(capsys):
    example = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)[0]
    assert len([line for line in example.splitlines() if line and "import" not in line]) <= 10
    names = {}
    exec(example, names)
    assert names["rgb"].shape == (1, 3)
    assert isinstance(names["rgb"], np.ndarray)
    assert "(32, 32) 101" in capsys.readouterr().out


def test_a_plain_script_with_a_codec_from_outside_runs_once(tmp_path):
    """Without a guard of `__main__`: what tries the codec in another process must not run the script again there."""
    text = "from baselines.pca import PCA\n\nclass Mine(PCA):\n    name = 'mine'\n"
    site = install(tmp_path / "site", "mine", {"mine": "mine:Mine"}, {"mine": text})
    example = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)[0]
    (tmp_path / "script.py").write_text(example.replace('"pca"', '"mine"'))
    path = os.pathsep.join([str(site), os.environ.get("PYTHONPATH", "")])
    command, environment = [sys.executable, "script.py"], os.environ | {"PYTHONPATH": path}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("(32, 32) 101") == 1


def test_a_fit_to_a_scene_without_a_demand_is_refused(folder, tmp_path, capsys):
    with pytest.raises(InputError, match="codec pca: scene = true needs the demand of a scene"):
        bench.encode(bench.open(folder), "pca", tmp_path / "a.nbtf", scene=True)
    assert cli.main(["encode", str(folder), "--codec", "pca", "--set", "scene=true", "-o", "a.nbtf"]) == 2
    assert "scene = true needs the demand of a scene" in capsys.readouterr().err
    assert not (tmp_path / "a.nbtf").exists()


def test_every_name_of_the_page_is_there():
    for name in re.findall(r"^\| `bench\.(\w+)", PAGE.read_text(encoding="utf-8"), re.M):
        assert name in dir(bench)
        assert getattr(bench, name)
    with pytest.raises(AttributeError, match="no attribute 'scores'"):
        _ = bench.scores


def test_a_file_of_a_run_scores_what_its_record_says(tmp_path, folder):
    words = ["run", "quick", "--out", "run", "--material", str(folder), "--codec", "pca", "--set", "components=3"]
    assert cli.main(words) == 0
    (job,) = load_run(tmp_path / "run").jobs
    found = bench.score(tmp_path / "run" / job["file"], bench.open(folder))
    assert found["score_key"] == job["score_key"]
    for part in ("scores", "footprints", "bytes", "parameters", "cost", "pairs", "settings"):
        assert found[part] == job[part], part


def test_encoding_takes_a_name_with_settings_or_a_codec(folder):
    btf = bench.open(folder)
    header = bench.encode(btf, "pca", "a.nbtf", components="3")
    assert header.settings["components"] == 3
    made = load_codec("pca")(components=3)
    assert bench.encode(btf, made, "b.nbtf").sha256 == header.sha256
    with pytest.raises(InputError, match="has its settings already: give components"):
        bench.encode(btf, made, "c.nbtf", components=4)
    with pytest.raises(InputError, match="did you mean 'size'"):
        bench.open("satin", sise=8)


def test_a_file_of_another_resolution_is_not_scored(folder):
    btf = bench.open(folder)
    bench.encode(btf, "mean-colour", "a.nbtf")
    with pytest.raises(InputError, match=r"decodes to 12 × 12 texels, and .* has 6 × 6"):
        bench.score("a.nbtf", btf.downsample(2))
    Path("a.nbtf").write_bytes(b"no codec file")
    with pytest.raises(ContainerError):
        bench.score("a.nbtf", btf)


def test_the_command_prints_the_table_of_a_run_and_writes_json(folder, capsys):
    import json

    assert cli.main(["encode", str(folder), "--codec", "pca", "--set", "components=3", "-o", "a.nbtf"]) == 0
    capsys.readouterr()
    assert cli.main(["score", "a.nbtf", str(folder), "--json", "a.json"]) == 0
    shown = capsys.readouterr().out
    assert "pca bits=0" in shown
    assert "components=3" in shown
    assert f"{Path('a.nbtf').stat().st_size:,}" in shown
    found = json.loads(Path("a.json").read_text())
    pooled = found["scores"]["heldout"]["metrics"]["psnr_display"]["pooled"]
    assert f"{pooled:.2f}" in shown
    assert container.read_header("a.nbtf").sha256 == found["score_key"]["sha256"]
    assert cli.main(["score", "a.nbtf", str(folder), "--set", "components=4"]) == 2
    assert "only data.KEY" in capsys.readouterr().err


def test_version_and_author_are_the_same_wherever_they_stand():
    root = PAGE.parents[1]
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    citation = (root / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {project['version']}\n" in citation
    assert f"- name: {project['authors'][0]['name']}\n" in citation
    assert project["authors"][0]["name"] in (root / "LICENSE").read_text(encoding="utf-8")
    assert bench.__version__ == project["version"]
