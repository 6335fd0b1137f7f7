import subprocess

import pytest

from bench import cli
from bench.errors import InputError
from bench.runs.choose import Wishes, choose, nearest, parse_bytes, usable


def row(name, psnr, size, ns, **more):
    return {"label": name, "psnr": psnr, "bytes": size, "ns_per_sample": ns, "material": "m"} | more


ROWS = [row("exact", None, 9000, 300.0), row("good", 36.0, 500, 100.0), row("fast", 33.0, 800, 20.0)]


@pytest.mark.parametrize(
    ("wishes", "name"),
    [
        (Wishes(min_psnr=30), "good"),
        (Wishes(min_psnr=40), "exact"),
        (Wishes(max_bytes=1000), "good"),
        (Wishes(max_ns=50), "fast"),
        (Wishes(max_bytes=10_000, max_ns=1000), "exact"),
        (Wishes(min_psnr=30, max_ns=50), "fast"),
    ],
)
def test_the_smallest_that_is_good_enough_or_the_best_that_is_cheap_enough(wishes, name):
    assert choose(ROWS, wishes)["label"] == name


def test_a_wish_that_none_meets_has_a_nearest():
    wishes = Wishes(min_psnr=37, max_ns=90)
    assert choose(ROWS, wishes) is None
    assert nearest(ROWS, wishes)["label"] == "good"


def test_rows_of_other_materials_failed_ones_and_the_floor_are_no_choices():
    floor = {"material": "m", "label": "floor", "ns_per_sample": 1.0}
    others = [row("other", 1.0, 1, 1.0, material="n"), row("failed", 1.0, 1, 1.0, error="why"), floor]
    assert usable([*ROWS, *others], "m") == ROWS


def test_sizes_are_written_with_k_and_m():
    assert [parse_bytes(text) for text in ("300k", "1.5M", "20000", "300kB")] == [300_000, 1_500_000, 20_000, 300_000]
    with pytest.raises(InputError, match="write a number"):
        parse_bytes("much")


def test_the_command_that_is_printed_is_what_a_shell_runs(tmp_path, monkeypatch, capsys):
    choice = row("pca", 36.0, 500, 100.0, codec="pca", settings={"components": 4}, device="cpu")
    choice |= {"execution": "eager", "precision": "float32"}
    suite = tmp_path / "own.toml"
    suite.write_text('materials = ["satin"]\n[[codecs]]\ncodec = "pca"\n')
    monkeypatch.setattr("bench.cli.commands.choose._measured", lambda *_: ([choice], []))
    (tmp_path / "my cloth; no; $HOME").mkdir()
    material = str(tmp_path / "my cloth; no; $HOME")
    assert cli.main(["choose", material, "--min-psnr", "30", "--suite", str(suite)]) == 0
    command = capsys.readouterr().out.splitlines()[-1]
    ran = subprocess.run(["bash", "-c", f'neubtf-bench() {{ printf "%s\\n" "$@"; }}; {command}'], capture_output=True)
    words = ran.stdout.decode().splitlines()
    assert words[:4] == ["encode", material, "--codec", "pca"]
    assert words[-2:] == ["-o", "my cloth; no; $HOME.nbtf"]
