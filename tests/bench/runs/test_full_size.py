"""Small files in the formats of UBO2014 and UBO2003 go through a suite, as whole measurements do."""

import json

import fullsize
import numpy as np
import pytest

from bench import cli
from bench.data.materials import load
from bench.data.readers import open_btf
from bench.metrics.display import exposure, to_display
from bench.records import load_run


@pytest.fixture
def generated(request, tmp_path):
    """A file of 20² texels, and the tile of 12² that it repeats."""
    tile = load("satin", 12, directions=request.param, views=6, lights=5, heldout=0)
    path = tmp_path / f"{request.param}.bin"
    if request.param == "ubo2014":
        fullsize.write_btf(path, tile, 20, 32)
    else:
        fullsize.write_zip(path, tile, 20)
    return path, tile


@pytest.mark.parametrize("generated", ["ubo2014", "ubo2003"], indirect=True)
def test_a_generated_file_repeats_a_material_under_a_pattern(generated):
    path, tile = generated
    btf = open_btf(path)
    assert (len(btf), btf.shape) == (30, (20, 20))
    bright = exposure(tile) if path.stem == "ubo2003" else 1.0  # a photograph is exposed
    places = np.arange(20) % 12
    order = [
        int(np.argmin(np.abs(tile.wo - wo).sum(1) + np.abs(tile.wi - wi).sum(1)))
        for wo, wi in zip(btf.wo, btf.wi, strict=True)
    ]
    truth = np.stack([tile[i][np.ix_(places, places)] for i in order]) * fullsize.pattern(20)[..., None] * bright
    apart = to_display(np.stack(list(btf)), 0.8 / bright) - to_display(truth, 0.8 / bright)
    # A JPEG of quality 92, or factors of rank 30, leave an error of a few of 255 codes.
    assert np.square(apart).mean() ** 0.5 < 0.03


@pytest.mark.parametrize("generated", ["ubo2014", "ubo2003"], indirect=True)
def test_a_generated_file_goes_through_a_suite(generated, tmp_path, monkeypatch, capsys):
    path, _ = generated
    out = tmp_path / "run"
    words = ["--codec", "mean-colour", "--set", "data.scored=3", "--out", str(out)]
    assert cli.main(["run", "budgets", "--material", str(path), *words]) == 0, capsys.readouterr().err
    job = load_run(out).jobs[0]
    assert job["provenance"]["format"] == ("UBO2014" if path.stem == "ubo2014" else "UBO2003")
    assert job["scores"]["heldout"]["slices"] == 3 < job["pairs"]["heldout"]
    assert json.dumps(job["scores"]).count("NaN") == 0
