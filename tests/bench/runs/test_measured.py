"""The suite of budgets: what it names is there, opens at its size, keeps pairs apart, and asks every codec alike."""

import os
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image
from ubo2003_pca_write import random_codes, write_ubo2003_pca

from bench import cli, records
from bench.codecs.registry import codec_entries, load_codec
from bench.data.open import open_material
from bench.runs.suite import load_suite

GROUPS = {"new view", "new light", "both new"}
ONE_SETTING = {"svbrdf", "hsh", "tucker", "triple-plane", "neuralbtf", "hierarchical", "mean-colour"}
TWO = {"neubtf", "rainer2020", "biplane"}
FULL = 10_000  # steps of every learned codec


def measured():
    if "NEUBTF_DATA" not in os.environ:
        pytest.skip("NEUBTF_DATA is not set: it names the folder of real data")
    suite = load_suite("budgets")
    return suite, [spec for spec in suite.materials if "ubo2003" in spec.path]


def test_every_codec_has_its_rungs_and_the_same_steps():
    rungs: dict[str, list[dict]] = {}
    for spec in load_suite("budgets").codecs:
        rungs.setdefault(spec.codec, []).append(spec.settings)
    assert rungs.keys() == codec_entries().keys() - {"table"}
    for codec, settings in rungs.items():
        assert len(settings) == (
            1 if codec in ONE_SETTING else 2 if codec in ("neubtf", "rainer2020", "biplane") else 4
        )
        if "steps" in load_codec(codec).Settings.__dataclass_fields__:
            fitted = codec not in ("svbrdf", "rainer2020", "biplane")  # the last two fit their shared networks
            assert not fitted or {each.get("steps") for each in settings} == {FULL}


def test_measured_surfaces_open_at_their_size_and_hold_three_kinds_of_pairs_out():
    suite, specs = measured()
    assert len(specs) == 3
    for spec in specs:
        btf = open_material(spec, suite.data, lambda *_: None)
        assert btf.shape == (128, 128)
        assert set(btf.split().heldout) == GROUPS
        assert btf.validation is not None


def test_the_suite_runs_on_what_is_there_and_reports_each_kind_of_new_pairs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("NEUBTF_DATA", str(tmp_path))
    monkeypatch.setenv("NEUBTF_CACHE", str(tmp_path / "cache"))
    write_ubo2003_pca(tmp_path / "ubo2003_local_pca" / "wool" / "3_8", *random_codes(4))
    words = ["run", "budgets", "--codec", "mean-colour", "--out", str(tmp_path / "run")]
    words += [word for name in ("wool", "impalla") for word in ("--material", name)]
    words += ["--set", "data.texels=2", "--set", "data.scored=30"]
    assert cli.main(words) == 0, capsys.readouterr()
    jobs = {job["material"]: job for job in records.load_run(tmp_path / "run").jobs}
    assert jobs["wool"]["shape"] == [2, 2]
    assert {group.removeprefix("heldout, ") for group in jobs["wool"]["scores"]} >= GROUPS
    assert jobs["impalla"]["status"] == "unavailable"
    assert "docs/datasets.md says how to clone it" in jobs["impalla"]["error"]


def test_path_traced_surfaces_say_what_they_need(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("albedo", "roughness"):
        (tmp_path / "svbrdf" / "rock").mkdir(parents=True, exist_ok=True)
        Image.new("RGB", (8, 8), "grey").save(tmp_path / "svbrdf" / "rock" / f"{name}.png")
    monkeypatch.setenv("NEUBTF_DATA", str(tmp_path))
    monkeypatch.setenv("NEUBTF_CACHE", str(tmp_path / "cache"))
    monkeypatch.setitem(sys.modules, "bench.demand.mitsuba.path_tracer", None)
    monkeypatch.delattr("bench.demand.mitsuba.path_tracer", raising=False)
    words = ["run", "budgets", "--material", "rock", "--codec", "mean-colour", "--out", str(tmp_path / "run")]
    assert cli.main([*words, "--set", "data.size=4"]) == 4
    (job,) = records.load_run(tmp_path / "run").jobs
    assert job["status"] == "unavailable"
    assert 'pip install "neubtf-bench[mitsuba]"' in job["error"]


def test_choices_on_wool_see_no_test_pair():
    suite, specs = measured()
    spec = next(spec for spec in specs if spec.name == "wool")
    tests = open_material(spec, replace(suite.data, validation=False), lambda *_: None)
    choosing = open_material(spec, replace(suite.data, split="validation", validation=False), lambda *_: None)
    training_views = {tuple(w) for w in tests.wo[tests.split().train]}
    assert {tuple(w) for w in choosing.wo} == training_views
    assert set(choosing.split().heldout) == GROUPS
