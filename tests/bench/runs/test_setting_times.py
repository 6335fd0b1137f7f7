"""Settings are timed apart from surfaces, and tables of budgets then use these times alone."""

import copy
import re
from importlib.metadata import EntryPoint

import numpy as np
import pytest
import torch

from bench import cli
from bench.codec import silent
from bench.codecs import registry
from bench.inputs.errors import InputError
from bench.records import append, load_run
from bench.records.schema import setting_name
from bench.runs import setting_times, setting_variants
from bench.runs.setting_times import Entry, time_settings
from bench.runs.suite import parse_suite
from bench.timing import BATCH
from reports import table_text
from reports.times import times_tables

SUITE = """
materials = ["satin", "cable-knit"]
[data]
size = 16
views = 4
lights = 4
heldout = 4
[[codecs]]
codec = "pca"
components = [1, 2]
[[codecs]]
codec = "ntc"
steps = 900
width = 8
"""


@pytest.fixture(scope="module")
def timed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("times")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(setting_times, "TURNS", 2)
        records = time_settings(parse_suite("small", SUITE), folder)
    return folder, records


def test_each_setting_is_one_record_over_surfaces_and_rounds_without_a_job(timed):
    folder, records = timed
    ratios = [record["ratio_to_floor"] for record in records]
    assert ratios == sorted(ratios)
    assert {record["label"] for record in records} == {"pca components=1", "pca components=2", "ntc steps=900 width=8"}
    run = load_run(folder)
    assert len(run.timings) == 3
    assert not len(run.jobs)
    for record in run.timings:
        assert len(record["rounds"]) == 4  # two surfaces, two rounds
        low, high = record["ratio_interval95"]
        assert low <= record["ratio_to_floor"] <= high
        assert record["flops"] > 0
    assert run.starts[0]["machine"]["processor"]


def test_a_codec_that_answers_texels_counts_at_a_texel_and_shows_the_other_time_beside(timed):
    by_label = {record["label"]: record for record in timed[1]}
    ntc = by_label["ntc steps=900 width=8"]
    assert ntc["ratio_between_texels"] > 2 * ntc["ratio_to_floor"]  # four interpolated answers, or one
    assert "ratio_between_texels" not in by_label["pca components=1"]


def test_files_of_one_setting_that_need_more_on_some_surfaces_are_two_entries():
    flat, raised = Entry("relief", 100), Entry("relief", 140)
    for entry, ratio in ((flat, 8.0), (raised, 12.0)):
        entry.ratios.append(np.full(4, ratio))
        entry.samples.append(np.full(4, 50 * ratio))
    names = [entry.record("run")["job"] for entry in (flat, raised)]
    assert names == [setting_name("relief", 100), setting_name("relief", 140)]
    assert raised.record("run")["ratio_to_floor"] == 12.0


@pytest.mark.long
def test_the_command_prints_a_table_and_its_records_can_be_published(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(setting_times, "TURNS", 2)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.toml").write_text(SUITE)
    assert cli.main(["time", "small.toml", "--out", "times", "--codec", "pca"]) == 0
    assert "pca components=1" in capsys.readouterr().out
    assert cli.main(["results", "add", "times", "times.jsonl"]) == 0
    assert cli.main(["table", "times", "times.jsonl"]) == 0
    shown = capsys.readouterr().out
    assert "pca components=2" in shown
    assert "satin" not in (tmp_path / "times.jsonl").read_text().split('"label"', 1)[1]


def test_where_nothing_can_be_fitted_nothing_is_written(tmp_path):
    text = """
materials = [{name = "gone", path = "gone/gone", where = "nowhere"}]
[[codecs]]
codec = "pca"
"""
    suite = parse_suite("none", text)
    with pytest.raises(InputError, match="fitted"):
        time_settings(suite, tmp_path / "times")
    assert not (tmp_path / "times" / "records.jsonl").exists()
    without = parse_suite("none", text.replace(text.splitlines()[1], ""))
    with pytest.raises(InputError, match="materials"):
        setting_variants.time_variants(without, tmp_path / "variants", "cpu", 5.0)


@pytest.fixture
def short_variants(monkeypatch):
    monkeypatch.setattr(setting_variants, "TURNS", 2)
    monkeypatch.setattr(setting_variants, "BATCHES", (64, 256))
    monkeypatch.setattr(setting_variants, "CHECKED", 64)
    monkeypatch.setattr(setting_variants, "FIT_STEPS", 2)
    monkeypatch.setattr(setting_variants.native, "emulated", lambda precision, device: False)  # on any processor
    monkeypatch.setattr("bench.timing.roofline.SIDE", 64)
    monkeypatch.setattr("bench.timing.roofline.COPIED", 1 << 16)
    monkeypatch.setattr(setting_variants, "PRECISIONS", {"eager": ("float32", "bfloat16")})


@pytest.mark.long
def test_variants_are_checked_timed_written_and_not_timed_again(tmp_path, short_variants):
    suite, folder = parse_suite("small", SUITE), tmp_path / "times"
    found = setting_variants.time_variants(suite, folder, "cpu", 5.0)
    by_job = {record["job"]: record for record in found}
    fits = {record["label"] for record in found if record["execution"] == "fit step"}
    assert fits == {"ntc steps=900 width=8"}
    ntc = [record for record in found if record["label"].startswith("ntc") and "of_tolerance" in record]
    assert {record["dtype"] for record in ntc} == {"float32", "bfloat16"}
    assert {record["batch"] for record in ntc} == {64, 256, BATCH}
    assert len(ntc) == 6
    assert all(record["limit_ns"] > 0 for record in ntc)
    assert all(record["of_tolerance"] <= 1 for record in ntc if record["dtype"] == "float32")
    pca = [record for record in found if record["label"] == "pca components=1"]
    assert {record["dtype"] for record in pca} == {"float32", "bfloat16"}
    assert len(by_job) == len(found)
    assert setting_variants.time_variants(suite, folder, "cpu", 5.0) == []  # all of it is done
    text = table_text(folder, kind="times")
    assert all(title in text for title in ("Executions", "Batches: ", "Steps"))


def test_a_variant_whose_answers_are_not_finite_is_left_out(tmp_path, short_variants, monkeypatch, caplog):
    prepared = setting_variants.prepared

    def overflowing(material, variant):
        ready = prepared(material, variant)
        if variant.precision == "bfloat16":
            query = ready.query
            ready.query = lambda *queries: query(*queries) / 0
        return ready

    monkeypatch.setattr(setting_variants, "prepared", overflowing)
    small = SUITE.replace("components = [1, 2]", "components = 1").partition('[[codecs]]\ncodec = "ntc"')[0]
    shown = []
    found = setting_variants.time_variants(
        parse_suite("small", small), tmp_path / "times", "cpu", 5.0, lambda *told: shown.append(told)
    )
    assert [(record["label"], record["dtype"]) for record in found] == [("pca components=1", "float32")]
    labels = {label for label, _, _ in shown}
    assert labels == {"satin: fits of one step", "pca components=1: executions and precisions"}  # no fit has steps
    assert {label for label, done, total in shown if done == total} == labels  # every bar ends
    assert "pca components=1, eager bfloat16: " in caplog.text


def test_what_was_timed_on_another_gpu_is_timed_again(tmp_path, short_variants, monkeypatch):
    row = setting_variants._timing_of_step("fit/ntc/cpu", "ntc", 5.0, 1, "cpu")
    append(tmp_path, row | {"run": "1", "gpu": "another"})
    words = parse_suite("small", SUITE), tmp_path, torch.device("cpu"), "2", setting_variants.Clock(0), silent
    assert setting_variants._Measuring(*words).done == set()
    monkeypatch.setattr("bench.timing.hardware", lambda device: {"gpu": "another"})
    assert setting_variants._Measuring(*words).done == {"fit/ntc/cpu"}


BROKEN = SUITE.partition('[[codecs]]\ncodec = "ntc"')[0] + '[[codecs]]\ncodec = "broken"\n'


@pytest.fixture
def broken(monkeypatch):
    """A codec whose package lacks a module, in `BROKEN`, a suite with another one."""
    entry = EntryPoint("broken", "package_that_is_not_installed:Codec", registry.GROUP)
    entries = registry.codec_entries() | {"broken": entry}
    monkeypatch.setattr(registry, "codec_entries", lambda: entries)


@pytest.mark.long
def test_a_codec_that_cannot_be_made_is_left_out_with_a_warning(tmp_path, broken, monkeypatch, caplog):
    monkeypatch.setattr(setting_times, "TURNS", 2)
    records = time_settings(parse_suite("small", BROKEN), tmp_path / "times")
    assert {record["label"] for record in records} == {"pca components=1", "pca components=2"}
    assert re.search("broken.* satin: .*package_that_is_not_installed", caplog.text)


@pytest.mark.long
def test_nor_are_variants_and_steps_of_a_codec_that_cannot_be_made(tmp_path, broken, short_variants, caplog):
    found = setting_variants.time_variants(parse_suite("small", BROKEN), tmp_path / "times", "cpu", 5.0)
    assert {record["label"] for record in found} == {"pca components=1", "pca components=2"}
    assert re.search("broken: .*package_that_is_not_installed", caplog.text)


def test_after_the_last_minute_no_surface_is_opened(monkeypatch):
    monkeypatch.setattr(setting_variants, "open_material", lambda *_, **__: pytest.fail("opened"))
    over = setting_variants.Clock(0)
    assert list(setting_variants._timings_of_steps(parse_suite("small", SUITE), "cpu", over, set(), silent)) == []


@pytest.mark.long
def test_variants_end_when_their_minutes_are_over_and_keep_what_they_have(tmp_path, short_variants):
    suite, folder = parse_suite("small", SUITE), tmp_path / "times"
    assert setting_variants.time_variants(suite, folder, "cpu", 0.0) == []
    assert not len(load_run(folder).timings)
    found = setting_variants.time_variants(suite, folder, "cpu", 5.0)  # the next call goes on
    assert {record["label"] for record in found} == {"pca components=1", "pca components=2", "ntc steps=900 width=8"}


@pytest.mark.long
def test_a_variant_that_ended_a_process_is_not_tried_again_and_one_that_fails_leaves_the_others(
    tmp_path, short_variants, monkeypatch, caplog
):
    suite, folder = parse_suite("small", SUITE.replace("components = [1, 2]", "components = 1")), tmp_path / "times"
    whole, faulty = setting_variants.difference_from_exact, []

    def difference_from_exact(ready, exact, precision):
        if precision == "bfloat16":
            raise RuntimeError("a kernel fails")
        return whole(ready, exact, precision)

    def wait_for_gpu(device):
        if faulty:
            raise RuntimeError("the GPU has a fault")

    monkeypatch.setattr(setting_variants, "difference_from_exact", difference_from_exact)
    monkeypatch.setattr(setting_variants, "wait_for_gpu", wait_for_gpu)
    faulty.append(True)
    with pytest.raises(RuntimeError, match="has a fault"):
        setting_variants.time_variants(suite, folder, "cpu", 5.0)
    (name,) = (folder / "tried.txt").read_text().splitlines()
    assert "float32" in name
    faulty.clear()
    found = setting_variants.time_variants(suite, folder, "cpu", 5.0)  # the next call goes on
    assert name not in {record["job"] for record in found}
    assert {record["dtype"] for record in found if "of_tolerance" in record} == {"float32"}
    assert "a kernel fails" in caplog.text
    assert f"{name}: " in caplog.text
    assert not (folder / "tried.txt").exists()


def test_an_answer_that_is_off_is_told(timed):
    suite = parse_suite("s", SUITE)
    surfaces = setting_times.surfaces_of(suite)
    material = next(setting_times.decoded_settings(suite, surfaces, timed[0], "cpu", lambda *_: None)).material
    exact = copy.deepcopy(material).to(dtype=torch.float64)
    assert setting_variants.difference_from_exact(material, exact, "float32") <= 1
    wrong = copy.deepcopy(material)
    query = wrong.query
    wrong.query = lambda *queries: query(*queries) + 0.1  # type: ignore[method-assign]
    assert setting_variants.difference_from_exact(wrong, exact, "float32") > 100


@pytest.mark.long
def test_variants_are_timed_on_an_emulated_gpu_too(tmp_path, short_variants, monkeypatch, gpu):
    monkeypatch.setattr("bench.timing.GPU_BATCH", 64)
    monkeypatch.setattr("bench.timing.SPAN_NS", 1000)
    monkeypatch.setattr("bench.machine.devices.LOADED_SECONDS", 0.01)
    told = {"reset_peak_memory_stats": 0, "max_memory_allocated": 3 << 20, "power_draw": 200_000}  # bytes, milliwatts
    for name, number in told.items():
        monkeypatch.setattr(torch.get_device_module(gpu), name, lambda device, n=number: n, raising=False)
    small = SUITE.replace("components = [1, 2]", "components = 1").replace('"satin", "cable-knit"', '"satin"')
    found = setting_variants.time_variants(parse_suite("small", small), tmp_path / "times", str(gpu), 5.0)
    assert {record["execution"] for record in found} == {"eager", "fit step"}
    assert {record["device"] for record in found} == {str(gpu)}
    of_gpu = next(table for table in times_tables(load_run(tmp_path / "times")) if "besides" in table.title)
    first = next(record for record in found if record["execution"] == "eager")
    assert of_gpu.values is not None
    row = of_gpu.values.iloc[0]
    assert row["read"] == pytest.approx(first["read_bytes"] / first["ns_per_sample"], rel=1e-3)
    assert row["memory"] == 3
    assert row["energy"] == pytest.approx(200 * first["ns_per_sample"], rel=1e-3)
