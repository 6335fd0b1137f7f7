import ast
import errno
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from bench.files import atomic
from bench.files.atomic import cache_dir, clear_cache
from bench.inputs.errors import InputError
from tests.bench.test_rooms import FILES, name_of, tree


def test_a_file_is_there_whole_or_not_at_all(tmp_path):
    path = tmp_path / "made" / "file"
    atomic.write(path, b"first")

    with suppress(ZeroDivisionError), atomic.replacing(path) as partial:
        partial.write_bytes(b"sec")
        raise ZeroDivisionError
    assert path.read_bytes() == b"first"
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("wanted", ["notes.txt", "notes.txt/a", "notes.txt/a/b"])
def test_a_file_in_the_way_of_a_folder_is_an_error_that_names_it(wanted, tmp_path):
    (tmp_path / "notes.txt").write_text("text")
    with pytest.raises(InputError, match=r"notes\.txt: "):
        atomic.make_folder(tmp_path / wanted)
    with pytest.raises(InputError, match=r"notes\.txt: "):
        atomic.write(tmp_path / wanted / "c", b"")
    assert (tmp_path / "notes.txt").read_text() == "text"
    atomic.make_folder(tmp_path / "a" / "b")
    atomic.make_folder(tmp_path / "a" / "b")
    assert (tmp_path / "a" / "b").is_dir()


@pytest.mark.long
def test_folders_are_made_in_one_way():
    others = []
    for path in FILES:
        calls = {node.attr for node in ast.walk(tree(path)) if isinstance(node, ast.Attribute)}
        if calls & {"mkdir", "makedirs"}:
            others.append(name_of(path))
    assert others == ["bench.files.atomic"]


def test_a_file_takes_no_place_of_a_pipe_or_a_device(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(InputError, match="pipe: "):
        atomic.write(pipe, b"")
    assert pipe.is_fifo()


def test_an_error_of_a_read_only_file_system_names_the_file_that_was_wanted(tmp_path, monkeypatch):
    def refuse(path, *_, **__):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(path))

    monkeypatch.setattr("bench.files.atomic.open", refuse, raising=False)
    monkeypatch.setattr(Path, "unlink", refuse)
    with pytest.raises(OSError, match="Read-only") as caught:
        atomic.write(tmp_path / "a.json", b"")
    assert caught.value.filename == str(tmp_path / "a.json")


def test_a_folder_takes_its_place_whole_and_scratch_is_removed(tmp_path):
    with atomic.replacing(tmp_path / "folder") as partial:
        partial.mkdir()
        (partial / "a").touch()
    with atomic.temporary(tmp_path / "folder") as scratch:
        scratch.mkdir()
        (scratch / "b").touch()
    assert [path.name for path in tmp_path.rglob("*")] == ["folder", "a"]


def test_a_full_disk_is_an_error_before_anything_is_mapped(tmp_path, monkeypatch):
    full = Mock(side_effect=OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))
    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(OSError, match="No space"), atomic.replacing(tmp_path / "file") as partial:
        atomic.mapped(partial, np.float16, (1000, 1000))
    assert list(tmp_path.iterdir()) == []
    assert full.call_args.args[2] > 1000 * 1000 * 2
    monkeypatch.undo()
    values = atomic.mapped(tmp_path / "file", np.float16, (1000, 1000))
    assert (tmp_path / "file").stat().st_blocks * 512 >= 2_000_000
    values[3] = 7
    del values
    assert np.load(tmp_path / "file")[3, 5] == 7


MAKE = """
import sys, time
from pathlib import Path
from bench.files import atomic
path = Path(sys.argv[1])
with atomic.locked(path):
    if not path.exists():
        time.sleep(0.2)
        atomic.write(path, b"made")
        print("made")
"""


def test_several_processes_make_a_file_once(tmp_path):
    command = [sys.executable, "-c", MAKE, str(tmp_path / "file")]
    makers = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(3)]
    assert "".join(maker.communicate()[0] for maker in makers) == "made\n"
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_the_folder_follows_the_environment_and_is_emptied_on_request(tmp_path, monkeypatch):
    monkeypatch.setenv("NEUBTF_CACHE", str(tmp_path / "here"))
    assert cache_dir() == tmp_path / "here"
    (cache_dir() / "scratch").mkdir()
    (cache_dir() / "scratch" / "a.npy").write_bytes(b"12345")
    (cache_dir() / "scratch" / "broken").symlink_to("nowhere")
    (cache_dir() / "shared").mkdir()
    (cache_dir() / "shared" / "rainer2020.nbtf").write_bytes(b"hours of training")
    count, size = clear_cache()
    assert (count, size) == (2, 5 + len("nowhere"))
    assert [path.name for path in cache_dir().rglob("*")] == ["shared", "rainer2020.nbtf"]
    monkeypatch.delenv("NEUBTF_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert cache_dir() == tmp_path / "xdg" / "neubtf-bench"


def test_who_waits_is_let_in_one_at_a_time_though_the_lock_is_removed_each_time(tmp_path):
    inside, most = [], []

    def enter():
        for _ in range(20):
            with atomic.locked(tmp_path / "file"):
                inside.append(1)
                most.append(len(inside))
                time.sleep(0.001)  # long enough for the others to open the lock of this one
                inside.pop()

    with ThreadPoolExecutor(6) as threads:
        for _ in range(6):
            threads.submit(enter)
    assert len(most) == 120
    assert max(most) == 1
    assert list(tmp_path.iterdir()) == []


def test_a_link_stays_a_link_and_a_file_keeps_its_permissions(tmp_path):
    (tmp_path / "real").write_bytes(b"old")
    (tmp_path / "real").chmod(0o600)
    (tmp_path / "link").symlink_to("real")
    atomic.write(tmp_path / "link", b"new")
    assert (tmp_path / "link").is_symlink()
    assert ((tmp_path / "real").read_bytes(), (tmp_path / "real").stat().st_mode & 0o777) == (b"new", 0o600)


def test_a_link_to_the_folder_of_trained_networks_stays(tmp_path, monkeypatch):
    monkeypatch.setenv("NEUBTF_CACHE", str(tmp_path / "here"))
    (tmp_path / "networks").mkdir()
    (cache_dir() / "shared").symlink_to(tmp_path / "networks")
    assert clear_cache() == (0, 0)
    assert (cache_dir() / "shared").is_dir()
