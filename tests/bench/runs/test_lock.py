import errno
import fcntl
import json
import os
import platform
import re
import subprocess
import sys
import time

import pytest

from bench.inputs.errors import InputError
from bench.runs import lock
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


def signed(folder, host, process, seconds_ago=0.0):
    (folder / FILE).write_text(json.dumps({"process": process, "host": host, "since": "noon", "run": "theirs"}))
    then = time.time() - seconds_ago
    os.utime(folder / FILE, (then, then))


def no_process():
    done = subprocess.Popen([sys.executable, "-c", ""])
    done.wait()
    return done.pid


def test_a_live_run_is_named_and_keeps_its_folder(tmp_path, holder):
    with pytest.raises(InputError, match=f"{holder.pid} on {platform.node()}.*--out"):
        locked(tmp_path, "ours").__enter__()
    assert not can_use_folder(tmp_path, "ours")
    assert can_use_folder(tmp_path, "theirs")


def test_the_lock_of_a_killed_run_is_taken_over_and_said(tmp_path, holder, caplog):
    holder.kill()
    holder.wait()
    assert (tmp_path / FILE).exists()
    with locked(tmp_path, "ours"):
        assert can_use_folder(tmp_path, "ours")
    assert re.search(f"{holder.pid} on {platform.node()}.*taken over", caplog.text)
    assert list(tmp_path.iterdir()) == []


def test_a_lock_of_another_host_stands_while_it_is_renewed(tmp_path, caplog):
    signed(tmp_path, "elsewhere", 1, seconds_ago=20)
    with pytest.raises(InputError, match="1 on elsewhere"):
        locked(tmp_path, "ours").__enter__()
    signed(tmp_path, "elsewhere", 1, seconds_ago=120)
    with locked(tmp_path, "ours"):
        assert "1 on elsewhere" in caplog.text


def test_a_held_lock_is_renewed(tmp_path, monkeypatch):
    monkeypatch.setattr(lock, "RENEWED_EVERY", 0.01)
    with locked(tmp_path, "ours"):
        os.utime(tmp_path / FILE, (0, 0))
        deadline = time.monotonic() + 30
        while (tmp_path / FILE).stat().st_mtime == 0 and time.monotonic() < deadline:
            time.sleep(0.01)
        assert (tmp_path / FILE).stat().st_mtime > 0


def test_a_lock_that_another_host_took_over_is_left_to_it(tmp_path):
    """As after a minute of suspension, on a file system that carries no locks."""
    with locked(tmp_path, "ours"):
        signed(tmp_path, "elsewhere", 1)
    assert can_use_folder(tmp_path, "theirs")


def test_where_the_file_system_cannot_lock_the_process_is_looked_for(tmp_path, monkeypatch, caplog):
    def flock(file, how):
        raise OSError(errno.ENOLCK, "no locks available")

    monkeypatch.setattr(fcntl, "flock", flock)
    signed(tmp_path, platform.node(), os.getppid())
    with pytest.raises(InputError, match=f"process {os.getppid()} "):
        locked(tmp_path, "ours").__enter__()
    signed(tmp_path, platform.node(), no_process())
    with locked(tmp_path, "ours"):
        assert "taken over" in caplog.text


@pytest.mark.parametrize("text", ["", "{", "[]", '{"process": 1}'])
def test_a_lock_that_nobody_signed_holds_nobody_up(tmp_path, text):
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
