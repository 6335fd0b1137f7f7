import errno
import fcntl
import os
import platform
import subprocess
import sys

import pytest

from bench.inputs.errors import InputError
from bench.runs.lock import FILE, can_use_folder, locked

HOLD = """
import sys, time
from pathlib import Path
from bench.runs.lock import locked
with locked(Path(sys.argv[1]), "theirs"):
    print("held", flush=True)
    time.sleep(600)
"""


@pytest.fixture
def holder(tmp_path):
    process = subprocess.Popen([sys.executable, "-c", HOLD, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.communicate()


def test_a_live_run_is_named_and_keeps_its_folder(tmp_path, holder):
    with pytest.raises(InputError, match=f"{holder.pid} on {platform.node()}.*--out"):
        locked(tmp_path, "ours").__enter__()
    assert not can_use_folder(tmp_path, "ours")
    assert can_use_folder(tmp_path, "theirs")


def test_the_lock_of_a_killed_run_is_free(tmp_path, holder):
    holder.kill()
    holder.wait()
    assert (tmp_path / FILE).exists()
    with locked(tmp_path, "ours"):
        assert can_use_folder(tmp_path, "ours")
    assert list(tmp_path.iterdir()) == []


def test_where_the_file_system_cannot_lock_a_warning_says_so_once(tmp_path, monkeypatch, caplog):
    def flock(file, how):
        raise OSError(errno.ENOLCK, "no locks available")

    monkeypatch.setattr(fcntl, "flock", flock)
    for _ in range(2):
        with locked(tmp_path, "ours"):
            assert can_use_folder(tmp_path, "ours")
    assert caplog.text.count("no locks: let only one") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("text", ["", "{", "[]", '{"process": 1}'])
def test_a_file_that_nobody_locks_holds_nobody_up(tmp_path, text):
    (tmp_path / FILE).write_text(text)
    with locked(tmp_path, "ours"):
        assert can_use_folder(tmp_path, "ours")


def test_a_lock_removed_between_opening_and_locking_is_made_anew(tmp_path, monkeypatch):
    flock = fcntl.flock

    def removed_first(file, how):
        (tmp_path / FILE).unlink()
        monkeypatch.setattr(fcntl, "flock", flock)
        flock(file, how)

    monkeypatch.setattr(fcntl, "flock", removed_first)
    with locked(tmp_path, "ours"):
        assert can_use_folder(tmp_path, "ours")


def test_a_folder_that_cannot_be_written_is_named(tmp_path, monkeypatch):
    with locked(tmp_path, "ours"):
        monkeypatch.setattr(os, "access", lambda path, how: False)
        assert not can_use_folder(tmp_path, "ours")

    def read_only(path, *_):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(path))

    monkeypatch.setattr(os, "open", read_only)
    with pytest.raises(InputError, match=r"Read-only.*--out"):
        locked(tmp_path, "ours").__enter__()
