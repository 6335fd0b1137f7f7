import json
from pathlib import Path

import pytest

from bench.compare.publishing import published, published_job
from bench.compare.reference import committed
from bench.inputs.errors import InputError
from bench.records import Run, load_run

RESULTS = Path(__file__).parents[3] / "docs" / "results"


def test_what_is_published_names_no_home_folder(tmp_path, monkeypatch):
    monkeypatch.setattr(Path, "home", lambda: Path("/home/somebody"))
    job = {"kind": "job", "job": "satin/pca/0", "run": "1", "status": "failed", "error": "/home/somebody/a.nbtf: short"}
    fine = {"kind": "job", "job": "satin/vq/0", "run": "1", "status": "ok"}
    fine["scores"] = {name: {"metrics": {}} for name in ("all", "heldout", "heldout, far", "grazing view", "low light")}
    fine |= {"fit_key": {}, "score_key": {}, "provenance": {}, "file": "files/a.nbtf"}
    fine["between"] = {"mean": 20.5, "centres": 30.25, "slices": 20}
    run = Run(tmp_path)
    for record in (fine, job):
        run.jobs.put(record["job"], record)
    lines = [json.loads(line) for line in published(run).splitlines()]
    assert [line.get("error") for line in lines] == [None, "~/a.nbtf: short"]
    assert lines[0]["between"] == fine["between"]
    assert list(lines[0]["scores"]) == ["all", "heldout", "heldout, far", "low light"]


def test_a_loaded_record_has_what_its_file_says_once(tmp_path):
    run = Run(tmp_path, starts=[{"kind": "run", "run": "1"}, {"kind": "run", "run": "2"}])
    curve = [{"step": 10, "seconds": 0.5, "psnr": 25.0}, {"step": 20, "seconds": 1.0, "psnr": 31.0}]
    for name, start, space in (
        ("a", "1", "display"),
        ("b", "1", "display"),
        ("c", "2", "display"),
        ("d", "2", "log1p"),
    ):
        facts = {"psnr_display": {"unit": "dB", "direction": "higher", "space": space, "version": 2}}
        score = {"slices": 9, "metrics": {"psnr_display": {"mean": 20.5, "pooled": 19.5}}}
        job = {"kind": "job", "job": f"satin/{name}/0", "run": start, "material": "satin", "codec": name, "label": name}
        job |= {"seed": 0, "status": "ok", "settings": {"half": True}, "bytes": {"total": 9}, "parameters": 0}
        job |= {"fit_key": {"version": 3, "settings": {"half": True}}, "score_key": {"metrics": {"psnr_display": 2}}}
        job |= {"metrics": facts, "scores": {"heldout": score}, "history": curve}
        run.jobs.put(job["job"], job)
    path = tmp_path / "a.jsonl"
    path.write_text(published(run))
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    assert ["metrics" in line for line in lines] == [True, False, False, False, True, True]
    assert lines[2]["history"] == {"step": [10, 20], "seconds": [0.5, 1.0], "psnr": [25.0, 31.0]}
    assert "settings" not in lines[2]["fit_key"]
    assert list(load_run(path).jobs) == [published_job(job, tmp_path) for job in run.jobs]
    assert published(load_run(path)) == path.read_text()


def test_counts_of_slices_are_published_where_a_slice_is_exact_or_a_number_is_missing(tmp_path):
    job = {"kind": "job", "job": "satin/pca/0", "status": "ok", "pairs": {"train": 4, "heldout": 2, "heldout, new": 1}}
    counts = {"exact": 0, "slices": 2}
    numbers = {"psnr_display": {"mean": 30.5, **counts}, "ssim": {"mean": 0.5, "exact": 1, "slices": 2}}
    numbers |= {"flip_ldr": {"mean": None, **counts}}
    numbers |= {"rmse_linear": {"mean": 0.5, "std": 0.1, "pooled": 0.6, "relative": 0.2, **counts}}
    job |= {"scores": {"heldout": {"slices": 2, "metrics": numbers}}}
    job |= {"footprints": {"1": {"psnr_display": 29.5, "mean": 30.5, **counts}, "2": {"psnr_display": 29.5}}}
    job |= {"cost": {"parameters": 7, "texture_channels": 3, "texture_floats": 9, "flops_per_sample": 5}}
    line = published_job(job, tmp_path)
    metrics = line["scores"]["heldout"]["metrics"]
    assert metrics["psnr_display"] == {"mean": 30.5}
    assert metrics["ssim"] == numbers["ssim"]
    assert metrics["flip_ldr"] == numbers["flip_ldr"]
    assert metrics["rmse_linear"] == {"pooled": 0.6, "relative": 0.2}
    assert line["footprints"] == {"1": {"psnr_display": 29.5, "mean": 30.5}, "2": {"psnr_display": 29.5}}
    assert line["pairs"] == {"train": 4, "heldout": 2}
    assert line["cost"] == {"texture_channels": 3, "flops_per_sample": 5}
    assert job["footprints"]["1"]["slices"] == 2  # the record itself is left alone


def test_a_reference_is_not_published():
    with pytest.raises(InputError, match=r"satin/mean-colour/0 has no 'run'.*: give the folder"):
        published(load_run(committed("ci")))


def test_the_published_records_are_small():
    assert sum(path.stat().st_size for path in RESULTS.rglob("*.jsonl")) < 8_000_000
