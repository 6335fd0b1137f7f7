"""The suite `paper` on a file in the format of UBO2014, of all its directions and a small picture."""

from pathlib import Path

import numpy as np
import pytest
from ubo2014_write import factorise

from bench import cli
from bench.btf import BTF, ArraySource
from bench.hemisphere import ubo2014

FILE = "UBO2014/fabric01_resampled_W400xH400_L151xV151.btf"
FEW = ["data.pairs=64", "neubtf.steps=4", "neubtf.batch=64"]


def fabric(path: Path) -> BTF:
    """A glossy weave of 8 × 8 texels, seen and lit from 151 directions each."""
    side = ubo2014()
    wo, wi = np.repeat(side, len(side), 0), np.tile(side, (len(side), 1))
    half = (wo + wi) / np.linalg.norm(wo + wi, axis=1, keepdims=True)
    rng = np.random.default_rng(0)
    albedo, gloss = rng.uniform(0.1, 0.8, (8, 8, 3)), rng.uniform(0.1, 0.5, (8, 8, 1))
    shine = wi[:, 2] * np.maximum(half[:, 2], 0) ** 20
    values = wi[:, 2, None, None, None] * albedo / np.pi + shine[:, None, None, None] * gloss
    path.parent.mkdir()
    btf = BTF("fabric01", wo, wi, ArraySource(values.astype(np.float32)))
    factorise(btf, path, rank=8)
    return btf


@pytest.mark.long
def test_its_tables_are_made_of_a_file_that_is_there_and_say_what_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("NEUBTF_DATA", str(tmp_path))
    assert len(fabric(tmp_path / FILE)) == 151 * 151
    out = tmp_path / "run"
    monkeypatch.setattr("bench.timing.TURNS", 3)
    words = ["run", "paper", "--out", str(out), "--codec", "neubtf", "--codec", "pca"]
    code = cli.main([*words, *(word for change in FEW for word in ("--set", change))])
    assert code == 0, capsys.readouterr()
    capsys.readouterr()
    assert cli.main(["table", "paper", str(out), "--format", "markdown"]) == 0
    table = capsys.readouterr().out
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines() if line[:2] == "| "]
    cells_of = {tuple(row[:2]): row[3:] for row in rows if row[2] == "all"}
    ours = next(
        cells for (material, codec), cells in cells_of.items() if "recipe=paper" in codec and material == "fabric01"
    )
    assert "±" in ours[0]
    assert ours[1::2] == ["26.58 ± 1.820", "0.710 ± 0.108", "0.391 ± 0.047"]
    assert {material for material, _ in cells_of} >= {"fabric01", "fabric03", "ceramic", "embroidery"}
    assert all(cells[0] == "none yet" for (material, _), cells in cells_of.items() if material == "ceramic")
