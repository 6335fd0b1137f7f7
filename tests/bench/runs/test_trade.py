import argparse
import re
import shutil
import sys
import threading
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch

from bench import cli, timing
from bench.cli.commands import choose as choose_command
from bench.compare.choosing import best_choices_in_words, name_of_choice, on_front, usable_rungs
from bench.conformance.check import tiny_btf
from bench.data.spec import MaterialSpec, Preparation
from bench.inputs.errors import InputError
from bench.material import DecoderCost
from bench.records import append, load_run
from bench.runs import trade
from bench.runs.job import Outcome
from bench.runs.runner import Options, run
from bench.runs.suite import CodecSpec, Suite
from bench.timing import native
from bench.timing.execution import Variant
from bench.timing.roofline import least_ns
from reports import table_text
from reports.numbers import NONE
from reports.rows import materials
from reports.trade import _stability_table, trade_tables

CODECS = (
    CodecSpec("mean-colour"),
    CodecSpec("pca", {"components": 2}, ("components",)),
    CodecSpec("neubtf-direct", {"steps": 20}),
)
VARIANTS = ("eager bfloat16", "fused float32", "fused bfloat16", "compiled tf32")  # the last two are of GPUs
DATA = Preparation(validation=True)
SUITE = Suite("test", "", data=DATA, materials=(MaterialSpec("tiny"),), codecs=CODECS, variants=VARIANTS)


def without_drjit(device):
    raise InputError("pip install neubtf-bench[mitsuba]")


@pytest.fixture(scope="module")
def brief():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(timing, "TURNS", 3)
        patch.setattr("bench.timing.SPAN_NS", 10_000)
        patch.setattr(trade, "BATCH", 256)
        yield


@pytest.fixture(scope="module")
def ran(tmp_path_factory, brief):
    """The folder of a run before anything is timed for a trade."""
    folder = tmp_path_factory.mktemp("ran")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bench.runs.workbench.open_material", lambda *_: tiny_btf(12, 6, 6).with_validation())
        assert {outcome.record["status"] for outcome in run(SUITE, Options(folder))} == {"ok"}
    return folder


@pytest.fixture(scope="module")
def measured(tmp_path_factory, ran):
    """The folder of a run with its trade, which tests do not change."""
    folder = shutil.copytree(ran, tmp_path_factory.mktemp("trade") / "run")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bench.runs.workbench.open_material", lambda *_: tiny_btf(12, 6, 6).with_validation())
        patch.setattr("bench.timing.execution.target_of", without_drjit)
        patch.setattr("bench.timing.roofline.COPIED", 1 << 20)
        patch.setattr("bench.timing.roofline.SIDE", 64)  # without AVX-512, bfloat16 multiplies slowly
        patch.setattr(native, "emulated", lambda precision, device: False)  # on any processor
        measure(SUITE, folder)
    return folder


@pytest.fixture
def fresh(ran, tmp_path):
    """A copy of the run without a trade."""
    return shutil.copytree(ran, tmp_path / "run")


@pytest.fixture
def copied(measured, tmp_path):
    """A copy of the run with its trade."""
    return shutil.copytree(measured, tmp_path / "measured")


def measure(suite, folder, **options):
    """Measure the choices of a run in a folder; returns the run as it is then stored."""
    trade.measure(suite, load_run(folder), "cpu", **options)
    return load_run(folder)


def by_name(run):
    return {name_of_choice(row): row for row in run.choices}


def test_every_setting_and_variant_is_a_choice_and_the_floor_stands_beside_them(measured):
    names = list(by_name(load_run(measured)))
    without_network = ["mean-colour", "mean-colour [fused float32]", "pca components=2"]
    with_one = [f"neubtf-direct steps=20{how}" for how in ("", " [eager bfloat16]", " [fused float32]")]
    assert names == [*without_network, *with_one, timing.FLOOR]


def test_quality_is_that_of_the_record_and_variants_are_scored_from_the_same_file(measured):
    found = load_run(measured)
    record = found.job("tiny/neubtf-direct steps=20/0")
    rows = by_name(found)
    plain, half = rows["neubtf-direct steps=20"], rows["neubtf-direct steps=20 [eager bfloat16]"]
    assert plain["psnr"] == record["scores"]["heldout"]["metrics"]["psnr_display"]["mean"]
    assert plain["bytes"] == half["bytes"] == record["bytes"]["total"]
    assert half["psnr"] != plain["psnr"]
    assert half["psnr"] == pytest.approx(plain["psnr"], abs=0.3)
    assert plain["worst"] < plain["psnr"]
    assert 20 < half["from_float32"] < 80  # bfloat16 has three digits
    assert "from_float32" not in plain
    assert "stability" in table_text(measured, "text", "trade", whole=True)
    of_record = record["scores"]["validation"]["metrics"]["psnr_display"]
    assert plain["validation"]["pooled"] == of_record["pooled"]
    assert half["validation"]["slices"] == of_record["slices"]
    assert half["validation"]["pooled"] == pytest.approx(of_record["pooled"], abs=0.3)


def test_what_cannot_be_computed_is_a_row_that_says_why(measured):
    for label in ("mean-colour", "neubtf-direct steps=20"):
        row = by_name(load_run(measured))[f"{label} [fused float32]"]
        assert "neubtf-bench[mitsuba]" in row["error"]
        assert "ns_per_sample" not in row


def test_what_has_a_record_is_not_measured_again(quick, fresh, monkeypatch):
    """Scores are kept if the timing is interrupted; what is timed is measured again only for another file or score."""
    monkeypatch.setattr(native, "emulated", lambda precision, device: False)
    suite = replace(SUITE, codecs=SUITE.codecs[2:], variants=("eager bfloat16",))
    in_turns, timed = timing.in_turns, []

    def interrupted(*_):
        raise KeyboardInterrupt

    def counted(calls, *rest):
        timed.append([name for name in calls if name.startswith("tiny")])
        return in_turns(calls, *rest)

    monkeypatch.setattr(timing, "in_turns", interrupted)
    with pytest.raises(KeyboardInterrupt):
        measure(suite, fresh)
    assert load_run(fresh).choices == []  # scored, and not yet timed
    monkeypatch.setattr(timing, "in_turns", counted)
    with monkeypatch.context() as patch:
        patch.setattr(trade, "_figures_of_choice", lambda *_: pytest.fail("scored again"))
        first = measure(suite, fresh)
        assert measure(suite, fresh).choices == first.choices
    assert list(map(len, timed)) == [2]
    assert by_name(first)["neubtf-direct steps=20 [eager bfloat16]"]["from_float32"] > 20
    job = first.job("tiny/neubtf-direct steps=20/0")
    append(fresh, job | {"score_key": job["score_key"] | {"exposure": 2.0}})
    again = measure(suite, fresh)
    assert list(map(len, timed)) == [2, 2]
    assert {row["score_key"]["exposure"] for row in again.choices if "of" in row} == {2.0}


def test_a_share_above_the_whole_limit_is_marked_and_explained(copied):
    note = "100 %"
    row = by_name(load_run(copied))["mean-colour"]
    append(copied, row | {"limit_ns": 0.5 * row["ns_per_sample"]})
    assert note not in table_text(copied, kind="trade", whole=True).partition("floor ")[0]
    append(copied, row | {"limit_ns": 1.25 * row["ns_per_sample"]})
    text = table_text(copied, kind="trade", whole=True)
    assert re.search(r"^mean-colour .* 125\.0 \*", text, re.M)
    assert note in text


@pytest.fixture
def quick(brief, monkeypatch):
    monkeypatch.setattr("bench.runs.workbench.open_material", lambda *_: tiny_btf(12, 6, 6).with_validation())
    monkeypatch.setattr("bench.timing.roofline.COPIED", 1 << 20)
    monkeypatch.setattr("bench.timing.roofline.SIDE", 64)
    monkeypatch.setattr(trade, "roofline", lambda device, threads, dtype=torch.float32: ceiling(str(dtype)[6:], 50.0))


def test_a_variant_that_fails_unforeseen_is_a_row_that_says_so(fresh, quick, monkeypatch):
    plain = trade.prepared

    def prepared(material, variant):
        if variant != Variant():
            raise ValueError("zip() argument 2 is shorter\nthan argument 1")
        return plain(material, variant)

    monkeypatch.setattr(trade, "prepared", prepared)
    suite = replace(SUITE, codecs=SUITE.codecs[2:], variants=("fused float32",))
    rows = by_name(measure(suite, fresh))
    error = "ValueError: zip() argument 2 is shorter than argument 1"
    assert rows["neubtf-direct steps=20 [fused float32]"]["error"] == error
    assert rows["neubtf-direct steps=20"]["ns_per_sample"] > 0


def test_a_file_whose_slices_are_gone_is_a_row_that_says_so_and_loses_only_its_own_figures(fresh, quick, monkeypatch):
    monkeypatch.setattr(native, "emulated", lambda precision, device: False)  # on any processor
    (fresh / load_run(fresh).job("tiny/neubtf-direct steps=20/0")["slices"]).unlink()
    alone = replace(SUITE, codecs=SUITE.codecs[2:], variants=())
    (row,) = measure(alone, fresh).choices  # nothing can be timed, and there is no floor
    assert (row["label"], "ns_per_sample" in row) == ("neubtf-direct steps=20", False)
    measure(replace(SUITE, variants=("eager bfloat16",)), fresh)
    text = table_text(fresh, kind="trade", whole=True)
    (line,) = re.findall(r"^neubtf-direct steps=20 +\S+ +\S+ +(\S+) +\S+\n\[eager bfloat16\]", text, re.M)
    assert line == "—"  # gained on what is not known


def test_a_codec_with_seeds_of_its_own_is_timed_at_the_first_of_them(tmp_path, quick):
    codec = replace(SUITE.codecs[0], seeds=(3, 4))
    suite = replace(SUITE, codecs=(codec,), variants=())
    assert len(list(run(suite, Options(tmp_path)))) == 2
    row = by_name(measure(suite, tmp_path))["mean-colour"]
    assert row["of"] == "tiny/mean-colour/3"
    assert row["ns_per_sample"] > 0


def test_what_another_program_decodes_is_scored_and_not_timed(measured, fresh, quick, monkeypatch):
    plain, of_programs = trade.material_of_job, {"mean-colour"}

    def material_of_job(folder, job, device):
        material = plain(folder, job, device)
        if job["label"] in of_programs:
            material.opaque = True
            material.process = threading.Lock()  # which cannot be copied, like the process of a program
        return material

    monkeypatch.setattr(trade, "material_of_job", material_of_job)
    suite = replace(SUITE, codecs=SUITE.codecs[:2], variants=("fused float32",))
    other = shutil.copytree(fresh, fresh.parent / "other")
    rows = by_name(measure(suite, fresh))
    assert list(rows) == ["mean-colour", "pca components=2", timing.FLOOR]
    assert rows["mean-colour"]["psnr"] == by_name(load_run(measured))["mean-colour"]["psnr"]
    text = table_text(fresh, kind="trade", whole=True)
    (line,) = (line for line in text.splitlines() if line.startswith("mean-colour "))
    assert line.split()[1] == f"{rows['mean-colour']['psnr']:.2f}"
    assert line.split()[-5:] == ["—"] * 5
    assert f"mean-colour: {rows['mean-colour']['error']}." in " ".join(text.split())
    # If all of them are programs, nothing is timed.
    of_programs.add("pca components=2")
    assert list(by_name(measure(suite, other))) == ["mean-colour", "pca components=2"]


def test_what_was_measured_of_a_material_is_kept_when_the_next_one_fails(fresh, quick, monkeypatch):
    other = MaterialSpec("other")
    plain = trade._jobs_of

    def jobs_of(run, suite, spec):
        if spec == other:
            raise KeyboardInterrupt
        return plain(run, suite, spec)

    monkeypatch.setattr(trade, "_jobs_of", jobs_of)
    monkeypatch.setattr(trade.runner, "run", lambda *_: [Outcome({"status": "ok"})])
    suite = replace(SUITE, materials=(*SUITE.materials, other), codecs=SUITE.codecs[:1], variants=())
    with pytest.raises(KeyboardInterrupt):
        trade.run_and_measure(suite, Options(fresh), lambda _: None)
    assert list(by_name(load_run(fresh))) == ["mean-colour", timing.FLOOR]


def test_a_choice_is_on_a_front_where_nothing_is_as_good_for_less():
    rows = [
        {"psnr": 30.0, "ns_per_sample": 100.0, "bytes": 10},
        {"psnr": 30.0, "ns_per_sample": 90.0, "bytes": 20},
        {"psnr": None, "ns_per_sample": 900.0, "bytes": 900},  # exact
        {"psnr": 29.0, "ns_per_sample": 95.0, "bytes": 5},
        {"psnr": 30.001, "ns_per_sample": 110.0, "bytes": 10},  # the first, computed otherwise
    ]
    rows = [row | {"job": name} for name, row in zip("abcde", rows, strict=True)]
    assert on_front(rows, "ns_per_sample") == {"b", "c"}
    assert on_front(rows, "bytes") == {"a", "c", "d", "e"}


def test_the_answer_names_the_cheapest_within_half_a_decibel_of_the_best():
    rows = [
        {"label": "big", "psnr": 40.0, "ns_per_sample": 100.0, "bytes": 1000},
        {"label": "small", "psnr": 39.6, "ns_per_sample": 120.0, "bytes": 10},
        {"label": "fast", "psnr": 39.7, "ns_per_sample": 20.0, "bytes": 500},
        {"label": "poor", "psnr": 39.4, "ns_per_sample": 1.0, "bytes": 1},
        {"label": "table", "psnr": 41.0, "ns_per_sample": 10.0, "bytes": 5},  # uncompressed: no choice
    ]
    rows = [row | {"material": "m", "codec": row["label"], "execution": "eager", "dtype": "float32"} for row in rows]
    rows = [row | {"ratio_to_floor": 2.0, "ratio_interval95": [1.9, 2.1]} for row in rows]
    rows = [row | {"validation": {"pooled": row["psnr"], "mean": row["psnr"], "slices": 9}} for row in rows]
    best, fastest, smallest = best_choices_in_words(rows, "m")
    assert all(part in best for part in ("big", "40.00 dB", "1,000 bytes", "100 ns"))
    assert re.search(r"\bfast\b", fastest)
    assert re.search(r"\bsmall\b", smallest)
    _, fastest, smallest = best_choices_in_words(rows[2:3], "m")
    assert "no other" in fastest
    assert "no other" in smallest


def test_a_job_that_failed_is_a_row_that_says_why(tmp_path):
    job = {"kind": "job", "job": "tiny/mean-colour/0", "material": "tiny", "label": "mean-colour"}
    job |= {"codec": "mean-colour", "seed": 0, "status": "failed", "error": "no\nmemory"}
    append(tmp_path, job)
    (row,) = measure(replace(SUITE, variants=()), tmp_path).choices
    assert (row["label"], row["error"]) == ("mean-colour", "failed: no memory")


def ceiling(dtype, flops, copied=10.0, threads=1):
    return {"device": "cpu", "dtype": dtype, "flops_per_ns": flops, "bytes_per_ns": copied, "threads": threads}


@pytest.mark.parametrize(
    ("precision", "ceilings", "limit"),
    [
        ("float32", [ceiling("float32", 50.0)], 2.0),  # 100 flops
        ("bfloat16", [ceiling("float32", 50.0), ceiling("bfloat16", 100.0)], 1.0),
        ("bfloat16", [ceiling("float32", 50.0), ceiling("bfloat16", 5.0)], 2.0),  # emulated: products stay wide
        ("float32", [ceiling("float32", 50.0), ceiling("bfloat16", 100.0)], 2.0),
        ("float32", [ceiling("float32", 50.0, 2.0)], 4.0),  # 8 bytes
        ("bfloat16", [ceiling("float32", 50.0, 2.0)], 2.0),  # half as many
    ],
)
def test_the_limit_is_the_faster_of_the_precisions_that_could_be_used(precision, ceilings, limit):
    material = SimpleNamespace(cost=DecoderCost(flops_per_sample=100, bytes_per_sample=8))
    assert least_ns(material, precision, ceilings) == pytest.approx(limit)


def test_precisions_that_the_processor_emulates_are_left_out_and_said_so(fresh, quick, monkeypatch):
    suite = replace(SUITE, codecs=SUITE.codecs[2:], variants=("eager bfloat16", "fused bfloat16", "compiled tf32"))
    monkeypatch.setattr(native, "emulated", lambda precision, device: precision == "bfloat16")
    found = by_name(measure(suite, fresh))
    assert list(found) == ["neubtf-direct steps=20", timing.FLOOR]
    assert {ceiling["dtype"] for ceiling in found[timing.FLOOR]["ceilings"]} == {"float32"}
    text = " ".join(table_text(fresh, kind="trade", whole=True).split())
    assert re.search(r"eager bfloat16\..*--emulated", text)
    assert "neubtf-direct steps=20 [eager bfloat16, emulated]" in by_name(measure(suite, fresh, emulated=True))
    text = table_text(fresh, kind="trade", whole=True)
    assert re.search(r"^\[eager bfloat16, *\nemulated\]", text, re.M)  # a cell of the table, folded
    assert "--emulated" not in text


@pytest.fixture
def path_traced(fresh, quick, monkeypatch):
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
    measure(suite, fresh, noise=True)
    return fresh


def test_noise_is_of_each_file_and_stands_in_columns_of_its_own(measured, path_traced):
    rows = by_name(load_run(path_traced))
    noise = {"scene": "ball, even sky", "samples": [40_000.0, 9_876.0], "seconds": [3.0, 1.5]}
    assert rows["neubtf-direct steps=20"]["noise"] == noise
    assert rows["mean-colour"]["noise_error"] == "cannot be recorded"
    bare = ("neubtf-direct steps=20 [eager bfloat16]", timing.FLOOR)  # the same file, and none
    assert not any("noise" in rows[name] or "noise_error" in rows[name] for name in bare)
    assert "noise" not in table_text(measured, kind="trade", whole=True)
    text = table_text(path_traced, kind="trade", whole=True)
    (line,) = (line for line in text.splitlines() if line.startswith("pca components=2 "))
    assert line.split()[-4:] == ["40,000", "9,876", "3.00", "1.50"]
    (line,) = (line for line in text.splitlines() if line.startswith("mean-colour "))
    assert line.split()[-4:] == ["—"] * 4
    assert re.search(f"mean-colour: .*{rows['mean-colour']['noise_error']}", text)
    assert noise["scene"] in " ".join(text.split())


def test_noise_without_mitsuba_is_refused_before_any_work(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "bench.demand.mitsuba", None)  # whatever an earlier test has imported
    assert cli.main(["trade", "--noise", "--material", "satin", "--out", str(tmp_path / "run")]) == 2
    said = capsys.readouterr().err
    assert "neubtf-bench[mitsuba]" in said
    assert "--noise" in said
    assert not (tmp_path / "run").exists()


def test_no_choice_or_sentence_is_of_a_file_that_was_fitted_again(copied):
    found = load_run(copied)
    best = max(usable_rungs(found.choices, "tiny"), key=lambda rung: rung.score).of
    assert f"best is {best['label']}:" in " ".join(table_text(copied, kind="trade", whole=True).split())
    job = found.job(best["of"])
    append(copied, job | {"score_key": job["score_key"] | {"sha256": "another"}})
    left = load_run(copied)
    assert left.choices == [row for row in found.choices if row["label"] != best["label"]]
    text = " ".join(table_text(copied, kind="trade", whole=True).split())
    assert "best is " in text
    assert best["label"] not in text


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
    assert choosing(monkeypatch, measured, **wish) == code
    assert words in capsys.readouterr().out


def test_choose_measures_what_is_missing(measured, fresh, monkeypatch, capsys):
    rows = load_run(measured).choices
    for row in rows:
        if row["label"] == "mean-colour":
            append(fresh, row)
    measure = "bench.cli.commands.choose.run_and_measure"
    monkeypatch.setattr(
        measure, lambda suite, options, tell, **_: [append(options.folder, row) for row in rows] and None
    )
    best = max(rung.score for rung in usable_rungs(rows, "tiny"))
    for wish, code, measures in ((1.0, 0, False), (best - 0.01, 0, True), (99.0, 1, False)):  # at last all was tried
        assert choosing(monkeypatch, fresh, min_psnr=wish) == code
        assert ("2 of 3" in capsys.readouterr().out) == measures


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
    options.say("1 left")
    said = capsys.readouterr().out
    assert "1 of 1" in said
    assert "1 left" in said


def test_a_setting_that_is_spelled_out_as_the_default_is_measured_once(measured, tmp_path, monkeypatch):
    monkeypatch.delattr("bench.cli.commands.choose.run_and_measure")
    spelled = replace(SUITE, codecs=(CodecSpec("pca", {"components": 2, "passes": 4}),))
    assert choosing(monkeypatch, measured, spelled, min_psnr=99.0) == 1


def test_a_setting_that_the_suite_lacks_is_chosen_if_it_was_measured(measured, monkeypatch, capsys):
    monkeypatch.delattr("bench.cli.commands.choose.run_and_measure")
    other = replace(SUITE, codecs=(CodecSpec("pca", {"components": 3}),))
    assert choosing(monkeypatch, measured, other, min_psnr=1.0) == 0
    (command,) = (line for line in capsys.readouterr().out.splitlines() if line.startswith("neubtf-bench encode"))
    assert " --codec pca " in command
    assert " --set components=2 " in command
    assert "--seed" not in command


def test_the_command_that_choose_names_prepares_the_data_as_it_was_measured(measured, monkeypatch, capsys):
    small = replace(SUITE, data=Preparation(size=12, repair=True, validation=True))
    assert choosing(monkeypatch, measured, small, min_psnr=1.0) == 0
    # Without `repair`: the material is rendered, and `encode` refuses a setting that has no effect.
    assert " --set data.size=12 --set data.validation=true -o tiny.nbtf" in capsys.readouterr().out


def test_the_table_has_the_choices_that_none_beats_and_all_has_the_others_too(measured):
    run = load_run(measured)
    (short,) = trade_tables(run, materials(run))
    every, *others = trade_tables(run, materials(run), whole=True)
    on_front = every.values["on the front"] != NONE
    assert 0 < on_front.sum() < len(on_front)
    missing = every.values["total"].isna()  # the floor
    assert list(short.values["choice"]) == list(every.values["choice"][on_front | missing])
    assert others


def test_choices_of_two_devices_have_tables_of_their_own(measured, tmp_path):
    shutil.copytree(measured, tmp_path / "both")
    for choice in load_run(measured).choices:
        on_gpu = {"job": f"{choice['job']}/cuda", "device": "cuda", "gpu": "NVIDIA H200"}
        append(tmp_path / "both", choice | on_gpu)
    run = load_run(tmp_path / "both")
    tables = [*trade_tables(run, materials(run))]
    assert [table.title.rpartition(", on ")[2] for table in tables] == ["cpu", "cuda"]
    assert len(tables[0].rows) == len(tables[1].rows)
    assert ["NVIDIA H200" in " ".join(table.notes) for table in tables] == [False, True]


def test_a_record_without_any_error_has_no_psnr_and_gains_nothing():
    exact = {"label": "table", "dtype": "float32", "psnr": None, "of": "satin/table/0", "ratio_to_floor": 2.0}
    rows = [exact | {"execution": "eager"}, exact | {"execution": "fused", "from_float32": None}]
    table = _stability_table("satin", "", rows, set())
    assert table.values["gained"].tolist() == [0.0]
