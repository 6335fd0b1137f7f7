import os
import random
import re
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import torch

from bench import cli
from bench.codecs.registry import make_codec
from bench.conformance.check import tiny_btf
from bench.data.readers.folder import write_folder
from bench.machine.process_state import restored_process_state
from bench.records import load_run
from bench.runs import runner
from bench.runs.runner import timings
from bench.runs.suite import load_suite, with_changes
from tests.bench.outside import install

pytestmark = pytest.mark.timeout(300)  # each process imports PyTorch
BASE = """
import os, sys
from dataclasses import dataclass
import torch
from baselines.mean_colour import MeanColour

def ending(name, end):
    return type(name.title(), (MeanColour,), {"name": name, "encode": lambda self, btf, fit: end()})

Quits, Ends = ending("quits", lambda: sys.exit(0)), ending("ends", lambda: os._exit(0))
Crashes = ending("crashes", os.abort)

class Leaves(MeanColour):
    name = "leaves"
    def encode(self, btf, fit):
        parts = super().encode(btf, fit)
        torch.set_default_dtype(torch.float64)
        torch.set_grad_enabled(False)
        torch.set_num_threads(3)
        os.chdir("/")
        return parts
    def decode(self, parts, device):
        if os.path.exists(os.environ.get("ARMED", "")):
            os._exit(0)
        return super().decode(parts, device)

class Settings(MeanColour):
    name = "settings"
    @dataclass(frozen=True)
    class Settings:
        half: bool = True
        sure: bool = False
        def __post_init__(self):
            if not self.sure:
                sys.exit(0)
"""
MODULES = {
    "hostile": BASE,
    "hostile_exit": "import sys; sys.exit(0)",
    "hostile_error": "import no_such_module_at_all",
}
CODECS = {name: f"hostile:{name.title()}" for name in ("quits", "ends", "crashes", "leaves", "settings")}
CODECS |= {f"import-{how}": f"hostile_{how}:Codec" for how in ("exit", "error")}


@pytest.fixture(autouse=True)
def hostile(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(install(tmp_path / "site", "hostile", CODECS, MODULES)))
    monkeypatch.setenv("NEUBTF_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(runner, "MOST_LOSSES", 1)
    monkeypatch.setattr("bench.timing.TURNS", 3)
    write_folder(tiny_btf(12, 6, 6), tmp_path / "btf")
    monkeypatch.chdir(tmp_path)


def ran(*codecs, fresh=False):
    suite = with_changes(load_suite("quick"), ["btf"], list(codecs), {})
    list(runner.run(suite, runner.Options(Path("run"), fresh=fresh)))
    return {job["codec"]: job for job in load_run("run").jobs}


@pytest.mark.long
def test_a_codec_that_ends_its_process_in_the_fit_is_a_failed_job_and_the_others_go_on():
    jobs = ran("quits", "ends", "crashes", "mean-colour")
    assert jobs["mean-colour"]["status"] == "ok"
    for name, why in (("quits", "SystemExit: 0"), ("ends", "died"), ("crashes", "died")):
        assert jobs[name]["status"] == "failed"
        assert jobs[name]["error"].startswith(f"codec {name} of hostile 1.0: ")
        assert why in jobs[name]["error"]


@pytest.mark.long
def test_a_codec_that_ends_its_process_when_it_is_imported_or_made_is_a_failed_job():
    codecs = ("import-exit", "import-error", "settings", "mean-colour")
    chosen = [word for codec in codecs for word in ("--codec", codec)]
    assert cli.main(["run", "quick", "--material", "btf", "--out", "run", *chosen]) == 3
    jobs = {job["codec"]: job for job in load_run("run").jobs}
    assert jobs["mean-colour"]["status"] == "ok"
    for name, why in (
        ("import-exit", "SystemExit: 0"),
        ("import-error", "'no_such_module_at_all'"),
        ("settings", "SystemExit: 0"),
    ):
        assert jobs[name]["status"] == "failed"
        assert f"codec {name} of hostile 1.0 " in jobs[name]["error"]
        assert why in jobs[name]["error"]
    assert make_codec("settings", {"sure": True}).settings.sure


def test_one_command_for_such_a_codec_is_one_line_and_exit_code_2(capsys):
    for name in ("import-exit", "import-error"):
        assert cli.main(["encode", "btf", "--codec", name, "-o", "a.nbtf"]) == 2
        error = capsys.readouterr().err
        assert f"codec {name} of hostile 1.0" in error
        assert error.count("\n") == 1


def test_a_job_that_takes_too_long_has_failed_and_the_next_has_a_worker():
    from bench.runs.executors import OutOfTimeError, processes

    with processes(1, 1, limit=3.0) as workers:
        late = workers.executor.submit(time.sleep, 600)
        assert isinstance(late.exception(), OutOfTimeError)
        assert workers.executor.submit(divmod, 7, 2).result() == (3, 1)
    for limit in ("0", "inf"):
        command = ["run", "--max-seconds", limit, "--material", "btf", "--codec", "mean-colour", "--out", "x"]
        assert cli.main(command) == 2


@pytest.mark.long
def test_a_codec_of_another_distribution_runs_on_a_cluster_as_documented(tmp_path, monkeypatch):
    pytest.importorskip("distributed", reason="needs Dask: pip install neubtf-bench[dask]")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path / "site"), *sys.path]))
    file = tmp_path / "scheduler.json"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    scheduler = ["scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", file]
    worker = ["worker", "--scheduler-file", file, "--nthreads", "1", "--no-dashboard"]  # by default in a nanny
    started = [subprocess.Popen([sys.executable, "-m", "dask", *words], **quiet) for words in (scheduler, worker)]
    try:
        while not file.exists():
            time.sleep(0.1)
        chosen = ["--codec", "leaves", "--scheduler", str(file)]
        assert cli.main(["run", "quick", "--material", "btf", "--out", "run", *chosen]) == 0
    finally:
        for process in reversed(started):
            process.terminate()
            process.wait()
    (job,) = load_run("run").jobs
    assert job["status"] == "ok", job.get("error")


@pytest.mark.long
def test_what_a_codec_leaves_behind_reaches_neither_scores_nor_the_next_job(tmp_path):
    undisturbed = ran("vq")["vq"]
    jobs = ran("leaves", "vq", fresh=True)
    assert jobs["leaves"]["status"] == "ok"
    assert jobs["vq"]["score_key"]["sha256"] == undisturbed["score_key"]["sha256"]
    assert jobs["vq"]["scores"] == undisturbed["scores"]


def test_settings_of_the_process_are_put_back_whatever_ends_the_block(tmp_path):
    folder, threads = os.getcwd(), torch.get_num_threads()
    drawn = torch.get_rng_state(), np.random.get_state()[1].copy(), random.getstate()

    def disturb():
        with restored_process_state():
            torch.set_default_dtype(torch.float64)
            torch.set_grad_enabled(False)
            torch.set_num_threads(threads + 1)
            torch.use_deterministic_algorithms(True)
            os.chdir("/")
            torch.manual_seed(1)
            np.random.seed(1)
            random.seed(1)
            raise SystemExit

    with pytest.raises(SystemExit):
        disturb()
    assert (torch.get_default_dtype(), torch.get_num_threads(), os.getcwd()) == (torch.float32, threads, folder)
    assert (torch.is_grad_enabled(), torch.are_deterministic_algorithms_enabled()) == (True, False)
    assert torch.equal(torch.get_rng_state(), drawn[0])
    assert np.array_equal(np.random.get_state()[1], drawn[1])
    assert random.getstate() == drawn[2]


@pytest.mark.long
def test_one_that_ends_the_process_that_times_it_costs_the_others_no_timing(tmp_path, monkeypatch, caplog):
    jobs = ran("leaves", "mean-colour")
    assert {timing["job"] for timing in load_run("run").timings} == {job["job"] for job in jobs.values()}
    (tmp_path / "armed").touch()
    monkeypatch.setenv("ARMED", str(tmp_path / "armed"))
    timed = timings(tmp_path / "run", list(jobs.values()), "cpu", 1)
    assert [record["job"] for record in timed] == [jobs["mean-colour"]["job"]]
    assert re.search(f"not timed.*{jobs['leaves']['job']}", caplog.text)
    assert threading.active_count() < 20


OURS = """
import os, sys
from baselines.vq import VQ
from bench.cli import main
def ends(self, btf, fit):
    {how}
if {armed}:
    VQ.encode = ends
words = ["--material", "btf", "--codec", "mean-colour", "--codec", "vq", "--out", "run", "--retry-failed"]
sys.exit(main(["run", "quick", *words]))
"""


@pytest.mark.long
@pytest.mark.parametrize(("how", "code", "done"), [("os.abort()", -6, 1), ("sys.exit(0)", 3, 2)])
def test_a_codec_of_this_suite_that_ends_its_process_is_no_success_and_the_same_command_goes_on(how, code, done):
    command = [sys.executable, "-c", OURS.format(how=how, armed=True)]
    assert subprocess.run(command, capture_output=True, check=False).returncode == code
    jobs = {job["codec"]: job for job in load_run("run").jobs}
    assert (jobs["mean-colour"]["status"], len(jobs)) == ("ok", done)
    if done == 2:
        assert jobs["vq"]["status"] == "failed"
        assert "SystemExit: 0" in jobs["vq"]["error"]
    again = [sys.executable, "-c", OURS.format(how=how, armed=False)]
    went_on = subprocess.run(again, capture_output=True, text=True, check=False)
    assert went_on.returncode == 0, went_on.stderr
    assert "2 jobs: 2 ok; 1 " in went_on.stdout
