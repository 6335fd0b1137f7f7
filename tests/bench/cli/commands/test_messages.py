from pathlib import Path

import pytest

from bench import cli
from bench.codec import Fit
from bench.codecs import container
from bench.codecs.registry import load_codec
from bench.conformance.check import tiny_btf
from bench.errors import InputError


def test_export_names_the_file_that_no_shader_can_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refused(*_: object) -> None:
        raise InputError("no shader can do 'cumsum' yet")

    codec = load_codec("mean-colour")()
    path = container.save(tmp_path / "mine.nbtf", codec, codec.encode(tiny_btf(), Fit())).path
    monkeypatch.setattr("reports.shaders.export.shader", refused)
    assert cli.main(["export", str(path), "-o", str(tmp_path / "out")]) == 2
    assert f"{path}: no shader can do 'cumsum' yet" in capsys.readouterr().err
