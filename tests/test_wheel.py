"""The wheel: what users install, without the checkout around it."""

import os
import shutil
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("baselines", "bench", "neubtf", "reports")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"  # a build leaves files beside the source
    for name in PACKAGES:
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*pip, "--wheel-dir", folder, source], check=True)
    (built,) = folder.glob("*.whl")
    return built


def test_it_holds_every_file_of_the_packages(wheel: Path) -> None:
    files = (path for name in PACKAGES for path in (ROOT / name).rglob("*") if path.is_file())
    wanted = {path.relative_to(ROOT).as_posix() for path in files if "__pycache__" not in path.parts}
    with zipfile.ZipFile(wheel) as archive:
        held = {name for name in archive.namelist() if ".dist-info/" not in name}
    assert held == wanted


@pytest.mark.long
@pytest.mark.timeout(1800)  # it downloads PyTorch
def test_it_runs_in_an_environment_that_has_nothing_else(wheel: Path, tmp_path: Path) -> None:
    venv.create(tmp_path / "venv", with_pip=True)
    programs = tmp_path / "venv" / "bin"
    allowed = ["--constraint", str(ROOT / "constraints.txt")]
    subprocess.run([programs / "pip", "install", "--quiet", *allowed, wheel], check=True)
    left_out = ("PYTHONPATH", "PYTHONHOME", "NEUBTF_DATA")
    environment = {name: value for name, value in os.environ.items() if name not in left_out}
    environment["NEUBTF_CACHE"] = str(tmp_path / "cache")
    words = ["run", "quick", "--material", "satin", "--codec", "mean-colour", "--jobs", "1", "--out", "run"]
    done = subprocess.run(
        [programs / "neubtf-bench", *words], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "1 jobs: 1 ok" in done.stdout
    assert (tmp_path / "run" / "report.html").is_file()
