import argparse
import json
import re
import shlex
import subprocess
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from bench import cli
from bench.cli.commands.choose import parse_bytes
from bench.codecs.container import read_header
from bench.compare.choosing import TIE_DB, Limits, best_rung, choice_in_words, longest_ns, nearest, usable_rungs
from bench.conformance.check import tiny_btf
from bench.demand.demand import load as load_demand
from bench.inputs.errors import InputError
from bench.records import MOST_DB, append, load_run
from tests.bench.demand.scenes import SUN, camera, demand_of, surface


def row(name, psnr, size, ns, **more):
    stats = {"pooled": psnr, "mean": psnr, "slices": 9}
    choice = {"label": name, "psnr": 0.0, "validation": stats, "bytes": size, "ns_per_sample": ns, "material": "m"}
    choice |= {"ratio_to_floor": 2.0, "ratio_interval95": [2.0, 2.0]}
    choice |= {"of": f"m/{name}/0", "score_key": {"sha256": "0"}}
    return choice | {"execution": "eager", "dtype": "float32"} | more


ROWS = [row("exact", 100.0, 9000, 300.0), row("good", 36.0, 500, 100.0), row("fast", 33.0, 800, 20.0)]
RUNGS = usable_rungs(ROWS, "m")


@pytest.mark.parametrize(
    ("wishes", "name"),
    [
        (Limits(score=30), "good"),
        (Limits(score=40), "exact"),
        (Limits(size=1000), "good"),
        (Limits(time=50), "fast"),
        (Limits(size=10_000, time=1000), "exact"),
        (Limits(score=30, time=50), "fast"),
    ],
)
def test_the_smallest_that_is_good_enough_or_the_best_that_is_cheap_enough(wishes, name):
    assert best_rung(RUNGS, wishes).of["label"] == name


def test_ties_go_to_the_faster():
    """Executions of one file differ by rounding: 0.001 dB is not worth five times the time."""
    slow, fast = row("slow", 30.001, 500, 1210.0), row("fast", 30.0, 500, 227.0)
    lower = row("lower", 30.001 - TIE_DB - 0.001, 400, 1.0)
    rungs = usable_rungs([slow, fast, lower], "m")
    assert best_rung(rungs, Limits(size=1000), TIE_DB).of["label"] == "fast"
    assert best_rung(rungs, Limits(size=1000)).of["label"] == "slow"  # published tables choose so
    assert best_rung(rungs, Limits(size=400), TIE_DB).of["label"] == "lower"


def test_a_choice_fits_a_time_if_the_upper_end_of_its_interval_does():
    """A median of 45 ns at 4 × the floor, up to 5 × it: up to 56.25 ns."""
    (rung,) = usable_rungs([row("noisy", 30.0, 500, 45.0, ratio_to_floor=4.0, ratio_interval95=[3.5, 5.0])], "m")
    assert rung.time == 56.25
    assert best_rung([rung], Limits(time=56.0)) is None
    assert best_rung([rung], Limits(time=57.0)) is rung


def test_textures_on_a_gpu_may_be_limited_and_what_is_not_exported_does_not_count():
    rungs = [replace(RUNGS[0], gpu=9000.0), replace(RUNGS[1], gpu=5000.0), RUNGS[2]]
    assert best_rung(rungs, Limits(gpu=6000)).of["label"] == "good"
    assert best_rung(rungs, Limits(gpu=4000)) is None
    assert nearest(rungs, Limits(gpu=4000)).of["label"] == "good"


def test_the_psnr_that_decides_and_the_one_shown_are_named():
    words = choice_in_words(row("good", 30.58, 31_388, 227.0) | {"psnr": 31.84})
    assert re.match(r"good: .*30\.58.*validation.*31\.84.*test.*31,388.*227", words)


def test_a_file_is_exact_only_if_no_slice_has_an_error():
    near = row("near", MOST_DB, 1, 1.0) | {"psnr": MOST_DB, "worst": 49.0}
    exact = row("exact", MOST_DB, 1, 1.0) | {"psnr": None, "worst": None}
    exact["validation"] = exact["validation"] | {"exact": 9}
    assert ["exact on" in choice_in_words(each) for each in (near, exact)] == [False, True]
    assert "exact on validation pairs, exact on test pairs" in choice_in_words(exact)


def test_a_wish_that_none_meets_has_a_nearest():
    wishes = Limits(score=37, time=90)
    assert best_rung(RUNGS, wishes) is None
    assert nearest(RUNGS, wishes).of["label"] == "good"
    assert wishes.missed(nearest(RUNGS, wishes)) == ["time", "score"]


def test_rows_of_other_materials_failed_ones_those_without_validation_and_the_floor_are_no_choices():
    floor = {"material": "m", "label": "floor", "ns_per_sample": 1.0}
    others = [row("other", 1.0, 1, 1.0, material="n"), row("failed", 1.0, 1, 1.0, error="why"), floor]
    unseen = row("unseen", 99.0, 1, 1.0)
    del unseen["validation"]
    assert [rung.of for rung in usable_rungs([*ROWS, *others, unseen], "m")] == ROWS


def test_a_suite_without_validation_pairs_is_refused(tmp_path, capsys):
    suite = tmp_path / "own.toml"
    suite.write_text('materials = ["satin"]\n[[codecs]]\ncodec = "pca"\n')
    assert cli.main(["choose", "satin", "--min-psnr", "30", "--suite", str(suite)]) == 2
    assert "`validation = true`" in capsys.readouterr().err


def test_sizes_are_written_with_k_and_m():
    given = [argparse.Namespace(max_gpu_bytes=text) for text in ("300k", "1.5M", "20000", "300kB", None)]
    sizes = [parse_bytes(each, "max_gpu_bytes") for each in given]
    assert sizes == [300_000, 1_500_000, 20_000, 300_000, None]
    for text in ("much", "0", "0.4", "0.0001k"):
        with pytest.raises(InputError, match=f"--max-bytes {text}: "):
            parse_bytes(argparse.Namespace(max_bytes=text), "max_bytes")


@pytest.mark.long
def test_the_chosen_file_is_offered_and_the_command_makes_it_byte_for_byte(tmp_path, monkeypatch, capsys, brief_trade):
    """Measured data: the fit leaves the validation pairs out, and so does the command."""
    monkeypatch.chdir(tmp_path)
    btf = tiny_btf(64, 6, 6)
    every = np.stack([btf[i] for i in range(len(btf))])
    np.savez("cloth.npz", radiance=every, wo=btf.wo, wi=btf.wi)
    data = "data = {validation = true, texels = 3, views = 4}"  # `views` is for rendered materials
    codecs = 'codecs = [{codec = "neubtf-direct", steps = 2}]'
    (tmp_path / "own.toml").write_text(f"materials = []\nseeds = [3]\n{data}\n{codecs}\n")
    words = ["choose", "cloth.npz", "--max-bytes", "1M", "--suite", "own.toml", "--out", "r", "-o", "copied.nbtf"]
    words += ["--json", "choice.json"]
    assert cli.main(words) == 0
    *_, time, file, wrote, command, said = capsys.readouterr().out.splitlines()
    assert said == "wrote choice.json"
    assert wrote == "wrote copied.nbtf"
    assert cli.main(shlex.split(command)[1:]) == 0
    (stored,) = tmp_path.glob("r/files/*.nbtf")
    made = shlex.split(command)[-1]
    assert len({(tmp_path / each).read_bytes() for each in (made, "copied.nbtf", stored)}) == 1
    assert file.endswith(f", sha256 of its content {read_header(stored).sha256}")
    assert cli.main(["export", "copied.nbtf", "-o", "shader"]) == 0
    (exported,) = re.findall(r"^([\d,]+) bytes of textures on a GPU", capsys.readouterr().out, re.M)
    assert time.endswith(f"on a GPU: {exported} bytes of textures, as `export` writes them")
    chosen = json.loads(Path("choice.json").read_text())
    rows = load_run(Path("r")).choices
    named = [chosen[name] for name in ("label", "execution", "precision")]
    (row,) = (row for row in rows if [row["label"], row["execution"], row["dtype"]] == named)
    assert (Path(chosen["file"]).resolve(), chosen["bytes"]) == (stored, stored.stat().st_size)
    assert chosen["sha256"] == read_header(stored).sha256
    assert chosen["psnr"] == {"validation": row["validation"]["mean"], "test": row["psnr"]}
    assert (chosen["ns_per_sample"], chosen["longest_ns"]) == (row["ns_per_sample"], longest_ns(row))
    assert (chosen["codec"], chosen["settings"], chosen["label"]) == (row["codec"], row["settings"], row["label"])
    assert (chosen["gpu_bytes"], chosen["missed"]) == (int(exported.replace(",", "")), [])
    assert chosen["command"] == command
    few = ["--max-gpu-bytes", str(chosen["gpu_bytes"] - 1)]
    assert cli.main([*words, *few]) == 1
    near = json.loads(Path("choice.json").read_text())
    assert near["missed"] == ["gpu"]
    assert (near["label"], near["bytes"]) == (chosen["label"], chosen["bytes"])


@pytest.mark.long
def test_the_command_makes_the_file_that_was_measured_on_a_built_in_material(
    tmp_path, monkeypatch, capsys, brief_trade
):
    """Two rungs of a codec that starts at random numbers, so that another seed makes another file."""
    monkeypatch.chdir(tmp_path)
    data = "data = {size = 16, views = 6, lights = 6, heldout = 6, validation = true}"
    codecs = 'codecs = [{codec = "neubtf-direct", steps = 2, latents = [4, 8]}]'
    (tmp_path / "own.toml").write_text(f'materials = ["satin"]\nseeds = [1]\n{data}\n{codecs}\n')
    wish = ["--min-psnr", "0"]  # the smaller rung
    assert cli.main(["choose", "satin", *wish, "--suite", "own.toml", "--out", "r"]) == 0
    command = shlex.split(capsys.readouterr().out.splitlines()[-1])
    jobs = load_run("r").jobs
    measured = {job["settings"]["latents"]: job["score_key"]["sha256"] for job in jobs}
    assert set(measured) == {4, 8}
    assert cli.main(command[1:]) == 0
    assert read_header(tmp_path / command[-1]).sha256 == measured[4]
    place = command.index("--seed")
    first = [*command[1:place], "--seed", "0", *command[place + 2 : -1], "first.nbtf"]
    assert cli.main(first) == 0
    assert read_header(tmp_path / "first.nbtf").sha256 != measured[4]


def test_the_copy_replaces_no_measurement(tmp_path, capsys):
    (tmp_path / "cloth.npz").write_bytes(b"measured")
    assert cli.main(["choose", "satin", "--max-bytes", "1M", "-o", str(tmp_path / "cloth.npz")]) == 2
    assert "cloth.npz" in capsys.readouterr().err
    assert (tmp_path / "cloth.npz").read_bytes() == b"measured"


def test_another_file_of_the_same_name_does_not_get_the_answer_of_the_first(tmp_path, monkeypatch, capsys):
    suite = tmp_path / "own.toml"
    suite.write_text('materials = ["satin"]\ndata.validation = true\n[[codecs]]\ncodec = "pca"\n')
    choice = row("pca", 36.0, 500, 100.0, codec="pca", settings={}, device="cpu")
    monkeypatch.setattr("bench.cli.commands.choose._measured_rungs", lambda *_: (usable_rungs([choice], "m"), []))
    first, other = tmp_path / "first" / "cloth.npz", tmp_path / "other" / "cloth.npz"
    append(tmp_path, {"kind": "run", "run": "1", "materials": [{"name": "cloth.npz", "path": str(first)}]})
    failed = {"kind": "job", "job": "m/pca/0", "material": "m", "label": "pca", "codec": "pca", "seed": 0}
    append(tmp_path, failed | {"status": "failed", "error": "why"})
    words = ["--min-psnr", "30", "--suite", str(suite), "--out", str(tmp_path)]
    assert [cli.main(["choose", str(each), *words]) for each in (first, other)] == [0, 2]
    assert f"cloth.npz was measured there from {first}: give another --out" in capsys.readouterr().err


def test_the_command_that_is_printed_is_what_a_shell_runs(tmp_path, monkeypatch, capsys):
    choice = row("pca", 36.0, 500, 100.0, codec="pca", settings={"components": 4}, device="cpu")
    suite = tmp_path / "own.toml"
    suite.write_text('materials = ["satin"]\ndata.validation = true\n[[codecs]]\ncodec = "pca"\n')
    monkeypatch.setattr("bench.cli.commands.choose._measured_rungs", lambda *_: (usable_rungs([choice], "m"), []))
    append(tmp_path, {"kind": "job", "job": "m/pca/0", "material": "m", "label": "pca", "codec": "pca", "seed": 0,
                      "status": "failed", "error": "why"})  # fmt: skip
    (tmp_path / "my cloth; no; $HOME").mkdir()
    material = str(tmp_path / "my cloth; no; $HOME")
    words = ["choose", material, "--min-psnr", "30", "--suite", str(suite), "--out", str(tmp_path)]
    assert cli.main(words) == 0
    command = capsys.readouterr().out.splitlines()[-1]
    ran = subprocess.run(["bash", "-c", f'neubtf-bench() {{ printf "%s\\n" "$@"; }}; {command}'], capture_output=True)
    words = ran.stdout.decode().splitlines()
    assert words[:4] == ["encode", material, "--codec", "pca"]
    assert words[-2:] == ["-o", "my cloth; no; $HOME.nbtf"]


OWN = """
materials = ["satin"]
data = {size = 8, views = 4, lights = 4, heldout = 4, validation = true}
codecs = [{codec = "pca", components = 2}, {codec = "neubtf-direct"}, {codec = "neubtf-direct", latents = 6}]
"""


@pytest.mark.long
def test_one_codec_in_few_steps_and_two_processes(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("bench.timing.TURNS", 3)
    (tmp_path / "own.toml").write_text(OWN)
    own = ["--suite", str(tmp_path / "own.toml"), "--out", str(tmp_path / "r")]
    words = ["choose", "satin", "--max-bytes", "1M", *own]
    assert cli.main([*words, "--codec", "neubtf-direct", "--steps", "20", "--jobs", "2"]) == 0
    said = capsys.readouterr().out
    first = said.index("2 of 2")
    estimate = said.index("2 of 2 jobs to do")
    assert first < estimate < said.index("satin/neubtf-direct ")
    assert "on a GPU: " in said
    command = said.splitlines()[-1]
    assert command.startswith("neubtf-bench encode satin --codec neubtf-direct ")
    assert " --set steps=20 " in command
    demand_of(camera(16, 12, 30, [0, -0.8, 1.4]) + surface(size=[1, 1]) + SUN).save(tmp_path / "scene.npz")
    in_scene = [*words, "--codec", "neubtf-direct", "--steps", "20", "--scene", str(tmp_path / "scene.npz")]
    assert cli.main(in_scene) == 0
    said = capsys.readouterr().out
    assert "0 to fit" in said  # the same files are scored again
    frames = {job["label"]: job["scene"]["metrics"]["psnr_display"] for job in load_run(tmp_path / "r").jobs}
    best = max(frames, key=lambda label: frames[label])
    assert re.search(rf"^satin: {best}[: \[].*{frames[best]:.2f} dB.*frames", said, re.M)
    few = ["choose", "satin", "--max-bytes", "10", *own, "--codec", "neubtf-direct", "--steps", "20"]
    assert cli.main(few) == 1
    assert "misses --max-bytes" in capsys.readouterr().out


def test_with_a_scene_the_best_of_the_other_codecs_is_shown_too(tmp_path, monkeypatch, capsys):
    (tmp_path / "own.toml").write_text(OWN)
    demand_of(camera(16, 12, 30, [0, -0.8, 1.4]) + surface(size=[1, 1]) + SUN).save(tmp_path / "scene.npz")
    fingerprint = load_demand(tmp_path / "scene.npz").fingerprint
    jobs, choices = {}, []
    for codec, size, psnr in (("pca", 500, 30.0), ("neubtf-direct", 50, 20.0)):
        of = f"satin/{codec}/0"
        jobs[of] = {"score_key": {"demand": fingerprint}, "scene": {"metrics": {"psnr_display": psnr}}}
        choices.append(row(codec, psnr, size, 100.0, material="satin", codec=codec, of=of, device="cpu", settings={}))
    run = Mock(choices=choices, job=jobs.get, starts=[])
    for name in ("load_run", "run_so_far"):
        monkeypatch.setattr(f"bench.cli.commands.choose.{name}", lambda _: run)
    monkeypatch.setattr("bench.cli.commands.choose._measure", lambda *_: None)
    words = ["choose", "satin", "--suite", str(tmp_path / "own.toml"), "--out", str(tmp_path / "r")]
    words += ["--scene", str(tmp_path / "scene.npz"), "--codec", "neubtf-direct", "--min-psnr", "25"]
    assert cli.main(words) == 1
    assert "without --codec: pca" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--codec", "pca", "--steps", "20"], "--steps 20: "),
        (["--steps", "-1"], "--steps -1: "),
        (["--jobs", "-1"], "--jobs -1: "),
        (["--max-ns", "0"], "--max-ns 0: "),
        (["--min-psnr", "nan"], "--min-psnr nan: "),
        (["--min-psnr", "inf"], "--min-psnr inf: "),
        (["--scene", "table-top.npz", "--bsdf", "sofa"], "--bsdf: only for a Mitsuba scene"),
    ],
)
def test_options_that_make_no_sense_are_bad_usage(words, message, tmp_path, capsys):
    (tmp_path / "own.toml").write_text(OWN)
    own = ["--suite", str(tmp_path / "own.toml"), "--out", str(tmp_path / "r")]
    assert cli.main(["choose", "satin", "--max-bytes", "1M", *own, *words]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "r" / "records.jsonl").exists()
