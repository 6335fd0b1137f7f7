import os
from dataclasses import replace
from pathlib import Path

import pytest
from ubo2003_pca_write import random_codes, write_ubo2003_pca

from bench import cli, records
from bench.conformance.check import tiny_btf
from bench.data.convert import write_btf
from bench.data.open import open_material
from bench.runs.suite import load_suite

GROUPS = {"new view", "new light", "both new"}


@pytest.mark.long
def test_with_nothing_held_out_all_pairs_are_fitted_and_decide(
    tmp_path: Path, brief: None, undrawn: None, untimed: None, capsys: pytest.CaptureFixture[str]
) -> None:
    write_btf(tiny_btf(12, 6, 6), tmp_path / "a.npz")
    folder = tmp_path / "run"
    words = ["run", "quick", "--material", str(tmp_path / "a.npz"), "--codec", "mean-colour", "--codec", "pca"]
    words += ["--set", "pca.components=2", "--out", str(folder)]
    jobs = []
    for change in ([], ["--set", "data.holdout=0"], ["--set", "data.holdout=0", "--set", "data.scored=20"]):
        assert cli.main([*words, *change]) == 0, capsys.readouterr()
        job, _ = records.load_run(folder).jobs  # the latest records: no earlier one stands for another split
        jobs.append(job)
    usual, whole, some = jobs
    assert (usual["pairs"]["train"], usual["pairs"]["heldout"]) == (25, 11)
    assert (whole["pairs"]["train"], "heldout" in whole["pairs"]) == (36, False)
    assert (records.deciding_group(usual["scores"]), records.deciding_group(whole["scores"])) == ("heldout", "all")
    assert whole["fit_key"]["training"] not in (usual["fit_key"]["training"], usual["score_key"]["btf"])
    assert whole["score_key"]["btf"] != usual["score_key"]["btf"]
    assert whole["scores"]["all"]["slices"] == 36
    assert some["fit_key"] == whole["fit_key"]
    assert some["scores"]["train"]["slices"] == 20
    for kind in ("main", "summary"):
        assert cli.main(["table", kind, str(folder)]) == 0
        assert f"{some['scores']['all']['metrics']['psnr_display']['mean']:.2f}" in capsys.readouterr().out
    assert cli.main(["report", str(folder)]) == 0
    assert cli.main(["compare", str(folder), str(folder)]) == 0


@pytest.mark.long
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
    assert "docs/datasets.md" in jobs["impalla"]["error"]


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
