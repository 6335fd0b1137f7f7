import subprocess

import pytest

from bench import cli
from bench.cli.commands.choose import parse_bytes
from bench.compare.choosing import Limits, chosen, nearest, usable
from bench.inputs.errors import InputError
from bench.records import append


def row(name, psnr, size, ns, **more):
    stats = {"pooled": psnr, "mean": psnr, "slices": 9}
    choice = {"label": name, "psnr": 0.0, "validation": stats, "bytes": size, "ns_per_sample": ns, "material": "m"}
    return choice | {"execution": "eager", "precision": "float32"} | more


ROWS = [row("exact", 100.0, 9000, 300.0), row("good", 36.0, 500, 100.0), row("fast", 33.0, 800, 20.0)]
RUNGS = usable(ROWS, "m")


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
    assert chosen(RUNGS, wishes).of["label"] == name


def test_a_wish_that_none_meets_has_a_nearest():
    wishes = Limits(score=37, time=90)
    assert chosen(RUNGS, wishes) is None
    assert nearest(RUNGS, wishes).of["label"] == "good"


def test_rows_of_other_materials_failed_ones_those_without_validation_and_the_floor_are_no_choices():
    floor = {"material": "m", "label": "floor", "ns_per_sample": 1.0}
    others = [row("other", 1.0, 1, 1.0, material="n"), row("failed", 1.0, 1, 1.0, error="why"), floor]
    unseen = row("unseen", 99.0, 1, 1.0)
    del unseen["validation"]
    assert [rung.of for rung in usable([*ROWS, *others, unseen], "m")] == ROWS


def test_a_suite_without_validation_pairs_is_refused(tmp_path, capsys):
    suite = tmp_path / "own.toml"
    suite.write_text('materials = ["satin"]\n[[codecs]]\ncodec = "pca"\n')
    assert cli.main(["choose", "satin", "--min-psnr", "30", "--suite", str(suite)]) == 2
    assert "add `validation = true`" in capsys.readouterr().err


def test_sizes_are_written_with_k_and_m():
    assert [parse_bytes(text) for text in ("300k", "1.5M", "20000", "300kB")] == [300_000, 1_500_000, 20_000, 300_000]
    with pytest.raises(InputError, match="write a number"):
        parse_bytes("much")


def test_the_command_that_is_printed_is_what_a_shell_runs(tmp_path, monkeypatch, capsys):
    choice = row("pca", 36.0, 500, 100.0, codec="pca", settings={"components": 4}, device="cpu")
    suite = tmp_path / "own.toml"
    suite.write_text('materials = ["satin"]\ndata.validation = true\n[[codecs]]\ncodec = "pca"\n')
    monkeypatch.setattr("bench.cli.commands.choose._measured", lambda *_: (usable([choice], "m"), []))
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
    first = said.index("2 of 2 settings of own are not in")
    estimate = said.index("2 jobs: 2 left\n")
    assert first < estimate < said.index("satin/neubtf-direct ")
    assert "on a GPU: " in said
    command = said.splitlines()[-1]
    assert command.startswith("neubtf-bench encode satin --codec neubtf-direct ")
    assert " --set steps=20 " in command


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--codec", "pca", "--steps", "20"], "--steps 20: "),
        (["--steps", "-1"], "--steps -1: "),
        (["--jobs", "-1"], "--jobs -1: must be at least 1"),
    ],
)
def test_options_that_make_no_sense_are_bad_usage(words, message, tmp_path, capsys):
    (tmp_path / "own.toml").write_text(OWN)
    own = ["--suite", str(tmp_path / "own.toml"), "--out", str(tmp_path / "r")]
    assert cli.main(["choose", "satin", "--max-bytes", "1M", *own, *words]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "r" / "trade.json").exists()
