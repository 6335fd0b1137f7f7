import os
from dataclasses import replace
from pathlib import Path

import pytest
from ubo2003_pca_write import random_codes, write_ubo2003_pca

from bench import cli, records
from bench.data.open import open_material
from bench.runs.suite import load_suite

GROUPS = {"new view", "new light", "both new"}


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


def test_choices_on_wool_see_no_test_pair():
    if "NEUBTF_DATA" not in os.environ:
        pytest.skip("NEUBTF_DATA is not set: it names the folder of real data")
    suite = load_suite("budgets")
    (spec,) = (spec for spec in suite.materials if spec.name == "wool")
    tests = open_material(spec, replace(suite.data, validation=False), lambda *_: None)
    choosing = open_material(spec, replace(suite.data, split="validation", validation=False), lambda *_: None)
    training_views = {tuple(w) for w in tests.wo[tests.split().train]}
    assert {tuple(w) for w in choosing.wo} == training_views
    assert set(choosing.split().heldout) == GROUPS
