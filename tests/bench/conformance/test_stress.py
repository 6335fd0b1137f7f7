import re
from collections import Counter

import pytest

from baselines.mean_colour import MeanColour, MeanColourMaterial
from bench.cli import main
from bench.codec import Parts
from bench.codecs.registry import codec_entries, from_outside, load_codec
from bench.conformance.stress import CASES, metrics, properties
from bench.conformance.stress.case import subject_of
from bench.conformance.stress.invariants import wild_rates
from bench.conformance.stress.queries import not_above_horizon
from bench.conformance.verdicts import stress_reference
from bench.inputs.errors import InputError
from bench.records import load_run
from bench.training.fitting import DivergedError
from tests.bench.conformance.test_broken_codecs import Rate, verdict, with_material


def test_what_no_surface_looks_like_is_not_asked_of_a_model_of_reflectance(tmp_path, monkeypatch):
    unphysical = ["two constants", "65,504 beside zeros", "highlights of 1e6", "lights only at grazing"]
    physical = type("Physical", (MeanColour,), {"physical": True})
    for name in unphysical:
        assert verdict(physical, name, tmp_path, monkeypatch).verdict == "n/a"
    assert verdict(physical, "all zero", tmp_path, monkeypatch).verdict == "pass"


def test_views_and_lights_alike_lie_at_the_horizon_and_below():
    asked = not_above_horizon()
    for z in (asked.wo[:, 2], asked.wi[:, 2]):
        assert (z[z <= 0] == 0).sum() == 16  # of 0 and −0
        assert (z.signbit() & (z == 0)).sum() == 8
        assert ((z < 0) & (z > -1e-20)).any()
        assert (z < -0.1).sum() == 8


@pytest.mark.parametrize("name", ["fp16, all of the above", "fp16 against fp64"])
def test_short_floats_pass_with_the_decibels_that_they_cost(name, tmp_path, monkeypatch):
    outcome = verdict(MeanColour, name, tmp_path, monkeypatch)
    decibels, unit = outcome.figure.split()
    assert (outcome.verdict, unit) == ("pass", "dB")
    assert 50 < float(decibels) < 100  # ten bits of mantissa


class Dark(MeanColourMaterial):
    def evaluate(self, uv, wo, wi, footprint):
        return super().evaluate(uv, wo, wi, footprint) * 0


def says_so(self, btf, fit):
    if self.settings.rate > 1:
        raise DivergedError("the fit diverged")
    return MeanColour.encode(self, btf, fit)


def gives_no_number(self, btf, fit):
    return Parts(texture={"mean": MeanColour.encode(self, btf, fit).texture["mean"] * float("nan")})


@pytest.mark.parametrize(("says", "due"), [("65,504 is the largest radiance it stores", "pass"), ("no", "fail")])
def test_highlights_beyond_half_may_be_refused_by_name(says, due, tmp_path, monkeypatch):
    class Refuses(MeanColour):
        def encode(self, btf, fit):
            raise InputError(says)

    outcome = verdict(Refuses, "highlights of 1e6", tmp_path, monkeypatch)
    assert (outcome.verdict, outcome.figure) == (due, "refused" if due == "pass" else "unclear")


@pytest.mark.parametrize("encode", [says_so, gives_no_number])
def test_a_fit_that_says_that_it_diverged_passes(encode, tmp_path, monkeypatch):
    codec = type("Says", (Rate,), {"encode": encode})
    assert verdict(codec, "a fit that diverges", tmp_path, monkeypatch).verdict == "pass"


@pytest.mark.parametrize(("name", "rates"), [("zeltner2024", 3), ("rainer2019", 3), ("triple-plane", 3), ("pca", 0)])
def test_learning_rates_are_found_though_their_types_say_ranges(name, rates):
    assert len(wild_rates(load_codec(name))) == rates


class BrightToTheRight(MeanColourMaterial):
    def evaluate(self, uv, wo, wi, footprint):
        return super().evaluate(uv, wo, wi, footprint) + (uv[:, :1] > 0.5) * 100


def test_the_smallest_failing_query_is_printed_as_a_command_that_fails_again(tmp_path, monkeypatch):
    codec = with_material(BrightToTheRight)
    outcome = verdict(codec, "drawn queries", tmp_path, monkeypatch)
    assert outcome.verdict == "fail"
    found = re.search(r'stress --codec mean-colour --query "([^"]+)"', outcome.detail)[1]
    numbers = [float(x) for x in found.split()]
    assert numbers[1:] == [0, 0, 0, 1, 0, 0, 1, 0]  # shrunk: both directions at the zenith, no footprint, v = 0
    with pytest.raises(properties.CheckError, match="a firefly"):
        properties.query_holds(subject_of(codec, tmp_path), numbers)


def test_metrics_and_losses_survive_extreme_pictures():
    cells = {(n, case.name): metrics.judge(t, case) for n, t in metrics.subjects().items() for case in metrics.CASES}
    assert {cell: verdict for cell, verdict in cells.items() if verdict.verdict == "fail"} == {}
    refused = {cell for cell, verdict in cells.items() if verdict.verdict == "n/a"}
    assert refused == {("ssim", "one texel")}, refused


def test_the_command_records_prints_and_says_no(tmp_path, monkeypatch, capsys):
    command = ["stress", "--codec", "mean-colour", "--case", "two constants", "--case", "sine of 1e5", "--jobs", "1"]
    command += ["--out", str(tmp_path / "out")]
    assert main(command) == 0
    printed = capsys.readouterr().out
    assert re.search(r"^two constants +pass$", printed, re.M)
    assert re.search(r"^sine of 1e5 +n/a a$", printed, re.M)
    assert re.search("a: .*sine$", printed, re.M)
    monkeypatch.setattr("bench.conformance.stress.run.load_codec", lambda name: with_material(Dark))
    monkeypatch.setattr("bench.codecs.registry.load_codec", lambda name, wanted_by="": with_material(Dark))
    assert main(command) == 1
    printed = capsys.readouterr().out
    assert re.search(r"^two constants +FAIL 100.0%$", printed, re.M)
    assert re.search(r"FAIL mean-colour.*0\.5.*0\.125", printed)
    assert "`physical" in printed  # the remedy
    run = load_run(tmp_path / "out")
    recorded = {(r["subject"], r["extreme"], r["verdict"], r["version"]) for r in run.stress}
    assert recorded == {("mean-colour", "two constants", "fail", 1), ("mean-colour", "sine of 1e5", "n/a", 1)}


def test_its_folder_is_no_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["stress", "--codec", "mean-colour", "--case", "sine of 1e5", "--jobs", "1"]) == 0
    assert "runs/stress" in capsys.readouterr().out
    assert main(["table", "stress"]) == 0
    assert "n/a" in capsys.readouterr().out
    assert main(["table"]) == 2
    assert "runs/" in capsys.readouterr().err


def test_a_drawn_case_is_tried_again(monkeypatch, capsys):
    assert main(["stress", "--codec", "mean-colour", "--query", "-0.5 0 0 0 1 0 0 1 0", "--data", "2 3 1 2 -8 5"]) == 0
    assert re.search(r"^pass  mean-colour: \[.*\], .*e-0", capsys.readouterr().out)

    def broken(*_):
        raise KeyError("mean")

    monkeypatch.setattr(MeanColour, "encode", broken)
    assert main(["stress", "--codec", "mean-colour", "--data", "2 3 1 2 -8 5"]) == 1
    assert re.search("FAIL.*mean-colour.*KeyError", capsys.readouterr().out)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--case", "constat"], "no such case"),
        (["--case", "one pair", "--cheap"], "none of the cases given is cheap"),
        (["--codec", "pac"], "did you mean"),
        (["--codec", "pca", "--query", "0 0 1"], "it takes 9 numbers, not 3"),
        (["--codec", "pca", "--data", "a b"], "give numbers"),
        (["--codec", "pca", "--data", "1 1 0 1 0 0"], "at least one texel and pair"),
        (["--codec", "pca", "--data", "1 1 1 1 0 -1"], "a seed of at least 0"),
        (["--codec", "pca", "--data", "1 1 1 1 5000 1"], "an exponent from"),
        (["--codec", "pca", "--query", "0 0 0 0 2 0 0 1 0"], "not of unit length"),
    ],
)
def test_bad_usage_is_named(words, message, tmp_path, capsys):
    assert main(["stress", "--out", str(tmp_path / "out"), *words]) == 2
    assert message in capsys.readouterr().err


def test_every_built_in_codec_is_in_the_reference():
    """`neubtf-bench stress --codec NAME --out runs/stress` measures a new one: docs/stress.md."""
    measured = {record["subject"] for record in load_run(stress_reference()).stress}
    built_in = {name for name in codec_entries() if not from_outside(name)}
    assert built_in - measured == set()
    each = Counter(record["subject"] for record in load_run(stress_reference()).stress if record["subject"] in built_in)
    assert set(each.values()) == {len(CASES)}
