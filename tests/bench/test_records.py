import pytest

from bench.errors import InputError
from bench.records import FILE, append, load_run


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
