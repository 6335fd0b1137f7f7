import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

KILL = Path(__file__).with_name("kill.py")
pytestmark = pytest.mark.timeout(600)  # some 15 s on two cores that have nothing else to do

DASK = pytest.mark.skipif(not importlib.util.find_spec("distributed"), reason="needs the extra dask")


@pytest.mark.parametrize(
    ("kills", "words"),
    [
        pytest.param(1, [], marks=pytest.mark.long),
        pytest.param(4, [], marks=pytest.mark.long),
        pytest.param(1, ["--workers", "dask"], marks=[DASK, pytest.mark.long]),
    ],
)
def test_a_run_or_worker_killed_at_random_moments_ends_with_every_job_done_once(kills, words):
    command = [sys.executable, KILL, "--quick", *words, "--kills", str(kills)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("kill ") == kills
    assert ("of a worker" in done.stdout) == bool(words)
    assert done.stdout.splitlines()[-1].startswith("3 good records")
