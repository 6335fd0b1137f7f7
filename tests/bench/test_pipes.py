"""A named pipe where a file is due is refused; no reader waits for what never comes."""

import os

import pytest
from PIL import Image

from bench import cli


@pytest.fixture
def pipe(tmp_path):
    """A named pipe. A process that opens one for reading waits until another writes into it."""

    def made(name):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        os.mkfifo(tmp_path / name)
        return tmp_path / name

    return made


@pytest.mark.parametrize("name", ["a.nbtf", "a.btf", "a.npz", "a.lp", "a.zip"])
@pytest.mark.parametrize(
    "command", ["info {path}", "encode {path} --codec mean-colour -o out.nbtf", "decode {path} -o o"]
)
def test_no_command_waits_for_a_pipe(name, command, pipe, capsys):
    path = pipe(name)
    assert cli.main(command.format(path=path).split()) == 2
    assert f"{path}: it is neither a file nor a folder" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["verify {path}", "run {path}"])
def test_archives_and_suites_are_files(command, pipe, capsys):
    path = pipe("a.toml" if command.startswith("run") else "a.zip")
    assert cli.main(command.format(path=path).split()) == 2
    assert f"{path}: it is neither a file nor a folder" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["normal.png", "roughness.exr", "displacement.hdr"])
def test_a_pipe_among_maps_is_refused(name, pipe, tmp_path, capsys):
    pipe(f"maps/{name}")
    Image.new("RGB", (8, 8), (90, 90, 90)).save(tmp_path / "maps" / "albedo.png")
    for command in ("info {}", "encode {} --codec mean-colour -o out.nbtf"):
        assert cli.main(command.format(tmp_path / "maps").split()) == 2
        assert f"{tmp_path / 'maps' / name}: it is neither a file nor a folder" in capsys.readouterr().err
