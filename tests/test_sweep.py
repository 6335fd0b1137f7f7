"""The script that chooses settings: `tools/sweep.py`."""

import json
from pathlib import Path

import pytest
import sweep

from bench.codecs.registry import make_codec
from bench.inputs.errors import InputError

SMALL = ["--codecs", "bcf", "--surfaces", "satin", "--size", "8", "--steps", "3"]


@pytest.mark.parametrize("codec", sweep.OWN)
def test_every_codec_gets_as_many_trials_each_another_one(codec: str) -> None:
    changes = sweep.trials(codec)
    assert len(changes) == 13
    assert changes[0] == {}
    base = sweep.BASE.get(codec, {})
    settings = [make_codec(codec, base | change).settings for change in changes]  # an unknown setting is an error
    assert len(set(settings)) == len(changes)


def test_surfaces_that_are_kept_apart_choose_nothing(tmp_path: Path) -> None:
    for surface in ("leather", "ubo2003_local_pca/impalla"):
        with pytest.raises(InputError, match="kept apart"):
            sweep.main([str(tmp_path / "a.jsonl"), "--surfaces", surface])


@pytest.mark.long
def test_trials_are_made_once_and_compared(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.setattr(sweep, "trials", lambda codec: [{}, {"weights": "int8"}])
    out = tmp_path / "a.jsonl"
    sweep.main([str(out), *SMALL])
    first = out.read_text()
    rows = [json.loads(line) for line in first.splitlines()]
    assert [row["change"] for row in rows] == [{}, {"weights": "int8"}]
    assert all(0 < row["psnr"] <= 48.14 for row in rows)
    assert rows[1]["bytes"] < rows[0]["bytes"]
    assert len(capsys.readouterr().out.splitlines()) == 2
    out.write_text(first[: len(first) - 20])  # killed within the second line
    sweep.main([str(out), *SMALL])
    assert out.read_text() == first
    assert len(capsys.readouterr().out.splitlines()) == 1
    sweep.main([str(out), "--table"])
    shown = capsys.readouterr().out.splitlines()
    version = rows[0]["version"]
    assert shown[2] == f"| 8², 3 steps | bcf {version} | default | +0.00 | × 1.00 | 1 |"
    gain, ratio = rows[1]["psnr"] - rows[0]["psnr"], rows[1]["bytes"] / rows[0]["bytes"]
    assert shown[3] == f"| 8², 3 steps | bcf {version} | weights=int8 | {gain:+.2f} | × {ratio:.2f} | 1 |"
