import subprocess

import pytest

from bench import cli
from bench.errors import InputError
from bench.records.choosing import Limits, chosen, nearest
from bench.runs.choose import parse_bytes, usable


def row(name, psnr, size, ns, **more):
    stats = {"pooled": psnr, "mean": psnr, "largest": 0.01, "slices": 9}
    choice = {"label": name, "psnr": 0.0, "validation": stats, "bytes": size, "ns_per_sample": ns, "material": "m"}
    return choice | {"execution": "eager", "precision": "float32"} | more


ROWS = [row("exact", None, 9000, 300.0), row("good", 36.0, 500, 100.0), row("fast", 33.0, 800, 20.0)]
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
    (tmp_path / "my cloth; no; $HOME").mkdir()
    material = str(tmp_path / "my cloth; no; $HOME")
    assert cli.main(["choose", material, "--min-psnr", "30", "--suite", str(suite)]) == 0
    command = capsys.readouterr().out.splitlines()[-1]
    ran = subprocess.run(["bash", "-c", f'neubtf-bench() {{ printf "%s\\n" "$@"; }}; {command}'], capture_output=True)
    words = ran.stdout.decode().splitlines()
    assert words[:4] == ["encode", material, "--codec", "pca"]
    assert words[-2:] == ["-o", "my cloth; no; $HOME.nbtf"]
