import base64
import json
import re
import zlib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from torch import Tensor

import bench
from bench import cli
from bench.cli.commands.view import _drawn
from bench.codec import silent
from bench.conformance.check import tiny_btf
from bench.data.readers.folder import write_folder
from bench.directions.hemisphere import thin, ubo2003
from bench.inputs.errors import InputError
from bench.material import DecoderCost, Material
from bench.metrics import stats_of
from bench.records import PSNR
from reports.shaders.dialects import GLSL
from reports.shaders.generator import shader
from tests.reports.shaders.reader import answer


class Sorting(Material):
    """A sum over channels that grows from left to right, times the cosine of the light: `cumsum` is in no shader."""

    def __init__(self) -> None:
        super().__init__((4, 4), DecoderCost())
        self.texture = torch.linspace(0.1, 0.9, 16).reshape(4, 4)

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        texel = self.texture[((1 - uv[:, 1]) * 4).long().clamp(0, 3), (uv[:, 0] * 4).long().clamp(0, 3)]
        return texel[:, None].expand(-1, 3).cumsum(1) * wi[:, 2:]


def test_a_material_without_a_shader_is_baked_and_said_to_be() -> None:
    material = Sorting()
    file = SimpleNamespace(material=material, header=SimpleNamespace(path=Path("mine.nbtf")))
    program, exposure, note, of_slices = _drawn(file, silent)
    assert of_slices
    assert re.search("mine.*13.*'cumsum'", note)
    assert exposure > 0
    directions = ubo2003()
    wo, wi = directions[thin(directions, 13)][[3, 7]].astype(np.float32)
    uv = np.array([0.375, 0.625], np.float32)  # a texel's centre
    truth = material.query(uv[None], wo[None], wi[None])[0]
    np.testing.assert_allclose(answer(shader(program, GLSL), uv, wo, wi, 0.25), truth, rtol=2e-3)


@pytest.mark.long
def test_the_page_is_headed_by_a_name_and_no_path_and_export_names_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_folder(tiny_btf(8, 6, 6), tmp_path / "cloth")
    words = [str(tmp_path / "cloth"), "--codec", "mean-colour", "-o", str(tmp_path / "a.nbtf")]
    assert cli.main(["encode", *words]) == 0
    page = tmp_path / "a.html"
    assert cli.main(["view", str(tmp_path / "a.nbtf"), "--truth", str(tmp_path / "cloth"), "-o", str(page)]) == 0
    (heading,) = re.findall("<h1>(.*)</h1>", page.read_text())
    assert "/" not in heading
    assert heading
    packed = re.findall('id="models">(.*?)</script>', page.read_text(), re.S)[0]
    text = zlib.decompress(base64.b64decode(packed))
    models = json.loads(text[4 : 4 + int.from_bytes(text[:4], "little")])["models"]
    scores = bench.score(tmp_path / "a.nbtf", bench.open(str(tmp_path / "cloth")))
    assert models[1]["label"].endswith(f", {stats_of(scores, PSNR)['mean']:.2f} dB at held-out pairs")

    def refused(*_: object) -> None:
        raise InputError("cumsum")

    monkeypatch.setattr("reports.shaders.export.shader", refused)
    assert cli.main(["export", str(tmp_path / "a.nbtf"), "-o", str(tmp_path / "out")]) == 2
    assert f"{tmp_path / 'a.nbtf'}: cumsum" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["view", "render"])
def test_a_truth_of_other_texels_is_refused_with_the_size_that_fits(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A folder of maps is rendered at its default size, whatever size a file was fitted at."""
    write_folder(tiny_btf(8, 6, 6), tmp_path / "cloth")
    write_folder(tiny_btf(12, 6, 6), tmp_path / "larger")
    file = str(tmp_path / "a.nbtf")
    assert cli.main(["encode", str(tmp_path / "cloth"), "--codec", "mean-colour", "-o", file]) == 0
    out = tmp_path / ("a.html" if command == "view" else "a.png")
    capsys.readouterr()
    assert cli.main([command, file, "--truth", str(tmp_path / "larger"), "-o", str(out)]) == 2
    said = capsys.readouterr().err
    assert re.search(r"a\.nbtf: .*\b8\b.*\b12\b", said)
    assert "--set data.size=8" in said
    assert not out.exists()
