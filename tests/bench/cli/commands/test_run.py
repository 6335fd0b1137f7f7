import re

import pytest

from bench import cli
from bench.records import load_run
from bench.runs import runner

SMALL = [part for key in ("size=12", "views=6", "lights=6", "heldout=4") for part in ("--set", f"data.{key}")]
WORDS = ["run", "quick", "--material", "satin", "--codec", "mean-colour", "--codec", "table", *SMALL]


pytestmark = pytest.mark.usefixtures("brief", "undrawn", "untimed")


def test_an_interrupted_run_says_what_is_done_and_goes_on(tmp_path, monkeypatch, capsys):
    work, calls = runner.work, []

    def interrupted(task, show):
        calls.append(task.name)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return work(task, show)

    monkeypatch.setattr(runner, "work", interrupted)
    words = [*WORDS, "--out", str(tmp_path / "run")]
    assert cli.main(words) == 130
    shown = capsys.readouterr()
    assert "1 ok" in shown.out
    assert re.search(r"interrupted: 1\b.*\b2\b", shown.out)
    assert shown.err == ""
    assert not (tmp_path / "run" / "lock").exists()
    part = str(tmp_path / "part.jsonl")
    assert cli.main(["results", "add", str(tmp_path / "run"), part]) == 0  # what is finished can be published
    assert cli.main(["table", "main", part]) == cli.main(["table", "unfinished", part]) == 0
    assert re.search(r"satin +table\b.*\b0$", capsys.readouterr().out, re.M)
    assert cli.main(words) == 0
    assert "2 ok; 1" in capsys.readouterr().out


@pytest.mark.long
def test_a_metric_is_chosen_at_the_command_line_and_scored_from_the_cached_file(tmp_path, capsys):
    words = [*WORDS, "--out", str(tmp_path / "run")]
    assert cli.main(words) == 0
    assert cli.main([*words, "--metric", "flip_hdr_67ppd"]) == 0
    assert "2 scored" in capsys.readouterr().out
    job = load_run(tmp_path / "run").jobs[0]
    assert 0 < job["scores"]["heldout"]["metrics"]["flip_hdr_67ppd_periodic"]["mean"] < 1
    assert cli.main(["table", "main", str(tmp_path / "run")]) == 0
    assert "HDR FLIP" in capsys.readouterr().out
    assert cli.main([*words, "--metric", "flip_hdr"]) == 2
    assert "--metric: " in capsys.readouterr().err


@pytest.mark.long
def test_jobs_run_in_so_many_processes_of_the_threads_of_the_suite(tmp_path, capsys):
    assert cli.main([*WORDS, "--out", str(tmp_path / "run"), "--jobs", "2"]) == 0
    assert "2 ok" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("second", "message"),
    [
        ('"sattin"', "'sattin'"),
        ('"none.npz"', "my.toml: materials: none.npz: "),
    ],
)
def test_a_material_that_is_not_there_stops_a_run_before_its_first_job(second, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my.toml").write_text(f'materials = ["satin", {second}]\n[[codecs]]\ncodec = "mean-colour"\n')
    assert cli.main(["run", "my.toml", *SMALL]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()


def test_one_that_is_missing_but_says_where_to_get_it_only_leaves_its_jobs_out(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    cloth = '{name = "cloth", path = "none.npz", where = "ask for it"}'
    (tmp_path / "my.toml").write_text(f'materials = ["satin", {cloth}]\n[[codecs]]\ncodec = "mean-colour"\n')
    assert cli.main(["run", "my.toml", *SMALL]) == 0
    said = capsys.readouterr().out
    assert "1 ok" in said
    assert "ask for" in said


def test_a_suite_without_jobs_is_refused(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my.toml").write_text("")
    assert cli.main(["run", "my.toml"]) == 2
    assert "suite my: " in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--jobs", "-1"], "--jobs -1: "),
        (["--jobs", "2", "--scheduler", "tcp://127.0.0.1:9"], "--scheduler"),
        (["--resource", "GPU=1"], "--scheduler"),
        (["--scheduler", "tcp://127.0.0.1:9", "--resource", "GPU"], "write NAME=COUNT"),
    ],
)
def test_workers_that_make_no_sense_are_bad_usage(words, message, tmp_path, capsys):
    assert cli.main([*WORDS, "--out", str(tmp_path / "run"), *words]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "run" / "records.jsonl").exists()
