from pathlib import Path

import numpy as np
import pytest
from ubo2014_write import factorise

from bench import cli
from bench.btf import BTF, ArraySource
from bench.directions.hemisphere import ubo2014
from bench.records import load_run

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
def test_it_runs_on_a_file_that_is_there_and_says_what_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("NEUBTF_DATA", str(tmp_path))
    assert len(fabric(tmp_path / FILE)) == 151 * 151
    monkeypatch.setattr("bench.timing.TURNS", 3)
    words = ["run", "paper", "--out", str(tmp_path / "run"), "--codec", "neubtf", "--codec", "pca"]
    assert cli.main([*words, *(word for change in FEW for word in ("--set", change))]) == 0, capsys.readouterr()
    status = {job["material"]: job["status"] for job in load_run(tmp_path / "run").jobs}
    assert (status["fabric01"], status["fabric03"], status["ceramic"]) == ("ok", "unavailable", "unavailable")
