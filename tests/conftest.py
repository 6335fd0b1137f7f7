"""One thread a process: threads that wait for each other cost more than they give on pictures this small."""

import math
import os

import pytest

os.environ.setdefault("OMP_NUM_THREADS", "1")  # read when NumPy and PyTorch are first imported, after this file


@pytest.fixture(autouse=True)
def quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    """No line of progress where a slow machine takes long: what a command prints is compared."""
    monkeypatch.setattr("bench.console.SILENCE", math.inf)
