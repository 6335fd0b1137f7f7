"""The walk-through of docs/adding-a-codec.md, taken from the page itself and installed as a package of its own."""

import importlib
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "adding-a-codec.md"


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("outside")
    (folder / "source").mkdir()
    (folder / "source" / "ptm_codec.py").write_text(blocks("python")[0], encoding="utf-8")
    (folder / "source" / "pyproject.toml").write_text(blocks("toml")[0], encoding="utf-8")
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*pip, "--target", folder / "site", folder / "source"], check=True)
    return os.environ | {"PYTHONPATH": str(folder / "site"), "NEUBTF_CACHE": str(folder / "cache")}


def neubtf_bench(environment, *words):
    command = [sys.executable, "-m", "bench.cli", *map(str, words)]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


def test_the_example_is_whole_and_at_most_forty_lines():
    lines = [line for line in blocks("python")[0].splitlines() if line.strip()]
    assert len(lines) <= 40


def test_the_package_is_listed_with_its_description(installed):
    listed = neubtf_bench(installed, "list", "codecs").stdout
    assert re.search(r"^  ptm +Polynomial texture map: a quadratic of the light a texel", listed, re.M)


def test_the_package_passes_the_conformance_test(installed):
    done = neubtf_bench(installed, "check", "ptm")
    assert done.returncode == 0, done.stdout
    assert "FAIL" not in done.stdout
    assert "every check passed" in done.stdout
    half = neubtf_bench(installed, "check", "ptm", "--set", "half=false")
    assert half.returncode == 0, half.stdout


def test_its_files_are_refused_by_name_where_it_is_not_installed(installed, tmp_path):
    file = tmp_path / "a.nbtf"
    size = [part for key in ("size=8", "views=4", "lights=4", "heldout=2") for part in ("--set", f"data.{key}")]
    done = neubtf_bench(installed, "encode", "satin", "--codec", "ptm", "-o", file, *size)
    assert done.returncode == 0, done.stderr
    without = neubtf_bench(installed | {"PYTHONPATH": ""}, "info", file)
    assert without.returncode == 2
    assert "no codec named 'ptm' is installed" in without.stderr


def test_the_public_interface_holds_what_the_page_lists():
    rows = re.findall(r"^\| `(bench[\w.]*)` \| (.*) \|$", PAGE.read_text(encoding="utf-8"), re.M)
    assert len(rows) > 8
    for module, text in rows:
        for name in re.findall(r"`(\w+)`", text):
            assert hasattr(importlib.import_module(module), name), f"{module}.{name}"
