"""Commands on a disk without room: one line that names the file, exit code 2, and nothing half done left behind."""

import errno
import json
import os
import subprocess
import sys
from unittest.mock import Mock

import pytest

from bench import cli
from bench.conformance.check import tiny_btf
from bench.data.readers.folder import write_folder
from bench.files import atomic
from bench.runs import job

# Files of more than 300 bytes are refused to a process with this limit, as on a full disk.
LIMITED = """
import json, resource, sys
resource.setrlimit(resource.RLIMIT_FSIZE, (300, 300))
from bench import cli
for words in json.loads(sys.argv[1]):
    print(cli.main(words), flush=True)
"""
SMALL = [part for key in ("size=12", "views=6", "lights=6", "heldout=4") for part in ("--set", f"data.{key}")]


@pytest.fixture(autouse=True)
def places(tmp_path, monkeypatch, brief):
    monkeypatch.chdir(tmp_path)
    write_folder(tiny_btf(12, 6, 6), tmp_path / "btf")


@pytest.mark.long
def test_each_command_says_one_line_and_leaves_nothing(tmp_path):
    assert cli.main(["encode", "btf", "--codec", "mean-colour", "-o", "a.nbtf"]) == 0
    assert cli.main(["run", "quick", "--material", "btf", "--codec", "mean-colour", "--out", "run"]) == 0
    commands = {
        "b.nbtf": ["encode", "btf", "--codec", "mean-colour", "-o", "b.nbtf"],
        "slices": ["decode", "a.nbtf", "--like", "btf", "-o", "slices"],
        "demand-table-top.npz": ["encode", "btf", "--codec", "mean-colour", "--scene", "table-top", "-o", "d.nbtf"],
        "a.json": ["score", "a.nbtf", "btf", "--json", "a.json"],
        "run/tables": ["report", "run"],
        "cache/materials/satin": ["encode", "satin", "--codec", "mean-colour", "-o", "c.nbtf", *SMALL],
    }
    command = [sys.executable, "-c", LIMITED, json.dumps(list(commands.values()))]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert [line for line in done.stdout.splitlines() if line.isdigit()] == ["2"] * len(commands), done.stderr
    said = [line for line in done.stderr.splitlines() if line.startswith("neubtf-bench: ")]
    assert "Traceback" not in done.stderr
    assert len(said) == len(commands)
    for name, line in zip(commands, said, strict=True):
        assert name in line
        assert "(File too large)" in line
    assert not [*tmp_path.rglob("*.partial*"), *tmp_path.rglob("*.part")]
    assert not any((tmp_path / name).exists() for name in ("b.nbtf", "slices", "demand-table-top.npz", "a.json"))


@pytest.mark.long
def test_a_full_cache_is_no_failure_of_a_job_and_the_same_command_goes_on(tmp_path, monkeypatch, capsys):
    full = Mock(side_effect=OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))
    place = str(tmp_path / "cache" / "scratch" / "a.npy")
    denied = Mock(side_effect=PermissionError(errno.EACCES, os.strerror(errno.EACCES), place))
    words = ["run", "quick", "--material", "satin", "--codec", "mean-colour", "--out", "run", *SMALL]
    with monkeypatch.context() as without_room:
        without_room.setattr(atomic, "mapped", full)
        assert cli.main(words) == 2
    said = capsys.readouterr().err
    assert f"{tmp_path / 'cache' / 'materials' / 'satin'}" in said
    assert said.count("\n") == 1
    with monkeypatch.context() as closed:
        closed.setattr(job, "open_workbench", denied)
        assert cli.main(words) == 2
    said = capsys.readouterr().err
    assert "a.npy: " in said
    assert "permissions" in said
    assert cli.main(words) == 0
