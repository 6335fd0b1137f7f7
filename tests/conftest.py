"""One thread a process: threads that wait for each other cost more than they give on pictures this small."""

import hashlib
import math
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

os.environ.setdefault("OMP_NUM_THREADS", "1")  # read when NumPy and PyTorch are first imported, after this file


def pytest_addoption(parser: pytest.Parser) -> None:
    """The option for a share of the long tests, all of which take too long for each change."""
    parser.addoption("--share", type=int, metavar="N", help="also run one in N long tests, other ones for each commit")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Take the long tests of the share that this commit runs for short ones."""
    share = config.getoption("--share")
    if not share:
        return
    # Without git, or outside a repository, it is always the same share.
    git = shutil.which("git") or "false"
    commit = subprocess.run([git, "rev-parse", "HEAD"], capture_output=True, cwd=config.rootpath, check=False).stdout
    for item in items:
        digest = hashlib.sha1(commit + item.nodeid.encode()).digest()
        if int.from_bytes(digest[:4]) % share == 0:
            item.own_markers = [mark for mark in item.own_markers if mark.name != "long"]


def pytest_configure() -> None:
    """Add the emulated GPU where PyTorch can: only before the first gradient of a process."""
    from bench.conformance.emulated import NoEmulationError, register

    with suppress(NoEmulationError):
        register()


@pytest.fixture(autouse=True)
def quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    """No line of progress where a slow machine takes long: what a command prints is compared."""
    monkeypatch.setattr("bench.cli.console.SILENCE", math.inf)


@pytest.fixture
def users_settings() -> Callable[[], Any]:
    """A context in which Matplotlib has what a user's matplotlibrc may ask for; there is no LaTeX of that name."""
    import matplotlib

    asked = {"text.usetex": True, "font.size": 21.0, "legend.fontsize": 3.0, "lines.linewidth": 7.0}
    asked |= {"figure.dpi": 40.0, "savefig.bbox": "tight", "savefig.facecolor": "red", "axes.facecolor": "green"}
    asked |= {
        "axes.labelcolor": "red",
        "image.origin": "lower",
        "image.cmap": "hot",
        "axes.prop_cycle": "cycler('color', ['r'])",
    }
    return lambda: matplotlib.rc_context(asked)


@pytest.fixture
def brief(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A cache of its own, and timings of three turns."""
    monkeypatch.setenv("NEUBTF_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("bench.timing.TURNS", 3)


@pytest.fixture
def brief_trade(brief: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """As `brief`, and what a trade times is small."""
    monkeypatch.setattr("bench.runs.trade.BATCH", 256)
    monkeypatch.setattr("bench.timing.roofline.COPIED", 1 << 20)
    monkeypatch.setattr("bench.timing.roofline.SIDE", 64)


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Jobs store nothing to draw: to record a material as a program takes a second."""
    monkeypatch.setattr("bench.runs.job.store_drawing", lambda file, keep: {"not_drawn": "undrawn"})
    monkeypatch.setattr("bench.runs.job.sparse_truth", lambda btf: None)


@pytest.fixture
def decodes_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """In place of the fresh process of a check, which imports PyTorch for two seconds, its script runs in this one.

    It has the codecs of the registry as they are when this fixture starts.
    """
    from bench.codecs import registry

    as_installed = registry.load_codec

    def run(command: list[str], **_: Any) -> subprocess.CompletedProcess[str]:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(registry, "load_codec", as_installed)
            patch.setattr(sys, "argv", ["-c", *command[3:]])
            try:
                exec(command[2], {})
            except Exception as error:  # as the last line of a traceback
                return subprocess.CompletedProcess(command, 1, "", f"{type(error).__name__}: {error}")
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr("bench.conformance.check.subprocess", SimpleNamespace(run=run))


@pytest.fixture
def untimed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs time no decoder: those from outside are timed in a process of their own, which imports PyTorch."""
    monkeypatch.setattr("bench.runs.runner.timings", lambda *_: [])


@pytest.fixture
def gpu() -> Iterator[Any]:
    """An emulated GPU, of which `bench.conformance.emulated` counts the kernels."""
    from bench.conformance.emulated import NoEmulationError, emulated

    try:
        with emulated() as device:
            yield device
    except NoEmulationError as error:
        pytest.skip(str(error))


@pytest.fixture
def ends_alike_when_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[Any, Any], None]:
    """Asserts that a fit of 30 steps that is killed at the 20th goes on to the same file as one that is not."""
    from bench.codec import Fit
    from bench.codecs import container
    from bench.training import fitting as training

    def halt(label: str, done: int, total: int) -> None:
        if label.startswith("fitting") and done == 20:
            raise KeyboardInterrupt

    def held(codec: Any, btf: Any) -> None:
        with pytest.raises(KeyboardInterrupt):
            codec.encode(btf, Fit(show=halt, checkpoint=tmp_path / "state"))
        resumed = codec.encode(btf, Fit(checkpoint=tmp_path / "state"))
        assert container.to_bytes(codec, resumed) == container.to_bytes(codec, codec.encode(btf, Fit()))

    monkeypatch.setattr(training, "KEEP_EVERY", 10)
    monkeypatch.setattr(training, "SAVE_SECONDS", 0.0)
    return held
