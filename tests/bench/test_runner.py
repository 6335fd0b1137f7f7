import json
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch

from baselines.mean_colour import MeanColour
from bench import container
from bench.check import tiny_btf
from bench.errors import InputError, MissingDataError
from bench.job import seed_of
from bench.records import FILE, load_run
from bench.runner import Options, run
from bench.suite import CodecSpec, MaterialSpec, Suite

SUITE = Suite(
    "test",
    "",
    threads=1,
    materials=(MaterialSpec("tiny"),),
    codecs=(CodecSpec("mean-colour"), CodecSpec("pca", {"components": 4})),
)


@pytest.fixture(autouse=True)
def tiny(monkeypatch):
    """Every material of these suites is the tiny one, larger than SSIM's window."""
    monkeypatch.setattr("bench.workbench.open_material", lambda spec, data, show: tiny_btf(12, 6, 6))
    monkeypatch.setattr("bench.timing.SAMPLES", 3)


def outcomes(folder, suite=SUITE, **options):
    return list(run(suite, Options(folder, **options)))


def test_a_run_leaves_records_files_and_what_reports_need(tmp_path):
    done = outcomes(tmp_path)
    stored = load_run(tmp_path)
    assert [o.record for o in done] == list(stored.jobs)
    for job in stored.jobs:
        path = tmp_path / job["file"]
        assert job["bytes"]["total"] == path.stat().st_size == sum(v for k, v in job["bytes"].items() if k != "total")
        assert job["score_key"]["sha256"] == container.read_header(path).sha256
        assert stored.timing(job)["ns_per_sample"] > 0
        with np.load(tmp_path / job["slices"]) as slices:
            assert slices["psnr_display"].shape == (36,)
            assert slices["abrdf"].shape == (12, 12)
        assert json.loads((tmp_path / job["angular"]).read_text())["polar"]
        assert job["footprints"].keys() == {"1", "2", "4", "8"}
    assert stored.starts[0]["packages"]["torch"] == torch.__version__


def test_what_is_scored_is_what_the_file_decodes_to(tmp_path):
    job = outcomes(tmp_path)[1].record
    material = container.load(tmp_path / job["file"])[1]
    btf = tiny_btf(12, 6, 6)
    exposure = job["score_key"]["exposure"]
    from bench.metrics.display import to_display

    heldout = np.concatenate(list(btf.split().heldout.values()))
    errors = [
        np.square(
            to_display(btf[i], exposure)
            - to_display(material.slice(btf.wo[i].tolist(), btf.wi[i].tolist()).numpy(), exposure)
        ).mean()
        for i in heldout
    ]
    pooled = job["scores"]["heldout"]["metrics"]["psnr_display"]["pooled"]
    assert pooled == pytest.approx(-10 * np.log10(np.mean(errors)), abs=1e-4)


def test_a_second_run_does_nothing_again_but_the_timing(tmp_path):
    first = outcomes(tmp_path)
    timed = load_run(tmp_path).timings
    second = outcomes(tmp_path)
    assert [o.cached for o in second] == ["record", "record"]
    assert [o.record for o in second] == [o.record for o in first]
    assert [t["run"] for t in load_run(tmp_path).timings] != [t["run"] for t in timed]
    assert [o.cached for o in outcomes(tmp_path, fresh=True)] == ["", ""]


def test_a_changed_metric_scores_again_and_fits_nothing(tmp_path, monkeypatch):
    outcomes(tmp_path)
    files = {path: path.stat().st_mtime_ns for path in (tmp_path / "files").iterdir()}
    from bench.metrics import get

    newer = {"ssim_periodic": 99}
    monkeypatch.setattr("bench.evaluation.get_metric", lambda name: replace(get(name), version=newer.get(name, 1)))
    again = outcomes(tmp_path)
    assert [o.cached for o in again] == ["file", "file"]
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "files").iterdir()} == files
    assert again[0].record["fit_seconds"] > 0


def test_a_changed_setting_or_seed_fits_again(tmp_path):
    outcomes(tmp_path)
    changed = Suite("test", "", threads=1, materials=SUITE.materials, codecs=(CodecSpec("pca", {"components": 3}),))
    assert [o.cached for o in outcomes(tmp_path, changed)] == [""]
    assert len(load_run(tmp_path).jobs) == 3


class Failing(MeanColour):
    """Fails while `broken`, whatever it is asked."""

    broken = True

    @dataclass(frozen=True)
    class Settings:
        half: bool = True

    def encode(self, btf, fit):
        if Failing.broken:
            raise RuntimeError("no such luck")
        return super().encode(btf, fit)


def test_a_failure_is_a_record_and_is_retried_only_when_asked(tmp_path, monkeypatch):
    monkeypatch.setattr("bench.job.load_codec", lambda name: Failing)
    only = Suite("test", "", threads=1, materials=SUITE.materials, codecs=(CodecSpec("mean-colour"),))
    monkeypatch.setattr(Failing, "broken", True)
    failed = outcomes(tmp_path, only)[0]
    assert failed.record["status"] == "failed"
    assert failed.record["error"] == "RuntimeError: no such luck"
    assert "encode" in failed.record["traceback"]
    assert not list(tmp_path.rglob("files/*"))
    monkeypatch.setattr(Failing, "broken", False)
    assert outcomes(tmp_path, only)[0].record["status"] == "failed"
    assert outcomes(tmp_path, only, retry_failed=True)[0].record["status"] == "ok"


def test_material_that_is_not_there_is_a_row_that_says_where_to_get_it(tmp_path, monkeypatch):
    def missing(spec, data, show):
        raise MissingDataError("not there: ask the library")

    monkeypatch.setattr("bench.workbench.open_material", missing)
    done = outcomes(tmp_path)
    assert [o.record["status"] for o in done] == ["unavailable", "unavailable"]
    assert done[0].record["error"] == "not there: ask the library"


def test_a_bad_setting_stops_the_run_before_anything_is_written(tmp_path):
    bad = Suite("test", "", materials=SUITE.materials, codecs=(CodecSpec("pca", {"componentz": 4}),))
    with pytest.raises(InputError, match="componentz"):
        outcomes(tmp_path / "run", bad)
    assert not (tmp_path / "run").exists()


def test_a_file_cut_in_the_cache_fails_the_job_by_name(tmp_path):
    job = outcomes(tmp_path)[0].record
    path = tmp_path / job["file"]
    path.write_bytes(path.read_bytes()[:-10])
    again = outcomes(tmp_path)[0].record
    assert again["status"] == "failed"
    assert "truncated" in again["error"]
    assert outcomes(tmp_path, fresh=True)[0].record["status"] == "ok"


def test_groups_cover_training_heldout_and_the_hull(tmp_path):
    job = outcomes(tmp_path)[0].record
    pairs = job["pairs"]
    assert pairs["all"] == 36
    assert pairs["train"] + pairs["heldout"] == 36
    assert pairs.get("heldout, inside hull", 0) + pairs.get("heldout, outside hull", 0) == pairs["heldout"]
    assert {"heldout, new view", "heldout, new light", "heldout, both new"} <= pairs.keys()


def test_seeds_follow_their_named_parts_alone():
    assert seed_of("satin", "pca", 0) == seed_of("satin", "pca", 0)
    assert len({seed_of("satin", "pca", 0), seed_of("satin", "pca", 1), seed_of("satin", "vq", 0)}) == 3
    assert 0 <= seed_of("x") < 2**63


def test_a_failed_write_of_records_is_not_hidden(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        outcomes(tmp_path / "file" / "run")
    assert not (tmp_path / FILE).exists()
