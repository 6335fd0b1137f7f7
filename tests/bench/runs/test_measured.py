"""The suites of measured and path-traced surfaces: what they name is there, opens at their size, keeps pairs apart."""

import os
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image
from ubo2003_pca_write import random_codes, write_ubo2003_pca

from bench import cli, records
from bench.data.open import open_material
from bench.runs.suite import load_suite

GROUPS = {"new view", "new light", "both new"}


@pytest.mark.parametrize(("name", "texels", "count"), [("measured", 128, 5), ("measured-small", 64, 3)])
def test_the_materials_of_the_suites_open_at_their_size(name, texels, count):
    if "NEUBTF_DATA" not in os.environ:
        pytest.skip("NEUBTF_DATA is not set: it names the folder of real data")
    suite = load_suite(name)
    assert len(suite.materials) == count
    for spec in suite.materials:
        btf = open_material(spec, suite.data, lambda *_: None)
        assert texels <= min(btf.shape) < 1.5 * texels  # whole boxes
        assert set(btf.split().heldout) == (GROUPS if len(btf.layout.views) > 1 else {"new light"})


def test_every_codec_of_standard_is_measured():
    standard, measured = (load_suite(name) for name in ("standard", "measured"))
    assert [spec.label for spec in measured.codecs] == [spec.label for spec in standard.codecs]


def test_the_small_suite_runs_on_what_is_there_and_reports_each_kind_of_new_pairs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("NEUBTF_DATA", str(tmp_path))
    monkeypatch.setenv("NEUBTF_CACHE", str(tmp_path / "cache"))
    write_ubo2003_pca(tmp_path / "ubo2003_local_pca" / "wool" / "3_8", *random_codes(4))
    words = ["run", "measured-small", "--codec", "mean-colour", "--out", str(tmp_path / "run")]
    assert cli.main([*words, "--set", "data.texels=2", "--set", "data.scored=30"]) == 0, capsys.readouterr()
    jobs = {job["material"]: job for job in records.load_run(tmp_path / "run").jobs}
    assert jobs["wool"]["shape"] == [2, 2]
    assert {group.removeprefix("heldout, ") for group in jobs["wool"]["scores"]} >= GROUPS
    assert jobs["impalla"]["status"] == "unavailable"
    assert "docs/datasets.md says how to clone it" in jobs["impalla"]["error"]


def test_the_path_traced_suite_asks_every_codec_and_says_what_it_needs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    standard, baked = (load_suite(name) for name in ("standard", "baked"))
    assert [spec.label for spec in baked.codecs] == [spec.label for spec in standard.codecs]
    for name in ("albedo", "roughness"):
        (tmp_path / "svbrdf" / "rock").mkdir(parents=True, exist_ok=True)
        Image.new("RGB", (8, 8), "grey").save(tmp_path / "svbrdf" / "rock" / f"{name}.png")
    monkeypatch.setenv("NEUBTF_DATA", str(tmp_path))
    monkeypatch.setenv("NEUBTF_CACHE", str(tmp_path / "cache"))
    monkeypatch.setitem(sys.modules, "bench.demand.mitsuba.path_tracer", None)
    monkeypatch.delattr("bench.demand.mitsuba.path_tracer", raising=False)
    words = ["run", "baked", "--material", "rock", "--codec", "mean-colour", "--out", str(tmp_path / "run")]
    assert cli.main([*words, "--set", "data.size=4"]) == 4
    (job,) = records.load_run(tmp_path / "run").jobs
    assert job["status"] == "unavailable"
    assert 'pip install "neubtf-bench[mitsuba]"' in job["error"]


def test_choices_on_wool_see_no_test_pair(monkeypatch):
    if "NEUBTF_DATA" not in os.environ:
        pytest.skip("NEUBTF_DATA is not set: it names the folder of real data")
    suite = load_suite("measured-small")
    spec = next(spec for spec in suite.materials if spec.name == "wool")
    tests = open_material(spec, suite.data, lambda *_: None)
    choosing = open_material(spec, replace(suite.data, split="validation"), lambda *_: None)
    training_views = {tuple(w) for w in tests.wo[tests.split().train]}
    assert {tuple(w) for w in choosing.wo} == training_views
    assert set(choosing.split().heldout) == GROUPS
