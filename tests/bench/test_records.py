import errno
import os

import pytest

from bench import records
from bench.errors import InputError
from bench.records import FILE, append, load_run, load_trade


def test_records_come_back_the_latest_of_each_job(tmp_path):
    append(tmp_path, {"kind": "run", "run": "a"})
    append(tmp_path, {"kind": "job", "job": "x", "status": "failed"})
    append(tmp_path, {"kind": "job", "job": "y", "status": "ok"})
    append(tmp_path, {"kind": "job", "job": "x", "status": "ok"})
    append(tmp_path, {"kind": "timing", "job": "y", "ns_per_sample": 3.5})
    run = load_run(tmp_path)
    assert [(job["job"], job["status"]) for job in run.jobs] == [("x", "ok"), ("y", "ok")]
    assert [start["run"] for start in run.starts] == ["a"]
    assert run.timing(run.jobs[0]) is None
    assert run.timing(run.jobs[1])["ns_per_sample"] == 3.5
    assert run.unreadable == []


def test_a_file_of_records_is_read_by_its_own_name(tmp_path):
    append(tmp_path, {"kind": "job", "job": "x", "status": "ok"})
    (tmp_path / FILE).rename(tmp_path / "reference.jsonl")
    assert [job["job"] for job in load_run(tmp_path / "reference.jsonl").jobs] == ["x"]
    with pytest.raises(InputError, match=r"gone\.jsonl: no run here"):
        load_run(tmp_path / "gone.jsonl")


def test_a_line_cut_by_a_kill_is_counted_and_costs_only_itself(tmp_path):
    append(tmp_path, {"kind": "job", "job": "x", "status": "ok"})
    with open(tmp_path / FILE, "ab") as file:
        file.write(b'{"kind": "job", "job": "y", "sta')
    append(tmp_path, {"kind": "job", "job": "z", "status": "ok"})
    run = load_run(tmp_path)
    assert [job["job"] for job in run.jobs] == ["x", "z"]
    assert run.unreadable == [2]


@pytest.mark.parametrize("line", [b"\xff\xfe\n", b"[1, 2]\n", b'"job"\n', b'{"kind": "job"}\n'])
def test_a_line_that_is_no_record_is_counted(tmp_path, line):
    (tmp_path / FILE).write_bytes(line)
    assert load_run(tmp_path).unreadable == [1]


def test_a_number_that_is_not_finite_is_never_recorded(tmp_path):
    with pytest.raises(ValueError, match="Out of range"):
        append(tmp_path, {"kind": "job", "job": "x", "psnr": float("inf")})
    assert not (tmp_path / FILE).exists()


def test_a_folder_without_a_run_is_named(tmp_path):
    with pytest.raises(InputError, match="no run here"):
        load_run(tmp_path / "nothing")


def test_a_line_that_was_altered_is_no_record_though_it_reads_as_one(tmp_path):
    append(tmp_path, {"kind": "job", "job": "x", "psnr": 31.5})
    append(tmp_path, {"kind": "job", "job": "y", "psnr": 32.5})
    path = tmp_path / FILE
    path.write_bytes(path.read_bytes().replace(b"31.5", b"41.5"))
    run = load_run(tmp_path)
    assert [job["job"] for job in run.jobs] == ["y"]
    assert run.unreadable == [1]


def test_a_line_without_a_checksum_is_a_record_too(tmp_path):
    (tmp_path / FILE).write_text('{"kind": "job", "job": "x", "psnr": 31.5}\n')
    append(tmp_path, {"kind": "job", "job": "y"})
    assert list(load_run(tmp_path).jobs) == [{"kind": "job", "job": "x", "psnr": 31.5}, {"kind": "job", "job": "y"}]


@pytest.mark.parametrize("name", ['a "quoted" \\ name', "ümlaut/π components=4/0", "", '", "'])
def test_any_name_is_found_again(tmp_path, name):
    append(tmp_path, {"kind": "job", "job": name, "bytes": 1})
    append(tmp_path, {"kind": "job", "job": name, "bytes": 2})
    run = load_run(tmp_path)
    assert list(run.jobs) == [run.job(name)] == [{"kind": "job", "job": name, "bytes": 2}]


def test_jobs_stand_in_the_order_in_which_they_were_planned(tmp_path):
    append(tmp_path, {"kind": "run", "jobs": ["a", "b", "c"]})
    for name in ("c", "a"):
        append(tmp_path, {"kind": "job", "job": name})
    append(tmp_path, {"kind": "run", "jobs": ["z", "b"]})
    for name in ("other", "b"):
        append(tmp_path, {"kind": "job", "job": name})
    run = load_run(tmp_path)
    assert [job["job"] for job in run.jobs] == ["a", "b", "c", "other"]
    assert [job["job"] for job in run.jobs[1:3]] == ["b", "c"]
    assert run.jobs[-1]["job"] == "other"


def test_opening_a_run_reads_into_no_job(tmp_path, monkeypatch):
    for name in ("x", "y"):
        append(tmp_path, {"kind": "job", "job": name})
        append(tmp_path, {"kind": "timing", "job": name})
    parsed = []
    parse = records._parsed
    monkeypatch.setattr(records, "_parsed", lambda line: parsed.append(line) or parse(line))
    run = load_run(tmp_path)
    assert parsed == []
    assert run.timing(run.jobs[1]) == {"kind": "timing", "job": "y"}
    assert len(parsed) == 2


def test_a_disk_that_fills_up_while_a_record_is_written_keeps_what_was_there(tmp_path, monkeypatch):
    append(tmp_path, {"kind": "job", "job": "x"})
    before, write = (tmp_path / FILE).read_bytes(), os.write

    def nearly_full(file, data):
        if len(data) < 20:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(file, data[:20])

    with monkeypatch.context() as patch:
        patch.setattr(os, "write", nearly_full)
        with pytest.raises(InputError, match=r"records\.jsonl: cannot be written \(No space left.*make room"):
            append(tmp_path, {"kind": "job", "job": "y"})
    assert (tmp_path / FILE).read_bytes() == before
    append(tmp_path, {"kind": "job", "job": "y"})
    assert [job["job"] for job in load_run(tmp_path).jobs] == ["x", "y"]


@pytest.mark.parametrize("text", ["{", "[]", '{"choices": []}', '{"format": 0, "choices": []}'])
def test_a_trade_of_another_version_is_refused_with_the_remedy(tmp_path, text):
    append(tmp_path, {"kind": "run", "run": "1"})
    assert load_trade(tmp_path) is None
    (tmp_path / "trade.json").write_text(text)
    with pytest.raises(InputError, match=r"trade\.json: .*remove it, and run trade again"):
        load_trade(tmp_path)
