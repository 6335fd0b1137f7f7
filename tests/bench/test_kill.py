import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

KILL = Path(__file__).parents[2] / "tools" / "kill.py"

pytestmark = pytest.mark.timeout(600)  # some 15 s on two cores that have nothing else to do


def killed(*words):
    done = subprocess.run([sys.executable, KILL, "--quick", *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.parametrize("kills", [1, pytest.param(4, marks=pytest.mark.long)])
def test_a_run_killed_at_random_moments_ends_with_every_job_done_once(kills):
    out = killed("--kills", str(kills))
    assert out.count("kill ") == kills
    assert out.splitlines()[-1] == "3 good records, identical files, nothing left behind"


@pytest.mark.skipif(not importlib.util.find_spec("distributed"), reason="needs Dask: pip install neubtf-bench[dask]")
def test_a_cluster_that_loses_a_worker_in_mid_job_ends_with_every_job_done_once():
    out = killed("--workers", "dask", "--kills", "1")
    assert "kill 1 of a worker" in out
    assert out.splitlines()[-1] == "3 good records, identical files, nothing left behind"
