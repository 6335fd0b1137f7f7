import os

import pytest
from PIL import Image

from bench import cli

COMMANDS = ["info {}", "encode {} --codec mean-colour -o out.nbtf", "decode {} -o o", "results verify {}", "run {}"]
FILES = ["a.nbtf", "a.btf", "a.npz", "a.lp", "a.zip", "normal.png", "roughness.exr", "displacement.hdr", "a.toml"]


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("command", COMMANDS)
def test_no_command_waits_for_a_pipe(name, command, tmp_path, capsys):
    os.mkfifo(tmp_path / name)
    map_of_folder = name.startswith(("normal", "roughness", "displacement"))
    if {"results": name == "a.zip", "run": name == "a.toml", "decode": not map_of_folder}.get(command.split()[0], True):
        Image.new("RGB", (8, 8), (90, 90, 90)).save(tmp_path / "albedo.png")
        assert cli.main(command.format(tmp_path if map_of_folder else tmp_path / name).split()) == 2
        assert f"{tmp_path / name}: " in capsys.readouterr().err
