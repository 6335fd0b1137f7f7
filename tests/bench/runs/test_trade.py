import argparse
import re
import shutil
import sys
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch

from bench import cli, timing
from bench.cli.commands import choose as choose_command
from bench.codec import Fit
from bench.codecs.registry import load_codec
from bench.compare.choosing import answers, name_of_choice, usable_rungs
from bench.conformance.check import tiny_btf
from bench.data.spec import MaterialSpec, Preparation
from bench.inputs.errors import InputError
from bench.material import DecoderCost
from bench.records import append, load_run, load_trade
from bench.runs import trade
from bench.runs.job import Outcome
from bench.runs.runner import Options, run
from bench.runs.suite import CodecSpec, Suite
from bench.timing import native
from bench.timing.execution import Variant
from reports import table_text
from reports.figures.fronts import trade_fronts

CODECS = (
    CodecSpec("mean-colour"),
    CodecSpec("pca", {"components": 2}, ("components",)),
    CodecSpec("neubtf-direct", {"steps": 20}),
)
VARIANTS = ("eager bfloat16", "fused float32", "fused bfloat16", "compiled tf32")  # the last two are of GPUs
DATA = Preparation(validation=True)
SUITE = Suite("test", "", data=DATA, materials=(MaterialSpec("tiny"),), codecs=CODECS, variants=VARIANTS)


def without_drjit():
    raise InputError("pip install neubtf-bench[mitsuba]")


@pytest.fixture(scope="module")
def brief():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(timing, "TURNS", 3)
        patch.setattr("bench.timing.SPAN_NS", 10_000)
        patch.setattr(trade, "BATCH", 256)
        yield


@pytest.fixture(scope="module")
def measured(tmp_path_factory, brief):
    folder = tmp_path_factory.mktemp("trade")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bench.runs.workbench.open_material", lambda *_: tiny_btf(12, 6, 6).with_validation())
        patch.setattr("bench.timing.execution.drjit", without_drjit)
        patch.setattr(trade, "BATCHES", (1,))
        patch.setattr("bench.timing.profile.FOOTPRINTS", (1,))
        patch.setattr("bench.timing.profile.COPIED", 1 << 20)
        patch.setattr("bench.timing.profile.SIDE", 64)  # without AVX-512, bfloat16 multiplies slowly
        patch.setattr(native, "emulated", lambda precision, device: False)  # on any processor
        assert {outcome.record["status"] for outcome in run(SUITE, Options(folder))} == {"ok"}
        result = trade.measure(SUITE, load_run(folder), "cpu")
    trade.write(folder, result)
    return folder, result


def by_name(result):
    return {name_of_choice(row): row for row in result["choices"]}


def test_every_setting_and_variant_is_a_choice_and_the_floor_stands_beside_them(measured):
    names = list(by_name(measured[1]))
    without_network = ["mean-colour", "mean-colour [fused float32]", "pca components=2"]
    with_one = [f"neubtf-direct steps=20{how}" for how in ("", " [eager bfloat16]", " [fused float32]")]
    assert names == [*without_network, *with_one, timing.FLOOR]


def test_quality_is_that_of_the_record_and_variants_are_scored_from_the_same_file(measured):
    folder, result = measured
    record = load_run(folder).job("tiny/neubtf-direct steps=20/0")
    rows = by_name(result)
    plain, half = rows["neubtf-direct steps=20"], rows["neubtf-direct steps=20 [eager bfloat16]"]
    assert plain["psnr"] == record["scores"]["heldout"]["metrics"]["psnr_display"]["mean"]
    assert plain["bytes"] == half["bytes"] == record["bytes"]["total"]
    assert half["psnr"] != plain["psnr"]
    assert half["psnr"] == pytest.approx(plain["psnr"], abs=0.3)
    assert plain["worst"] < plain["psnr"]
    assert 20 < half["from_float32"] < 80  # bfloat16 has three digits
    assert "from_float32" not in plain
    assert "stability of executions and precisions" in table_text([folder], "text", "trade")
    of_record = record["scores"]["validation"]["metrics"]["psnr_display"]
    assert plain["validation"]["pooled"] == of_record["pooled"]
    assert half["validation"]["slices"] == of_record["slices"]
    assert half["validation"]["pooled"] == pytest.approx(of_record["pooled"], abs=0.3)


def test_what_cannot_be_computed_is_a_row_that_says_why(measured):
    for label in ("mean-colour", "neubtf-direct steps=20"):
        row = by_name(measured[1])[f"{label} [fused float32]"]
        assert "pip install neubtf-bench[mitsuba]" in row["error"]
        assert "ns_per_sample" not in row


def test_an_interrupted_measurement_goes_on_where_it_stopped(measured, tmp_path, monkeypatch):
    """The variant is scored once, and each turn is timed once."""
    monkeypatch.setattr("bench.runs.workbench.open_material", lambda *_: tiny_btf(12, 6, 6).with_validation())
    monkeypatch.setattr("bench.timing.profile.COPIED", 1 << 20)
    monkeypatch.setattr("bench.timing.profile.SIDE", 64)
    monkeypatch.setattr(native, "emulated", lambda precision, device: False)
    shutil.copytree(measured[0], tmp_path / "run")
    suite = replace(SUITE, codecs=SUITE.codecs[2:], variants=("eager bfloat16",))
    run = load_run(tmp_path / "run")

    def interrupt(label, done, total):
        if label == "timing decoders" and (done, total) == (2, 3):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        trade.measure(suite, run, "cpu", show=interrupt, profiles=False)
    monkeypatch.setattr(trade, "_figures_of_variant", lambda *_: pytest.fail("scored again"))
    turns = []

    def count(label, done, total):
        if label == "timing decoders":
            turns.append(total)

    result = trade.measure(suite, run, "cpu", show=count, profiles=False)
    assert set(turns) == {1}
    rows = by_name(result)
    assert rows["neubtf-direct steps=20 [eager bfloat16]"]["from_float32"] > 20
    assert result["profiles"] == []
    trade.write(tmp_path / "run", result)
    assert not list((tmp_path / "run").glob("trade.[ft]*"))
    assert trade.merged(measured[1], result)["profiles"] == measured[1]["profiles"]


def test_ceilings_are_timed_in_turns_with_the_rest_and_rise_to_what_a_turn_reaches(monkeypatch):
    monkeypatch.setattr("bench.timing.profile.COPIED", 1 << 20)
    monkeypatch.setattr("bench.timing.profile.SIDE", 64)
    slow, of_all_cores = ceiling("float32", 1e-6, 1e-6), ceiling("float32", 1e-6, 1e-6, threads=2)
    material = load_codec("mean-colour")()
    decoded = material.decode(material.encode(tiny_btf(12, 6, 6), Fit()), torch.device("cpu"))
    kept = SimpleNamespace(read=lambda arrays: 0, write=lambda *_: None)
    assert set(trade._time_in_turns({"0": decoded}, [slow], 256, lambda *_: None, kept)) >= {"0", timing.FLOOR}
    assert slow["flops_per_ns"] > 1
    assert slow["bytes_per_ns"] > 0.1
    assert of_all_cores == ceiling("float32", 1e-6, 1e-6, threads=2)


def test_a_share_above_the_whole_limit_is_marked_and_explained(measured, tmp_path):
    shutil.copy(measured[0] / "records.jsonl", tmp_path)
    choices = [row | ({"of_limit": 1.25} if row["label"] == "mean-colour" else {}) for row in measured[1]["choices"]]
    note = "* A share above 100 %"
    assert note not in table_text([measured[0]], kind="trade")
    trade.write(tmp_path, measured[1] | {"choices": choices})
    text = table_text(tmp_path, kind="trade")
    assert re.search(r"^mean-colour .* 125\.0 \*", text, re.M)
    assert note in text


@pytest.fixture
def quick(measured, monkeypatch):
    monkeypatch.setattr("bench.runs.workbench.open_material", lambda *_: tiny_btf(12, 6, 6))
    monkeypatch.setattr(trade, "roofline", lambda device, threads, dtype=torch.float32: ceiling(str(dtype)[6:], 50.0))
    monkeypatch.setattr(trade, "profile", lambda *_: [])


def test_a_variant_that_fails_unforeseen_is_a_row_that_says_so(measured, quick, monkeypatch):
    plain = trade.prepared

    def prepared(material, variant):
        if variant != Variant():
            raise ValueError("zip() argument 2 is shorter\nthan argument 1")
        return plain(material, variant)

    monkeypatch.setattr(trade, "prepared", prepared)
    suite = replace(SUITE, codecs=SUITE.codecs[2:], variants=("fused float32",))
    rows = by_name(trade.measure(suite, load_run(measured[0]), "cpu"))
    error = "ValueError: zip() argument 2 is shorter than argument 1"
    assert rows["neubtf-direct steps=20 [fused float32]"]["error"] == error
    assert rows["neubtf-direct steps=20"]["ns_per_sample"] > 0


def test_a_file_whose_slices_are_gone_is_a_row_that_says_so_and_loses_only_its_own_figures(
    measured, quick, tmp_path, monkeypatch
):
    monkeypatch.setattr(native, "emulated", lambda precision, device: False)  # on any processor
    shutil.copytree(measured[0], tmp_path / "run")
    run = load_run(tmp_path / "run")
    (tmp_path / "run" / run.job("tiny/neubtf-direct steps=20/0")["slices"]).unlink()
    result = trade.measure(replace(SUITE, variants=("eager bfloat16",)), run, "cpu")
    trade.write(tmp_path / "run", result)
    text = table_text(tmp_path / "run", kind="trade")
    (line,) = re.findall(r"^neubtf-direct steps=20 +\S+ +\S+ +(\S+) +\S+\n\[eager bfloat16\]", text, re.M)
    assert line == "—"  # gained on what is not known
    # Without any other file nothing can be timed, and there is no floor.
    alone = trade.measure(replace(SUITE, codecs=SUITE.codecs[2:], variants=()), run, "cpu")
    assert list(by_name(alone)) == ["neubtf-direct steps=20"]
    assert "ns_per_sample" not in alone["choices"][0]


def test_what_another_program_decodes_is_scored_and_not_timed(measured, quick, tmp_path, monkeypatch):
    folder = shutil.copytree(measured[0], tmp_path / "run")
    plain, of_programs, profiled = trade.material_of_job, {"mean-colour"}, []

    def material_of_job(folder, job, device):
        material = plain(folder, job, device)
        material.opaque = job["label"] in of_programs
        return material

    monkeypatch.setattr(trade, "material_of_job", material_of_job)
    monkeypatch.setattr(trade, "profile", lambda name, materials, *_: profiled.append(list(materials)) or [])
    suite = replace(SUITE, codecs=SUITE.codecs[:2], variants=("fused float32",))
    result = trade.measure(suite, load_run(folder), "cpu")
    rows = by_name(result)
    assert list(rows) == ["mean-colour", "pca components=2", timing.FLOOR]
    assert rows["mean-colour"]["error"] == "its time cannot be measured"
    assert rows["mean-colour"]["psnr"] == by_name(measured[1])["mean-colour"]["psnr"]
    assert profiled == [["pca components=2"]]
    trade.write(folder, result)
    text = table_text(folder, kind="trade")
    (line,) = (line for line in text.splitlines() if line.startswith("mean-colour "))
    assert line.split()[1] == f"{rows['mean-colour']['psnr']:.2f}"
    assert line.split()[-5:] == ["—"] * 5
    assert "mean-colour: its time cannot be measured." in " ".join(text.split())
    assert len(list(trade_fronts(load_run(folder)))) == 1
    # If all of them are programs, nothing is timed or profiled.
    of_programs.add("pca components=2")
    result = trade.measure(suite, load_run(folder), "cpu")
    assert list(by_name(result)) == ["mean-colour", "pca components=2"]
    assert len(profiled) == 1


def test_what_was_measured_of_a_material_is_kept_when_the_next_one_fails(measured, quick, tmp_path, monkeypatch):
    shutil.copytree(measured[0], tmp_path / "run")
    other = MaterialSpec("other")
    plain = trade.measure

    def measure(suite, *rest):
        if suite.materials == (other,):
            raise KeyboardInterrupt
        return plain(suite, *rest)

    monkeypatch.setattr(trade, "measure", measure)
    monkeypatch.setattr(trade.runner, "run", lambda *_: [Outcome({"status": "ok"})])
    suite = replace(SUITE, materials=(*SUITE.materials, other), codecs=SUITE.codecs[:1], variants=())
    with pytest.raises(KeyboardInterrupt):
        trade.run_and_measure(suite, Options(tmp_path / "run"), lambda _: None)
    assert {row["material"] for row in load_trade(tmp_path / "run")["choices"]} == {"tiny"}


def test_a_choice_is_on_a_front_where_nothing_is_as_good_for_less():
    rows = [
        {"psnr": 30.0, "ns_per_sample": 100.0, "bytes": 10},
        {"psnr": 30.0, "ns_per_sample": 90.0, "bytes": 20},
        {"psnr": 100.0, "ns_per_sample": 900.0, "bytes": 900},
        {"psnr": 29.0, "ns_per_sample": 95.0, "bytes": 5},
        {"psnr": 30.001, "ns_per_sample": 110.0, "bytes": 10},  # the first, computed otherwise
    ]
    trade._mark_fronts(rows)
    assert [row["fastest"] for row in rows] == [False, True, True, False, False]
    assert [row["smallest"] for row in rows] == [True, False, True, True, True]


def test_the_answer_names_the_cheapest_within_half_a_decibel_of_the_best():
    rows = [
        {"label": "big", "psnr": 40.0, "ns_per_sample": 100.0, "bytes": 1000},
        {"label": "small", "psnr": 39.6, "ns_per_sample": 120.0, "bytes": 10},
        {"label": "fast", "psnr": 39.7, "ns_per_sample": 20.0, "bytes": 500},
        {"label": "poor", "psnr": 39.4, "ns_per_sample": 1.0, "bytes": 1},
    ]
    rows = [row | {"material": "m", "execution": "eager", "precision": "float32"} for row in rows]
    rows = [row | {"ratio_to_floor": 2.0, "ratio_interval95": [1.9, 2.1]} for row in rows]
    rows = [row | {"validation": {"pooled": row["psnr"], "mean": row["psnr"], "slices": 9}} for row in rows]
    best, fastest, smallest = answers("m", rows)
    assert "the best is big: 40.00 dB on validation pairs, 40.00 dB on test pairs, 1,000 bytes, 100 ns" in best
    assert "the fastest is fast" in fastest
    assert "the smallest is small" in smallest
    _, fastest, smallest = answers("m", rows[2:3])
    assert fastest == "m: within 0.5 dB of it, no other is faster."
    assert smallest == "m: within 0.5 dB of it, no other is smaller."


def test_a_job_that_failed_is_a_row_that_says_why(tmp_path):
    job = {"kind": "job", "job": "tiny/mean-colour/0", "material": "tiny", "label": "mean-colour"}
    job |= {"codec": "mean-colour", "seed": 0, "status": "failed", "error": "no\nmemory"}
    append(tmp_path, job)
    (row,) = trade.measure(replace(SUITE, variants=()), load_run(tmp_path), "cpu")["choices"]
    assert (row["label"], row["error"]) == ("mean-colour", "failed: no memory")


def ceiling(dtype, flops, copied=10.0, threads=1):
    return {"device": "cpu", "dtype": dtype, "flops_per_ns": flops, "bytes_per_ns": copied, "threads": threads}


@pytest.mark.parametrize(
    ("dtype", "ceilings", "limit"),
    [
        (torch.float32, [ceiling("float32", 50.0)], 2.0),  # 100 flops
        (torch.bfloat16, [ceiling("float32", 50.0), ceiling("bfloat16", 100.0)], 1.0),
        (torch.bfloat16, [ceiling("float32", 50.0), ceiling("bfloat16", 5.0)], 2.0),  # emulated: products stay wide
        (torch.float32, [ceiling("float32", 50.0), ceiling("bfloat16", 100.0)], 2.0),
        (torch.float32, [ceiling("float32", 50.0), ceiling("float32", 100.0, threads=2)], 2.0),
        (torch.float32, [ceiling("float32", 50.0, 2.0)], 4.0),  # 8 bytes
        (torch.bfloat16, [ceiling("float32", 50.0, 2.0)], 2.0),  # half as many
    ],
)
def test_the_limit_is_the_faster_of_the_precisions_that_could_be_used(dtype, ceilings, limit):
    material = SimpleNamespace(dtype=dtype, cost=DecoderCost(flops_per_sample=100, bytes_per_sample=8))
    assert trade._limit(material, ceilings) == pytest.approx(limit)


def test_precisions_that_the_processor_emulates_are_left_out_and_said_so(measured, quick, tmp_path, monkeypatch):
    folder = measured[0]
    suite = replace(SUITE, codecs=SUITE.codecs[2:], variants=("eager bfloat16", "fused bfloat16", "compiled tf32"))
    monkeypatch.setattr(native, "emulated", lambda precision, device: precision == "bfloat16")
    result = trade.measure(suite, load_run(folder), "cpu")
    assert list(by_name(result)) == ["neubtf-direct steps=20", timing.FLOOR]
    assert {ceiling["dtype"] for ceiling in result["ceilings"]} == {"float32"}
    shutil.copy(folder / "records.jsonl", tmp_path)
    trade.write(tmp_path, result)
    note = "only emulates their precision: eager bfloat16. `neubtf-bench trade --emulated` measures them"
    assert note in " ".join(table_text(tmp_path, kind="trade").split())
    result = trade.measure(suite, load_run(folder), "cpu", emulated=True)
    assert "neubtf-direct steps=20 [eager bfloat16, emulated]" in by_name(result)
    trade.write(tmp_path, result)
    text = table_text(tmp_path, kind="trade")
    assert re.search(r"^\[eager bfloat16, *\nemulated\]", text, re.M)  # a cell of the table, folded
    assert "only emulates" not in text


@pytest.fixture
def path_traced(measured, quick, monkeypatch):
    """What is measured with noise by a path tracer that stands in for Mitsuba's, and cannot record one codec."""

    def reached(file, drawn):
        assert drawn[0] is None
        assert drawn[1].shape[2] == 5
        if "mean-colour" in file.name:
            raise InputError("cannot be recorded")
        return [SimpleNamespace(samples=40_000.0, seconds=3.0), SimpleNamespace(samples=9_876.0, seconds=1.5)]

    stands_in = SimpleNamespace(EVEN="ball, even sky", reached=reached)
    monkeypatch.setattr(trade, "_path_tracer", lambda: stands_in)
    monkeypatch.setattr(trade, "fitted", lambda material, show: torch.zeros(1, 1, 5))
    monkeypatch.setattr(native, "emulated", lambda precision, device: False)  # on any processor
    suite = replace(SUITE, variants=("eager bfloat16",))
    return trade.measure(suite, load_run(measured[0]), "cpu", noise=True)


def test_noise_is_of_each_file_and_stands_in_columns_of_its_own(measured, path_traced, tmp_path):
    rows = by_name(path_traced)
    noise = {"scene": "ball, even sky", "samples": [40_000.0, 9_876.0], "seconds": [3.0, 1.5]}
    assert rows["neubtf-direct steps=20"]["noise"] == noise
    assert rows["mean-colour"]["noise_error"] == "cannot be recorded"
    bare = ("neubtf-direct steps=20 [eager bfloat16]", timing.FLOOR)  # the same file, and none
    assert not any("noise" in rows[name] or "noise_error" in rows[name] for name in bare)
    assert "noise" not in table_text(measured[0], kind="trade")
    shutil.copy(measured[0] / "records.jsonl", tmp_path)
    trade.write(tmp_path, path_traced)
    text = table_text(tmp_path, kind="trade")
    (line,) = (line for line in text.splitlines() if line.startswith("pca components=2 "))
    assert line.split()[-4:] == ["40,000", "9,876", "3.00", "1.50"]
    (line,) = (line for line in text.splitlines() if line.startswith("mean-colour "))
    assert line.split()[-4:] == ["—"] * 4
    assert "mean-colour: noise was not measured: cannot be recorded." in " ".join(text.split())
    assert "by Mitsuba (ball, even sky)" in " ".join(text.split())


def test_noise_without_mitsuba_is_refused_before_any_work(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "bench.demand.mitsuba", None)  # whatever an earlier test has imported
    assert cli.main(["trade", "--noise", "--material", "satin", "--out", str(tmp_path / "run")]) == 2
    assert "pip install neubtf-bench[mitsuba], or leave out --noise" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "run").exists()


def test_another_material_is_measured_beside_those_that_are_there(measured):
    result = measured[1]
    other = result | {key: [row | {"material": "other"} for row in result[key]] for key in ("choices", "profiles")}
    both = trade.merged(result, other)
    assert {row["material"] for row in both["choices"]} == {"tiny", "other"}
    assert {answer.partition(":")[0] for answer in both["answers"]} == {"tiny", "other"}
    again = trade.merged(both, result)
    assert sorted(map(str, again["choices"])) == sorted(map(str, both["choices"]))
    assert trade.merged(None, result)["choices"] == result["choices"]


def test_a_choice_whose_file_was_fitted_again_is_none(measured, tmp_path):
    folder, result = measured
    shutil.copy(folder / "records.jsonl", tmp_path)
    trade.write(tmp_path, result)
    job = load_run(folder).job("tiny/mean-colour/0")
    assert load_trade(tmp_path)["choices"] == result["choices"]
    append(tmp_path, job | {"score_key": job["score_key"] | {"sha256": "another"}})
    labels = [row["label"] for row in load_trade(tmp_path)["choices"]]
    assert labels == [row["label"] for row in result["choices"] if row["label"] != "mean-colour"]


def test_no_sentence_or_profile_is_of_a_file_that_was_fitted_again(measured, tmp_path):
    folder, result = measured
    shutil.copy(folder / "records.jsonl", tmp_path)
    trade.write(tmp_path, result)
    best = max(usable_rungs(result["choices"], "tiny"), key=lambda rung: rung.score).of
    assert f"tiny: the best is {best['label']}" in " ".join(table_text(tmp_path, kind="trade").split())
    assert load_trade(tmp_path)["profiles"] == result["profiles"]
    job = load_run(folder).job(best["job"])
    append(tmp_path, job | {"score_key": job["score_key"] | {"sha256": "another"}})
    text = " ".join(table_text(tmp_path, kind="trade").split())
    assert "tiny: the best is " in text
    assert best["label"] not in text
    assert load_trade(tmp_path)["profiles"] == []


def choosing(monkeypatch, out, suite=SUITE, **wish):
    monkeypatch.setattr("bench.cli.commands.choose.load_suite", lambda name: suite)
    parser = argparse.ArgumentParser()
    choose_command.arguments(parser)
    options = vars(parser.parse_args(["tiny", "--out", str(out)]))
    return choose_command.run(argparse.Namespace(**options | wish))


@pytest.mark.parametrize(
    ("wish", "code", "words"),
    [
        ({"min_psnr": 1.0}, 0, "neubtf-bench encode tiny --codec "),
        ({"max_bytes": "1M", "max_ns": 1e9}, 0, "--codec "),
        ({"min_psnr": 99.0}, 1, "no setting meets that; the nearest is"),
        ({"max_bytes": "1"}, 1, "the nearest is pca components=2"),
    ],
)
def test_choose_picks_from_what_was_measured_or_says_how_near_it_came(measured, monkeypatch, capsys, wish, code, words):
    monkeypatch.delattr("bench.cli.commands.choose.run_and_measure")
    assert choosing(monkeypatch, measured[0], **wish) == code
    assert words in capsys.readouterr().out


def test_choose_measures_what_is_missing(measured, tmp_path, monkeypatch, capsys):
    result = measured[1]
    shutil.copy(measured[0] / "records.jsonl", tmp_path)
    trade.write(tmp_path, result | {"choices": [row for row in result["choices"] if row["label"] == "mean-colour"]})
    measure = "bench.cli.commands.choose.run_and_measure"
    monkeypatch.setattr(measure, lambda suite, options, tell, **_: trade.write(options.folder, result))
    best = max(rung.score for rung in usable_rungs(result["choices"], "tiny"))
    for wish, code, measures in ((1.0, 0, False), (best - 0.01, 0, True), (99.0, 1, False)):  # at last all was tried
        assert choosing(monkeypatch, tmp_path, min_psnr=wish) == code
        assert ("2 of 3 settings of test are not measured in" in capsys.readouterr().out) == measures


def test_the_timing_that_follows_is_told_before_and_during_the_fits(tmp_path, monkeypatch):
    monkeypatch.setattr(trade, "exists_on", lambda variant, device: variant == Variant.parse("eager bfloat16"))
    monkeypatch.setattr(native, "emulated", lambda precision, device: False)
    monkeypatch.setattr(timing, "TURNS", 60)  # other tests of this file lower these for all that follow
    monkeypatch.setattr("bench.timing.SPAN_NS", 3_000_000)
    monkeypatch.setattr(trade, "BATCH", 65_536)
    asked = []
    monkeypatch.setattr(trade.runner, "run", lambda suite, options: asked.append(options) or iter(()))
    swept = CodecSpec("pca", {"components": 2}, ("components",))
    own = replace(SUITE, codecs=(CodecSpec("mean-colour"), swept), seeds=(0, 1))
    earlier = SimpleNamespace(
        job=lambda name: {"job": name} if name == "tiny/mean-colour/0" else None,
        timing=lambda job: {"ns_per_sample": 90_000.0},
    )
    monkeypatch.setattr(trade, "load_run", lambda folder: earlier)
    (tmp_path / "records.jsonl").touch()
    trade.run_and_measure(own, Options(tmp_path), print)
    # 60 turns of 65,536 samples: of one file at 90 µs in two precisions, of the other at 1 µs in one.
    assert round(65_536 * (2 * 90e-6 + 1e-6)) == 12
    assert [options.then for options in asked] == ["about 12 min of timing"]


def test_what_choose_measures_is_of_the_codecs_steps_and_processes_asked_for(measured, tmp_path, monkeypatch, capsys):
    asked = []
    monkeypatch.setattr(
        "bench.cli.commands.choose.run_and_measure", lambda suite, options, tell, **_: asked.append((suite, options))
    )
    monkeypatch.setattr("bench.runs.executors.processes", lambda *words: words)
    wish = {"codec": ["neubtf-direct"], "min_psnr": 99.0}
    assert choosing(monkeypatch, tmp_path, **wish, steps=7, jobs=3) == 3  # the stub measures nothing
    ((suite, options),) = asked
    assert [spec.label for spec in suite.codecs] == ["neubtf-direct steps=7"]
    assert options.workers() == (3, 1, "cpu", None)
    options.say("1 job: 1 left")
    said = capsys.readouterr().out
    assert "1 of 1 settings of test are not measured in" in said
    assert "1 job: 1 left" in said


def test_a_setting_that_is_spelled_out_as_the_default_is_measured_once(measured, tmp_path, monkeypatch):
    monkeypatch.delattr("bench.cli.commands.choose.run_and_measure")
    spelled = replace(SUITE, codecs=(CodecSpec("pca", {"components": 2, "passes": 4}),))
    assert choosing(monkeypatch, measured[0], spelled, min_psnr=99.0) == 1


def test_the_command_that_choose_names_prepares_the_data_as_it_was_measured(measured, monkeypatch, capsys):
    small = replace(SUITE, data=Preparation(size=12, repair=True, validation=True))
    assert choosing(monkeypatch, measured[0], small, min_psnr=1.0) == 0
    # Without `repair`: the material is rendered, and `encode` refuses a setting that has no effect.
    assert " --set data.size=12 --set data.validation=true -o tiny.nbtf" in capsys.readouterr().out
