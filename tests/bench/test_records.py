import errno
import json
import os
from dataclasses import replace
from pathlib import Path

import pytest

from bench import cli
from bench.inputs.errors import InputError
from bench.records import FILE, MOST_DB, Run, append, counted, lines, load_run, view

LEAST = {"material": "satin", "codec": "pca", "label": "pca", "seed": 0}
DONE = LEAST | {"status": "ok", "scores": {}, "metrics": {}, "bytes": {"total": 1}, "parameters": 0}


def job(name, status="ok", **more):
    """A record with no more fields than a job must have."""
    return {"kind": "job", "job": name} | DONE | {"status": status, "error": "none"} | more


def timing(name, ns):
    """A record with no more fields than a timing must have."""
    return {"kind": "timing", "job": name, "run": "a", "ns_per_sample": ns, "interval95_ns": [ns, ns]}


def test_records_come_back_the_latest_of_each_job(tmp_path):
    append(tmp_path, {"kind": "run", "run": "a"})
    append(tmp_path, job("x", "failed"))
    append(tmp_path, job("y", "ok"))
    append(tmp_path, job("x", "ok"))
    append(tmp_path, timing("y", 3.5))
    run = load_run(tmp_path)
    assert [(job["job"], job["status"]) for job in run.jobs] == [("x", "ok"), ("y", "ok")]
    assert [start["run"] for start in run.starts] == ["a"]
    assert run.timing(run.jobs[0]) is None
    assert run.timing(run.jobs[1])["ns_per_sample"] == 3.5
    assert run.unreadable == []


def test_a_line_cut_by_a_kill_is_counted_and_costs_only_itself(tmp_path):
    append(tmp_path, job("x", "ok"))
    with open(tmp_path / FILE, "ab") as file:
        file.write(b'{"kind": "job", "job": "y", "sta')
    append(tmp_path, job("z", "ok"))
    run = load_run(tmp_path)
    assert [job["job"] for job in run.jobs] == ["x", "z"]
    assert run.unreadable == [2]


def test_a_line_that_was_altered_is_no_record_though_it_reads_as_one(tmp_path, caplog):
    append(tmp_path, job("x", psnr=31.5))
    append(tmp_path, job("y", psnr=32.5))
    path = tmp_path / FILE
    path.write_bytes(path.read_bytes().replace(b"31.5", b"41.5"))
    run = load_run(tmp_path)
    assert [job["job"] for job in run.jobs] == ["y"]
    assert run.unreadable == [1]
    assert len(lines.load_together([tmp_path]).jobs) == 1
    assert "line(s) 1" in caplog.text  # tables would lack it unsaid


@pytest.mark.parametrize("name", ['a "quoted" \\ name', "ümlaut/π components=4/0", "", '", "'])
def test_any_name_is_found_again(tmp_path, name):
    append(tmp_path, job(name, pairs={"all": 1}))
    append(tmp_path, job(name, pairs={"all": 2}))
    run = load_run(tmp_path)
    assert list(run.jobs) == [run.job(name)] == [job(name, pairs={"all": 2})]


def test_jobs_stand_in_the_order_in_which_they_were_planned(tmp_path):
    append(tmp_path, {"kind": "run", "jobs": ["a", "b", "c"]})
    for name in ("c", "a"):
        append(tmp_path, job(name))
    append(tmp_path, {"kind": "run", "jobs": ["z", "b"]})
    for name in ("other", "b"):
        append(tmp_path, job(name))
    run = load_run(tmp_path)
    assert [job["job"] for job in run.jobs] == ["a", "b", "c", "other"]
    assert (run.jobs[1:3][0]["job"], run.jobs[-1]["job"]) == ("b", "other")


def test_a_folder_of_files_of_records_is_read_as_one_run(tmp_path):
    for name in "ab":
        (tmp_path / f"{name}.jsonl").write_text(json.dumps({"kind": "run", "run": name}) + "\n")
    assert [start["run"] for start in lines.load_together([tmp_path]).starts] == ["a", "b"]


def test_a_disk_that_fills_up_while_a_record_is_written_keeps_what_was_there(tmp_path, monkeypatch):
    append(tmp_path, job("x"))
    before, write = (tmp_path / FILE).read_bytes(), os.write

    def nearly_full(file, data):
        if len(data) < 20:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(file, data[:20])

    with monkeypatch.context() as patch:
        patch.setattr(os, "write", nearly_full)
        with pytest.raises(InputError, match=r"records\.jsonl: .*No space"):
            append(tmp_path, job("y"))
    assert (tmp_path / FILE).read_bytes() == before
    append(tmp_path, job("y"))
    assert [job["job"] for job in load_run(tmp_path).jobs] == ["x", "y"]


def line(record):
    return json.dumps(record) + "\n"


STRESS = {"kind": "stress", "subject": "pca", "extreme": "dark", "group": "data", "order": 0}
STRESS |= {"detail": "", "figure": ""}
FLOOR = {"material": "m", "label": "floor", "execution": "eager", "dtype": "float32", "device": "cpu"}
CHOICE = {"kind": "timing", "job": "x/eager", "run": "1", "of": "x"} | FLOOR
BAD = [
    (job("x", seed=True), "seed"),
    (job("x", label=" "), "label"),
    (job("x", "done"), "status"),
    (job("x", parameters=10**400), "parameters"),
    (job("x", parameters=-1), "parameters"),
    (job("x", bytes={"total": 1e300}), "bytes/total"),
    (job("x", bytes={}), "bytes/total"),
    (job("x", shape=[8]), "shape"),
    (job("x", fit_seconds=float("nan")), "fit_seconds"),
    (job("x", mine=[[[[[[[[[[[[[[[1]]]]]]]]]]]]]]]), "mine"),
    (job("x", scores={"heldout": {"metrics": {"psnr_display": {"pooled": "31"}}}}), "metrics/psnr_display/pooled"),
    (job("x", metrics={"psnr": {"unit": "dB", "direction": "up", "version": 1}}), "direction"),
    (job("x", history=[{"step": 1}, {"psnr": 3}]), "history/1/step"),
    (job("x", history={"step": [1, 2], "psnr": [3.0]}), "history"),
    ({"kind": "job", "job": "x"}, "material"),
    ({"kind": "job", "job": ["x"]} | DONE, "job"),
    (timing("x", 0), "ns_per_sample"),
    ({"kind": "timing", "job": "x", "run": "1"}, "ns_per_sample"),
    (CHOICE, "codec"),
    (CHOICE | {"error": "why", "psnr": 30.0}, "codec"),
    (CHOICE | {"error": "why", "ns_per_sample": 1.0}, "interval95_ns"),
    (timing("x", 1) | FLOOR, "ratio_to_floor"),
    ({"kind": "run", "seeds": 3}, "seeds"),
    ({"kind": "run", "packages": [1]}, "packages"),
    (STRESS | {"verdict": "perhaps"}, "verdict"),
]


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -1e19, 10**400, True, "1", [1.0], {"a": 1.0}])
def test_one_bad_number_among_many_good_ones_is_named(value, tmp_path):
    metrics = {metric: dict.fromkeys("abcd", 1.5) | {"n": 4, "none": None} for metric in ("one", "two", "three")}
    metrics["two"]["c"] = value
    (tmp_path / FILE).write_text(line(job("x", scores={"heldout": {"metrics": metrics}})))
    with pytest.raises(InputError, match=r"line 1: scores/heldout/metrics/two/c "):
        load_run(tmp_path)
    (tmp_path / FILE).write_text(line(timing("x", 1) | {"samples_ns": [1.0, 2.0, value, None]}))
    if value.__class__ is float or value.__class__ is int:
        with pytest.raises(InputError, match="line 1: samples_ns "):
            load_run(tmp_path)


@pytest.mark.parametrize(("record", "field"), BAD, ids=range(len(BAD)))
def test_a_record_written_by_hand_is_refused_by_file_line_and_field(record, field, tmp_path):
    (tmp_path / FILE).write_text(line(job("fine")) + line(record))
    with pytest.raises(InputError, match=rf"records\.jsonl, line 2: (\S+/)?{field}\b"):
        load_run(tmp_path)


@pytest.mark.parametrize(
    "text", ["[" * 9999, '{"kind": ["job"]}', '{"kind": "job", "job": "x", "a": ' + "9" * 9999 + "}"]
)
def test_what_no_json_holds_is_no_record(text, tmp_path):
    fine = job("x", mine={"a": [1, None, "b"]})  # a field that is not listed, and no checksum
    others = b'\xff\xfe\n[1, 2]\n"job"\n{"kind": "job"}\n'
    (tmp_path / FILE).write_bytes(text.encode() + b"\n" + line(fine).encode() + others)
    append(tmp_path, job("y"))
    with pytest.raises(ValueError, match="Out of range"):
        append(tmp_path, job("z", psnr=float("inf")))
    run = load_run(tmp_path)
    assert (run.unreadable, list(run.jobs)) == ([1, 3, 4, 5, 6], [fine, job("y")])
    (tmp_path / FILE).rename(tmp_path / "reference.jsonl")
    assert list(load_run(tmp_path / "reference.jsonl").jobs) == [fine, job("y")]
    for gone in ("gone.jsonl", "nothing"):
        with pytest.raises(InputError, match=f"{gone}: no such"):
            load_run(tmp_path / gone)


@pytest.mark.parametrize("words", [["compare", "RUN", "RUN"], ["report", "RUN"], ["table", "RUN"], ["history", "RUN"]])
def test_every_command_says_in_one_line_what_is_wrong_with_a_record(words, tmp_path, capsys):
    append(tmp_path, job("x", scores=3))
    assert cli.main([str(tmp_path) if word == "RUN" else word for word in words]) == 2
    error = capsys.readouterr().err
    assert "records.jsonl, line 1: scores " in error
    assert error.count("\n") == 1


def test_a_view_of_a_run_is_made_once_for_each_run_and_its_words():
    asked = []

    @view
    def words_of(run, more=""):
        asked.append((run, more))
        return [*run.starts, more]

    first, second = Run(Path("a"), starts=[{"run": "1"}]), Run(Path("a"))
    assert words_of(first) is words_of(first)
    assert words_of(first, "x") == [{"run": "1"}, "x"]
    assert words_of(second) == [""]
    assert len(asked) == 3
    assert words_of(replace(first, starts=[])) == [""]  # a changed run has none of the views of the first


def test_a_job_that_replaces_no_other_leaves_the_choices_of_the_other_as_they_are(tmp_path):
    for folder in ("a", "b"):
        key = {"score_key": {"sha256": folder}}
        (tmp_path / folder).mkdir()
        append(tmp_path / folder, job("x", run=folder, **key))
        choice = timing("x/eager float32/cpu", 1.0) | {"material": "satin", "label": "pca", "of": "x"} | key
        choice |= {"execution": "eager", "dtype": "float32", "device": "cpu", "limit_ns": 1.0, "batch": 1, "threads": 1}
        choice |= {"codec": "pca", "settings": {}, "bytes": 1, "psnr": 30.0, "worst": 20.0, "flip": 0.1}
        append(tmp_path / folder, choice | {"ratio_to_floor": 1.0, "ratio_interval95": [1.0, 1.0]})
    run = lines.load_together([tmp_path / "a", tmp_path / "b"], wanted=lambda job: job["run"] == "a")
    assert [choice["score_key"]["sha256"] for choice in run.choices] == ["a"]


def test_a_job_that_failed_replaces_no_result_and_a_new_file_has_no_old_time(tmp_path):
    def run(name, status, sha256=""):
        (tmp_path / name).mkdir()
        append(tmp_path / name, job("x", status, run=name, **({"score_key": {"sha256": sha256}} if sha256 else {})))

    def together(*names):
        return lines.load_together([tmp_path / name for name in names])

    for name in ("first", "same", "other"):
        run(name, "ok", "2" if name == "other" else "1")
    run("failed", "failed")
    append(tmp_path / "first", timing("x", 1.0))
    jobs_of = {last: [job["run"] for job in together("first", last).jobs] for last in ("failed", "same", "other")}
    assert jobs_of == {"failed": ["first"], "same": ["same"], "other": ["other"]}
    assert [len(together("first", last).timings) for last in jobs_of] == [1, 1, 0]
    assert [job["status"] for job in together("failed", "first").jobs] == ["ok"]


def test_a_job_that_was_fitted_again_has_no_time_of_its_former_file(tmp_path):
    def fitted(sha256):
        append(tmp_path, job("x", score_key={"sha256": sha256}))

    fitted("1")
    append(tmp_path, timing("x", 1.0))
    fitted("1")  # the same file again
    append(tmp_path, job("x", "failed"))
    assert len(load_run(tmp_path).timings) == 1
    fitted("2")
    assert len(load_run(tmp_path).timings) == 0


def test_a_psnr_without_error_counts_as_the_most_that_a_display_shows():
    assert (counted(None), counted(30.0)) == (MOST_DB, 30.0)
