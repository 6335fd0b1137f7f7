import errno
import json
import os
import re
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
import torch

from baselines.mean_colour import MeanColour, MeanColourMaterial
from bench.codecs import container, loading
from bench.compare.comparison import compare
from bench.conformance.check import tiny_btf
from bench.data.open import open_material
from bench.data.spec import MaterialSpec, Preparation
from bench.demand.collect import collect
from bench.demand.scene import parse_scene
from bench.demand.text_scene import TextScene
from bench.inputs.errors import CodecError, ContainerError, InputError
from bench.metrics import get
from bench.metrics.display import to_display
from bench.records import FILE, load_run
from bench.runs import runner
from bench.runs.evaluation import material_of_job
from bench.runs.executors import InProcess, Workers
from bench.runs.runner import Options, run
from bench.runs.suite import CodecSpec, Suite

CODECS = (CodecSpec("mean-colour"), CodecSpec("pca", {"components": 4}))
SUITE = Suite("test", "", threads=1, materials=(MaterialSpec("tiny"),), codecs=CODECS)
MEAN = replace(SUITE, codecs=CODECS[:1])


@pytest.fixture(autouse=True)
def tiny(monkeypatch, undrawn):
    """Every material of these suites is the tiny one, larger than SSIM's window."""
    monkeypatch.setattr("bench.runs.workbench.open_material", lambda *_: tiny_btf(12, 6, 6))
    monkeypatch.setattr("bench.timing.TURNS", 3)


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


def test_the_jobs_left_are_told_and_after_a_fit_how_long_they_take(tmp_path):
    said = []
    assert [o.progress for o in outcomes(tmp_path, MEAN, say=said.append)] == ["1 of 1 jobs"]
    done = outcomes(tmp_path, replace(SUITE, seeds=(0, 1)), say=said.append)
    assert said == ["1 of 1 jobs to do", "3 of 4 jobs to do"]
    assert [o.progress for o in done if o.cached] == ["1 of 4 jobs"]  # it tells nothing of the others
    told = [o.progress.partition(", ")[2] for o in done]
    assert [re.sub(r"\d+", "N", words) for words in told] == ["", "about N min left", "about N min left", ""]


@pytest.mark.parametrize(
    ("seconds", "fitted", "left", "at_once", "words"),
    [
        (120, 1, 3, 1, "about 6 min left"),
        (60, 1, 7, 4, "about 2 min left"),  # the others of the first four are nearly done
        (120, 8, 4, 4, "about 1 min left"),
        (7200, 1, 3, 1, "about 6 h left"),
        (60, 0, 3, 1, ""),
        (60, 3, 0, 1, ""),
    ],
)
def test_the_time_left_is_that_of_the_jobs_so_far(seconds, fitted, left, at_once, words):
    assert runner._time_left(seconds, fitted, left, at_once) == words


def test_what_is_scored_is_what_the_file_decodes_to(tmp_path):
    job = outcomes(tmp_path)[1].record
    material = loading.load(tmp_path / job["file"])[1]
    btf = tiny_btf(12, 6, 6)
    exposure = job["score_key"]["exposure"]
    errors = []
    for i in np.concatenate(list(btf.split().heldout.values())):
        decoded = material.slice(btf.wo[i].tolist(), btf.wi[i].tolist()).numpy()
        errors.append(np.square(to_display(btf[i], exposure) - to_display(decoded, exposure)).mean())
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


def test_a_file_that_becomes_a_rung_of_a_sweep_joins_its_curve_without_a_new_score(tmp_path, monkeypatch):
    spec = CODECS[1]
    (before,) = outcomes(tmp_path, replace(SUITE, codecs=(spec,)))
    monkeypatch.setattr("bench.runs.job.evaluate", None)  # a new score would fail
    (after,) = outcomes(tmp_path, replace(SUITE, codecs=(replace(spec, swept=("components",)),)))
    assert (before.record["curve"], after.record["curve"]) == ("pca components=4", "pca")
    assert load_run(tmp_path).jobs[0] == after.record == before.record | {"curve": "pca"}


@pytest.mark.long
def test_a_changed_metric_scores_again_and_fits_nothing(tmp_path, monkeypatch):
    outcomes(tmp_path)
    files = {path: path.stat().st_mtime_ns for path in (tmp_path / "files").iterdir()}
    newer = {"ssim_periodic": 99}
    monkeypatch.setattr("bench.runs.evaluation.get_metric", lambda name: replace(get(name), version=newer.get(name, 1)))
    again = outcomes(tmp_path)
    assert [o.cached for o in again] == ["file", "file"]
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "files").iterdir()} == files
    assert again[0].record["fit_seconds"] > 0


@pytest.mark.long
def test_equal_settings_are_one_row_however_they_are_spelled(tmp_path):
    spelled = CodecSpec("vq"), CodecSpec("vq", {"components": 16}), CodecSpec("vq", {"codes": 32, "components": "16"})
    (first,) = outcomes(tmp_path / "a", replace(SUITE, codecs=spelled[1:]))
    assert first.record["label"] == "vq"
    (again,) = outcomes(tmp_path / "a", replace(SUITE, codecs=spelled[:1]))
    assert again.record == first.record
    assert len(list((tmp_path / "a/files").glob("*.nbtf"))) == 1
    outcomes(tmp_path / "b", replace(SUITE, codecs=spelled))
    (row,) = compare(load_run(tmp_path / "a"), load_run(tmp_path / "b")).rows
    assert (row.label, row.verdict) == ("vq", "same")


def test_a_failure_is_a_record_and_is_retried_only_when_asked(tmp_path, monkeypatch):
    def fail(self, btf, fit):
        raise RuntimeError("no such luck")

    only = replace(SUITE, codecs=SUITE.codecs[:1])
    with monkeypatch.context() as patch:
        patch.setattr(MeanColour, "encode", fail)
        failed = outcomes(tmp_path, only)[0]
    assert (failed.record["status"], failed.record["error"]) == ("failed", "RuntimeError: no such luck")
    assert "encode" in failed.record["traceback"]
    assert not list(tmp_path.rglob("files/*"))
    assert outcomes(tmp_path, only)[0].record["status"] == "failed"
    assert outcomes(tmp_path, only, retry_failed=True)[0].record["status"] == "ok"


def test_a_material_that_cannot_be_opened_costs_no_other(tmp_path, monkeypatch):
    def opened(spec, *_):
        if spec.name == "bad":
            raise InputError("bad.npz: damaged")
        return tiny_btf(12, 6, 6)

    monkeypatch.setattr("bench.runs.workbench.open_material", opened)
    both = replace(MEAN, materials=(MaterialSpec("bad"), MaterialSpec("tiny")))
    bad, good = (outcome.record for outcome in outcomes(tmp_path / "both", both))
    assert (bad["status"], bad["error"], good["status"]) == ("failed", "bad.npz: damaged", "ok")
    with pytest.raises(InputError, match="damaged"):
        outcomes(tmp_path / "alone", replace(MEAN, materials=both.materials[:1]))


def test_a_decoder_that_fails_while_it_is_timed_costs_no_other_time(tmp_path, monkeypatch, caplog):
    pca, mean = (outcome.record for outcome in reversed(outcomes(tmp_path)))

    whole = MeanColourMaterial.evaluate

    def fail(self, uv, wo, wi, footprint):
        if len(uv) > 1000:
            raise KeyError("no such direction")
        return whole(self, uv, wo, wi, footprint)

    monkeypatch.setattr(MeanColourMaterial, "evaluate", fail)
    assert [row["job"] for row in runner.timings_here(tmp_path, [mean, pca], "cpu", 1)] == [pca["job"]]
    assert f"{mean['job']}: not timed: KeyError" in caplog.text


@pytest.mark.parametrize("suffix", [".nbtf", ".fit.json"])
@pytest.mark.parametrize("spoil", ["cut", "gone", "other"])
def test_what_is_spoiled_in_the_cache_is_fitted_anew(suffix, spoil, tmp_path, caplog):
    job = outcomes(tmp_path, MEAN)[0].record
    path = (tmp_path / job["file"]).with_suffix(suffix)
    if spoil == "gone":
        path.unlink()
    elif spoil == "cut":
        path.write_bytes(path.read_bytes()[:-10])
    else:
        path.write_bytes(b"[1]")
    again = outcomes(tmp_path, MEAN)[0]
    assert (again.record["status"], again.cached) == ("ok", "") or again.cached == "record"
    assert container.read_header(tmp_path / job["file"]).sha256 == job["score_key"]["sha256"]
    assert outcomes(tmp_path, MEAN)[0].cached == "record"


def test_lost_arrays_are_made_again_of_the_files(tmp_path):
    before = outcomes(tmp_path, MEAN)[0].record
    (tmp_path / before["slices"]).unlink()
    again = outcomes(tmp_path, MEAN)[0]
    assert (again.cached, again.record["scores"]) == ("file", before["scores"])
    assert (tmp_path / before["slices"]).exists()


@pytest.mark.long
def test_what_was_put_in_a_files_place_is_not_timed_and_costs_no_other_time(tmp_path, caplog):
    mean, pca = (outcome.record for outcome in outcomes(tmp_path))
    (tmp_path / pca["file"]).write_bytes((tmp_path / mean["file"]).read_bytes())
    with pytest.raises(ContainerError, match="tiny/pca components=4/0"):
        material_of_job(tmp_path, pca, "cpu")
    assert [row["job"] for row in runner.timings_here(tmp_path, [pca, mean], "cpu", 1)] == [mean["job"]]
    assert f"{pca['job']}: not timed: ContainerError" in caplog.text


@pytest.mark.long
def test_seeds_are_fitted_and_scored_at_the_same_pairs(tmp_path, monkeypatch):
    monkeypatch.setattr("bench.runs.workbench.open_material", open_material)
    data = Preparation(size=12, views=3, lights=3, heldout=6)
    suite = replace(SUITE, seeds=(0, 1), data=data, materials=(MaterialSpec("satin"),), codecs=SUITE.codecs[:1])
    first, second = (done.record for done in outcomes(tmp_path, suite))
    assert first["split"] == "test"
    assert first["score_key"]["btf"] == second["score_key"]["btf"]
    assert first["score_key"]["exposure"] == second["score_key"]["exposure"]
    assert first["fit_key"]["training"] == second["fit_key"]["training"]
    choosing = replace(suite, data=replace(data, split="validation"))
    again = list(outcomes(tmp_path, choosing))
    assert [done.cached for done in again] == ["file", "file"]  # the same fits, scored at other pairs
    assert {done.record["split"] for done in again} == {"validation"}
    (validated,) = {done.record["score_key"]["btf"] for done in again}
    assert validated != first["score_key"]["btf"]


def test_a_failed_write_of_records_is_not_hidden(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"/file: "):
        outcomes(tmp_path / "file" / "run")
    assert not (tmp_path / FILE).exists()


class Elsewhere(InProcess):
    """Answers as a worker would: `lose(task)` says which calls end with the worker's death."""

    def __init__(self, lose=lambda task: False, change=lambda task: task):
        self.lose, self.change, self.calls = lose, change, []

    def submit(self, fn, /, *args, **kwargs):
        (task,) = args
        self.calls.append(task)
        if not self.lose(task):
            return super().submit(fn, self.change(task))
        future = Future()
        future.set_exception(BrokenProcessPool("died"))
        return future


def through(executor, at_once=1):
    return {"workers": lambda: nullcontext(Workers(executor, at_once))}


@pytest.mark.long
def test_a_job_that_lost_its_worker_is_started_again_and_the_third_time_fails_alone(tmp_path, caplog):
    once = Elsewhere(lambda task: task.codec.codec == "pca" and not task.losses)
    assert [o.record["status"] for o in outcomes(tmp_path / "once", **through(once))] == ["ok", "ok"]
    assert "tiny/pca components=4/0: " in caplog.text
    always = Elsewhere(lambda task: task.codec.codec == "mean-colour")
    done = {o.record["codec"]: o.record for o in outcomes(tmp_path / "always", **through(always, 2))}
    assert [task.name for task in always.calls].count("tiny/mean-colour/0") == 3
    assert (done["pca"]["status"], done["mean-colour"]["status"]) == ("ok", "failed")
    assert "3 workers" in done["mean-colour"]["error"]
    assert [o.cached for o in outcomes(tmp_path / "always")] == ["record", "record"]
    again = outcomes(tmp_path / "always", retry_failed=True)
    assert [o.record["status"] for o in again] == ["ok", "ok"]


@pytest.mark.long
def test_a_job_whose_codec_could_not_be_made_is_tried_again_once_it_can(tmp_path, monkeypatch):
    whole = runner.make_codec

    def broken(name, settings):
        if name == "pca":
            raise CodecError("codec pca cannot be imported: SyntaxError")
        return whole(name, settings)

    with monkeypatch.context() as patch:
        patch.setattr(runner, "make_codec", broken)
        assert [o.record["status"] for o in outcomes(tmp_path)] == ["failed", "ok"]
        assert [o.record["status"] for o in outcomes(tmp_path)] == ["failed", "ok"]
    assert [o.record["status"] for o in outcomes(tmp_path)] == ["ok", "ok"]


def test_jobs_stand_in_the_order_of_the_suite_in_whatever_order_they_end(tmp_path):
    class Backwards(Elsewhere):
        def submit(self, fn, /, *args, **kwargs):
            if not self.calls:
                self.calls.append(args[0])
                self.late, self.first = Future(), (fn, *args)
                return self.late
            future = super().submit(fn, *args)
            self.late.set_result(super().submit(*self.first).result())
            return future

    done = outcomes(tmp_path, **through(Backwards(), 2))
    assert {o.record["codec"] for o in done} == {"mean-colour", "pca"}
    lines = (tmp_path / FILE).read_text().splitlines()
    assert [job["codec"] for job in load_run(tmp_path).jobs] == ["mean-colour", "pca"]
    assert load_run(tmp_path).starts[0]["jobs"] == ["tiny/mean-colour/0", "tiny/pca components=4/0"]
    assert len(lines) == 5


@pytest.mark.long
def test_a_worker_that_joins_later_and_does_not_see_the_folder_stops_the_run_and_what_is_done_is_kept(tmp_path):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    late = Elsewhere(change=lambda task: replace(task, folder=elsewhere) if late.calls[1:] else task)
    with pytest.raises(InputError, match="elsewhere: "):
        outcomes(tmp_path / "run", **through(late))
    assert not list(elsewhere.iterdir())
    assert [o.cached for o in outcomes(tmp_path / "run")] == ["record", ""]


def test_a_full_disk_stops_the_run_and_is_no_failure_of_a_job(tmp_path, monkeypatch):
    def full(path, data):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

    with monkeypatch.context() as patch:
        patch.setattr("bench.files.atomic.write", full)
        with pytest.raises(InputError, match=r"\.nbtf: .*No space"):
            outcomes(tmp_path)
    assert list(load_run(tmp_path).jobs) == []
    assert [o.record["status"] for o in outcomes(tmp_path)] == ["ok", "ok"]


def test_a_folder_has_one_run_at_a_time(tmp_path):
    first = run(SUITE, Options(tmp_path))
    next(first)
    with pytest.raises(InputError, match="another run"):
        outcomes(tmp_path)
    first.close()
    assert [o.cached for o in outcomes(tmp_path)] == ["record", ""]


@pytest.mark.long
def test_what_a_killed_run_left_half_done_is_removed_and_states_are_kept(tmp_path):
    outcomes(tmp_path)
    done = next(tmp_path.glob("files/*.nbtf"))
    state = tmp_path / "files" / "of-a-job-not-done.state"
    left = [done.with_suffix(".state"), done.with_suffix(".fresh"), tmp_path / "slices" / "0.partial"]
    for path in (*left, state):
        path.write_bytes(b"half")
    outcomes(tmp_path)
    assert not any(path.exists() for path in left)
    assert state.exists()


@pytest.mark.long
def test_a_file_whose_record_was_lost_is_scored_and_keeps_how_long_it_took(tmp_path):
    seconds = [o.record["fit_seconds"] for o in outcomes(tmp_path)]
    (tmp_path / FILE).unlink()
    again = outcomes(tmp_path)
    assert [o.cached for o in again] == ["file", "file"]
    assert [o.record["fit_seconds"] for o in again] == seconds


@pytest.mark.long
def test_lines_that_are_no_records_are_named_when_a_run_goes_on(tmp_path, caplog):
    outcomes(tmp_path)
    with open(tmp_path / FILE, "ab") as file:
        file.write(b'{"kind": "job", "job": "y", "sta')
    line = len((tmp_path / FILE).read_bytes().splitlines())
    assert [o.cached for o in outcomes(tmp_path)] == ["record", "record"]
    assert re.search(rf"line\(s\) {line}\b", caplog.text)


def test_a_fit_that_was_interrupted_goes_on_and_a_fresh_one_does_not(tmp_path, monkeypatch):
    seen = []

    class Halting(MeanColour):
        def encode(self, btf, fit):
            seen.append(fit.checkpoint.exists())
            fit.checkpoint.parent.mkdir(exist_ok=True)
            fit.checkpoint.write_bytes(b"state")
            if len(seen) == 1:
                raise KeyboardInterrupt
            return super().encode(btf, fit)

    monkeypatch.setattr("bench.runs.job.make_codec", lambda name, settings: Halting(**settings))
    only = replace(SUITE, codecs=SUITE.codecs[:1])
    with pytest.raises(KeyboardInterrupt):
        outcomes(tmp_path, only)
    assert [path.suffix for path in tmp_path.glob("files/*")] == [".state"]
    outcomes(tmp_path, only)
    outcomes(tmp_path, only, fresh=True)
    assert seen == [False, True, False]
    assert {path.suffix for path in tmp_path.glob("files/*")} == {".nbtf", ".json"}


def test_without_a_gpu_here_nothing_is_timed_and_that_is_said(tmp_path, caplog):
    lenient = Elsewhere(change=lambda task: replace(task, device="cpu"))  # a worker that has what is not here
    assert [o.record["status"] for o in outcomes(tmp_path, device="cuda", **through(lenient))] == ["ok", "ok"]
    assert list(load_run(tmp_path).timings) == []
    assert "no decoder" in caplog.text


def demand_file(folder, name, light):
    text = f"""
    camera = {{width = 24, height = 18, fov_deg = 30, position = [0, -1, 2], target = [0, 0, 0]}}
    lights = [{{kind = "directional", toward = {light}, irradiance = [3, 3, 3]}}]
    """
    collect(TextScene(parse_scene(name, text)), 1000).save(folder / f"{name}.npz")
    return str(folder / f"{name}.npz")


@pytest.mark.long
def test_a_run_is_judged_by_a_scene_and_fitted_to_it_where_a_codec_says_so(tmp_path):
    half = {"components": 12, "bits": 16}  # so much that less of it is smaller
    codecs = (CodecSpec("pca", half), CodecSpec("pca", half | {"scene": True}))
    suite = replace(SUITE, codecs=codecs, demand=demand_file(tmp_path, "noon", [0.3, 0.0, 1.0]))
    plain, fitted = (o.record for o in outcomes(tmp_path / "run", suite))
    assert plain["score_key"]["demand"] == fitted["fit_key"]["demand"] == fitted["score_key"]["demand"]
    assert "demand" not in plain["fit_key"]
    assert fitted["bytes"]["total"] < plain["bytes"]["total"]
    for record in (plain, fitted):
        assert (record["scene"]["name"], record["scene"]["frames"]) == ("noon", [1, 18, 24])
        assert record["scene"]["metrics"].keys() >= {"psnr_display", "flip_ldr_67ppd"}
        assert record["scores"]["scene"]["slices"] + record["scores"]["outside the scene"]["slices"] == 36
        assert 0 < record["scores"]["scene, held out"]["slices"] < record["pairs"]["heldout"]
        assert record["views"] == 6
        with np.load(tmp_path / "run" / record["frames"]) as frames:
            assert frames["truth"].shape == frames["decoded"].shape == (1, 18, 24, 3)
            assert 0 < np.abs(frames["truth"].astype(int) - frames["decoded"]).mean() < 60
    assert [o.cached for o in outcomes(tmp_path / "run", suite)] == ["record", "record"]
    evening = replace(suite, demand=demand_file(tmp_path, "evening", [1.0, 0.3, 0.3]))
    again = outcomes(tmp_path / "run", evening)
    assert [o.cached for o in again] == ["file", ""]
    assert again[0].record["scene"]["name"] == "evening"


def test_a_fit_to_a_scene_needs_its_demand(tmp_path):
    suite = replace(SUITE, codecs=(CodecSpec("pca", {"scene": True}),))
    with pytest.raises(InputError, match="--scene"):
        outcomes(tmp_path, suite)
    with pytest.raises(InputError, match=r"none\.npz: "):
        outcomes(tmp_path, replace(suite, demand=str(tmp_path / "none.npz")))


@pytest.mark.long
def test_a_truth_that_cannot_be_drawn_costs_no_job(tmp_path, monkeypatch, caplog):
    def refuse(_):
        raise ValueError("directions meet")

    monkeypatch.setattr("bench.runs.job.sparse_truth", refuse)
    assert [job.record["status"] for job in outcomes(tmp_path)] == ["ok", "ok"]
    assert "directions meet" in caplog.text
