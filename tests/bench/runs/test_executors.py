import json
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import BrokenExecutor, CancelledError, wait

import pytest

from bench.inputs.errors import InputError
from bench.runs.executors import THREAD_COUNTS, InProcess, dask, processes
from bench.runs.runner import Options, run
from bench.runs.suite import load_suite, with_changes
from tests.bench.outside import install


def test_an_interruption_is_no_error_of_a_job():
    def interrupted():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        InProcess().submit(interrupted)


def test_a_worker_that_dies_takes_only_its_own_job_along():
    with processes(2, 1) as workers:
        lost = workers.executor.submit(os._exit, 9)
        other = workers.executor.submit(divmod, 7, 2)
        assert isinstance(lost.exception(), BrokenExecutor)
        assert other.result() == (3, 1)
        assert [workers.executor.submit(divmod, n, 2).result() for n in range(4)] == [(0, 0), (0, 1), (1, 0), (1, 1)]


def test_a_worker_that_dies_without_a_job_is_replaced():
    with processes(1, 1) as workers:
        worker = workers.executor.submit(os.getpid).result()
        os.kill(worker, signal.SIGKILL)
        workers.executor.workers[0].process.join()
        assert workers.executor.submit(divmod, 7, 2).result() == (3, 1)


def test_a_script_without_a_guard_is_not_run_again_by_its_workers(tmp_path):
    (tmp_path / "script.py").write_text("""
from bench.runs.executors import processes
print("once")
with processes(1, 1) as workers:
    print(workers.executor.submit(divmod, 7, 2).result(), __file__[-9:])
""")
    done = subprocess.run([sys.executable, tmp_path / "script.py"], capture_output=True, text=True, check=True)
    assert done.stdout == "once\n(3, 1) script.py\n"


TELLING = """
import os
from bench.runs.executors import tell
tell("reading", 3, 4)
tell("reading", 4, 4)
tell("fitting · 20 dB", 1, 9)
os._exit(9)
"""


def test_a_worker_tells_its_progress_and_the_bar_of_a_dead_one_ends():
    shown = []
    with processes(1, 1) as workers:
        workers.show_with(lambda *told: shown.append(told))
        assert isinstance(workers.executor.submit(exec, TELLING).exception(), BrokenExecutor)
    assert shown == [("reading", 3, 4), ("reading", 4, 4), ("fitting · 20 dB", 1, 9), ("fitting", 9, 9)]


def test_an_error_of_a_job_says_where_it_was_raised():
    with processes(1, 1) as workers:
        error = workers.executor.submit(json.loads, "no JSON").exception()
        assert workers.executor.submit(divmod, 7, 2).result() == (3, 1)
    assert isinstance(error, ValueError)
    assert "in loads" in error.__notes__[0]


SLOW = """
import time
from baselines.mean_colour import MeanColour

class Slow(MeanColour):
    name = "slow"
    def encode(self, btf, fit):
        for step in fit.progress(range(3), "my steps"):
            fit.log(step, psnr=20.0 + step)
        return super().encode(btf, fit)
"""


@pytest.mark.long
@pytest.mark.usefixtures("brief", "undrawn", "untimed")
def test_a_fit_of_a_codec_from_outside_shows_its_bar_and_keeps_its_curve(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(install(tmp_path / "site", "slow", {"slow": "slow_codec:Slow"}, {"slow_codec": SLOW}))
    changes = {"data.size": "8", "data.views": "3", "data.lights": "3", "data.heldout": "4"}
    suite = with_changes(load_suite("quick"), ["satin"], ["slow"], changes)
    shown = []
    (outcome,) = run(suite, Options(tmp_path / "run", show=lambda *told: shown.append(told)))
    assert ("satin/slow/0: my steps", 3, 3) in shown
    curve = [(point["step"], point["psnr"], point["seconds"] >= 0) for point in outcome.record["history"]]
    assert curve == [(0, 20.0, True), (1, 21.0, True), (2, 22.0, True)]


def test_workers_have_the_threads_of_the_suite_and_do_not_hear_ctrl_c():
    before = signal.getsignal(signal.SIGINT)  # a test run in the background may ignore it
    with processes(1, 3) as workers:
        assert [workers.executor.submit(os.getenv, name).result() for name in THREAD_COUNTS] == ["3"] * 3
        assert workers.executor.submit(signal.getsignal, signal.SIGINT).result() == signal.SIG_IGN
    assert signal.getsignal(signal.SIGINT) == before


@pytest.mark.parametrize(("visible", "given"), [("5, 7,9", ["5", "7"]), ("5", ["5", "5"])])
def test_workers_have_gpus_in_turn(visible, given, monkeypatch):
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", visible)
    with processes(2, 1, "cuda") as workers:
        seen = [workers.executor.submit(os.getenv, "CUDA_VISIBLE_DEVICES") for _ in range(2)]
        assert [future.result() for future in seen] == given


@pytest.mark.parametrize(
    ("count", "device", "message"),
    [(0, "cpu", "at least 1"), (4, "cuda", "names no GPU"), (2, "cuda:1", "give --device cuda")],
)
def test_workers_that_cannot_be_had_are_refused(count, device, message, monkeypatch):
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "")
    with pytest.raises(InputError, match=message):
        processes(count, 1, device).__enter__()


def test_a_single_worker_has_the_gpu_that_was_asked_for(monkeypatch):
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    with processes(1, 1, "cuda:1") as workers:
        assert workers.executor.submit(os.getenv, "CUDA_VISIBLE_DEVICES").result() is None


def test_where_there_is_no_gpu_no_variable_is_blamed(monkeypatch):
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    monkeypatch.setattr("torch.cuda.device_count", lambda: 0)
    with pytest.raises(InputError, match="there is no GPU here"):
        processes(2, 1, "cuda").__enter__()


def test_the_end_of_a_run_ends_its_workers_whatever_they_do():
    with processes(1, 1) as workers:
        future = workers.executor.submit(time.sleep, 600)
    assert isinstance(future.exception(), BrokenExecutor)  # after its end it would have an answer


PARENT = """
import os, time
from bench.runs.executors import processes
if __name__ == "__main__":
    with processes(1, 1) as workers:
        print(workers.executor.submit(os.getpid).result(), flush=True)
        workers.executor.submit(time.sleep, 600).result()
"""


def test_workers_end_with_the_process_that_started_them(tmp_path):
    (tmp_path / "parent.py").write_text(PARENT)
    parent = subprocess.Popen([sys.executable, tmp_path / "parent.py"], stdout=subprocess.PIPE, text=True)
    worker = int(parent.stdout.readline())
    os.kill(worker, 0)
    parent.kill()
    parent.wait()
    parent.stdout.read()  # the worker holds its end of the pipe as long as it lives
    parent.stdout.close()


def test_dask_that_is_not_there_is_said(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"neubtf-bench\[dask\]"):
        dask("tcp://127.0.0.1:1", {}).__enter__()


@pytest.fixture
def cluster():
    distributed = pytest.importorskip("distributed", reason="needs Dask: pip install neubtf-bench[dask]")
    kinds = {"threads_per_worker": 1, "processes": False, "dashboard_address": ":0"}
    with distributed.LocalCluster(1, **kinds, resources={"GPU": 1}) as local:
        yield local


def test_dask_runs_jobs_on_workers_that_have_what_they_take(cluster):
    with dask(cluster.scheduler_address, {"GPU": 1}) as workers:
        futures = [workers.executor.submit(divmod, n, 2) for n in range(5)]
        assert [future.result() for future in futures] == [divmod(n, 2) for n in range(5)]
    with dask(cluster.scheduler_address, {"GPU": 2}) as workers:
        future = workers.executor.submit(divmod, 7, 2)
        assert wait([future], timeout=0.5).not_done == {future}


def test_jobs_of_a_scheduler_that_is_gone_are_cancelled(cluster):
    with dask(cluster.scheduler_address, {"GPU": 2}) as workers:  # so that it waits, however long closing takes
        future = workers.executor.submit(divmod, 7, 2)
        cluster.close()
        with pytest.raises(CancelledError):
            future.result(timeout=60)


LACKING = """
import importlib.metadata as metadata
version = metadata.version
def without_ours(name):
    if name == "neubtf-bench":
        raise metadata.PackageNotFoundError(name)
    return version(name)
metadata.version = without_ours
from distributed.cli.dask_worker import main
main()
"""


def test_a_worker_without_the_package_is_said_with_the_remedy():
    distributed = pytest.importorskip("distributed", reason="needs Dask: pip install neubtf-bench[dask]")
    kinds = {"threads_per_worker": 1, "processes": False, "dashboard_address": ":0", "protocol": "tcp://"}
    with distributed.LocalCluster(1, **kinds) as cluster:
        address, options = cluster.scheduler_address, ["--no-nanny", "--no-dashboard"]
        worker = subprocess.Popen([sys.executable, "-c", LACKING, address, *options], stderr=subprocess.DEVNULL)
        try:
            while len(cluster.scheduler.workers) < 2:
                time.sleep(0.1)
            with pytest.raises(InputError, match=r"neubtf-bench .* tcp://.*install"):
                dask(address, {}).__enter__()
        finally:
            worker.kill()
            worker.wait()


@pytest.mark.long
def test_a_scheduler_that_is_not_there_is_named(monkeypatch, tmp_path):
    pytest.importorskip("distributed", reason="needs Dask: pip install neubtf-bench[dask]")
    monkeypatch.setattr("bench.runs.executors.PATIENCE", "1s")
    for address in ("tcp://127.0.0.1:9", "nonsense", str(tmp_path / "scheduler.json")):
        with pytest.raises(InputError, match=f"{address}: no Dask"):
            dask(address, {}).__enter__()
