"""The examples of help texts run on the files that they name: tiny ones of these names, and a small run of `quick`."""

import importlib
import os
import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from ubo2014_write import factorise

from bench import cli
from bench.cli import commands
from bench.conformance.check import tiny_btf
from bench.data.readers.folder import write_folder
from tests.bench.demand.mitsuba.test_path_tracer import with_mitsuba
from tests.bench.demand.mitsuba.test_scene import CAMERA, LAMP
from tests.bench.outside import install

ROOT = Path(__file__).parents[3]
REFERENCES = "bench/compare/references"
QUICK = ("new", "list", "bake", "info", "convert", "export")
TINY = "--set data.size=8 --set data.views=6 --set data.lights=6 --set data.heldout=8"
SMALL = "--set data.size=16"
# In this order, a command finds what another one wrote.
ORDER = [
    "new",
    "list",
    "run",
    "time",
    "bake",
    "pretrain",
    "encode",
    "propagate",
    "latents",
    "decode",
    "score",
    "info",
    "convert",
    "view",
    "render",
    "export",
    "table",
    "figure",
    "report",
    "history",
    "trade",
    "choose",
    "check",
    "stress",
    "compare",
    "results",
]
# By the beginning of an example, the longest counts: options that make it small; these replace the example's own.
SMALLER = {
    # The least size in which the inset of an example lies, at the directions of `quick`, whose pairs examples name.
    "run quick": "--material satin --codec pca --codec neumip --codec neubtf-direct --set steps=2 --set data.size=36",
    "run quick --material PATH": "",
    "run quick --material satin": "--set neumip.steps=2 --set data.size=8",
    "run budgets": f"--material satin --codec pca --jobs 1 {TINY}",
    "bake": "--size 8 --views 6 --lights 6 --heldout 8",
    "pretrain": "--steps 2 --materials 2",
    "encode cable-knit": SMALL,
    "encode satin": SMALL,
    "score": SMALL,
    "score small.nbtf": "",
    "view satin.nbtf --truth satin": SMALL,
    "render": "--width 16 --rays 1",
    "render satin.nbtf --truth satin": f"--width 16 --rays 1 {SMALL}",
    "render satin.nbtf --scene kitchen.xml": "--samples 1",
    "time": f"--material satin --codec pca --device cpu --minutes 0.1 {TINY}",
    "trade": f"--codec mean-colour {TINY}",
    "trade --material satin --codec neumip": f"--set steps=2 {TINY}",
    "trade --material satin --codec pca": f"--set components=4 {TINY}",
    "choose": "--codec pca --jobs 1 --suite tiny.toml",
    "stress": "--codec pca --cheap --jobs 1",
    "stress --codec my-codec": "--jobs 1",
}
SUITE = """materials = ["satin"]
[data]
size = 8
views = 6
lights = 6
heldout = 8
validation = true
[[codecs]]
codec = "pca"
components = [4, 8]
[[codecs]]
codec = "neumip"
"""


def examples() -> list[list[str]]:
    """The words of each example of the help texts, first those of the program itself."""
    shown = [*cli.EVERYDAY.splitlines()]
    for module in commands.modules().values():
        _, _, of_command = (importlib.import_module(module).__doc__ or "").partition(cli.EXAMPLES)
        assert of_command, module
        shown += of_command.splitlines()
    lines = [shlex.split(re.split(" {4,}", line.strip())[0]) for line in shown]
    return [words[1:] for words in lines if words[:1] == ["neubtf-bench"] and words[1] != "COMMAND"]


def smaller(words: list[str]) -> list[str]:
    line = " ".join(words)
    start = max((start for start in SMALLER if line.startswith(start)), key=len, default="")
    added = SMALLER.get(start, "").split()
    kept = list(words)
    once = {word for word in added if word.startswith("--")} - {"--set", "--codec", "--material"}
    for option in once & {*kept}:
        place = kept.index(option)
        del kept[place : place + 2]
    return [*kept, *added]


def expanded(words: list[str]) -> list[str]:
    """As a shell does: the folders that `runs/*` stands for."""
    found = []
    for word in words:
        found += sorted(map(str, Path().glob(word))) if "*" in word else [word]
    return found


def made() -> None:
    """The files that examples name, tiny, in the current folder."""
    write_folder(tiny_btf(8, 6, 6), Path("PATH"))
    factorise(tiny_btf(128, 6, 6), "material.btf", 4)
    Path("data").mkdir()
    factorise(tiny_btf(8, 6, 6), "data/carpet07.btf", 4)
    Image.new("RGB", (16, 16), (90, 120, 30)).save("wall.jpg")
    grey = Image.fromarray(np.linspace(0, 255, 64).astype(np.uint8).reshape(8, 8))
    for folder, names in {"Bricks076_2K": ["Color", "Roughness", "Displacement"], "scan": ["photo", "grey"]}.items():
        Path(folder).mkdir()
        for name in names:
            grey.convert("RGB").save(f"{folder}/{folder}_{name}.png" if folder != "scan" else f"scan/{name}.png")
    for file, name in {"room.xml": "sofa", "kitchen.xml": "cloth"}.items():
        cloth = f'<bsdf type="diffuse" id="{name}"/><shape type="rectangle"><ref id="{name}"/></shape>'
        Path(file).write_text(f'<scene version="3.0.0"><integrator type="direct"/>{CAMERA}{cloth}{LAMP}</scene>')
    Path("tiny.toml").write_text(SUITE)
    shutil.copytree(ROOT / "docs" / "results", "docs/results")
    shutil.copy(ROOT / "docs" / "results.md", "docs")
    shutil.copy(ROOT / "README.md", "README.md")


def before(words: list[str]) -> None:
    """What an example needs that no other one makes."""
    line = " ".join(words)
    if words[0] == "list" and not any(Path("site").iterdir()):
        text = Path("my-codec-codec/my_codec_codec.py").read_text()
        install(Path("site"), "mine", {"my-codec": "my_codec_codec:MyCodec"}, {"my_codec_codec": text})
        importlib.invalidate_caches()
    elif line.startswith("decode satin.nbtf --maps"):
        maps = f"encode satin --codec svbrdf --set steps=2 {SMALL} -o satin.nbtf"
        assert cli.main(maps.split()) == 0
    elif line.startswith("score small.nbtf"):
        assert cli.main(["encode", "satin", "--codec", "pca", "--set", "data.size=32", "-o", "small.nbtf"]) == 0
        shutil.copy("small.nbtf", "large.nbtf")
    elif line.startswith("propagate"):
        picture = "encode brick --codec neubtf --set keep_encoder=true --set steps=2 --set data.size=16 -o brick.nbtf"
        assert cli.main(picture.split()) == 0
    elif line.startswith("history") and not Path("runs/before").exists():
        for name in ("before", "after"):
            shutil.copytree("runs/quick", f"runs/{name}")
    elif line == "compare runs/ci --update":
        small = ["--material", "satin", "--codec", "pca", "--codec", "mean-colour", "--set", "data.size=8"]
        assert cli.main(["run", "ci", *small]) == 0
    elif line.startswith("results pack runs/mine"):
        assert (
            cli.main(["run", "quick", "--material", "data/carpet07.btf", "--codec", "pca", "--out", "runs/mine"]) == 0
        )
    elif line.startswith("results add"):  # this run is of other data than the published one
        Path(words[-1]).unlink()
    elif line.startswith("results write docs"):
        shutil.copytree(ROOT / "docs" / "results", "docs/results", dirs_exist_ok=True)
    elif line == "results verify mine.zip":
        shutil.rmtree("runs/mine")  # of those who packed it; who verifies has none


@pytest.fixture
def scratch(tmp_path, monkeypatch, brief_trade):
    """A folder with the files that examples name; nothing is written outside, and no browser is opened."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("NEUBTF_DATA", str(tmp_path))
    (tmp_path / "site").mkdir()  # before it is on the path: Python remembers which folders are not there
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path / "site"), str(ROOT)]))
    monkeypatch.setattr("webbrowser.open", lambda place: True)
    monkeypatch.setattr("bench.cli.commands.compare.committed", lambda suite: Path(f"{REFERENCES}/{suite}.jsonl"))
    made()


def codes_but_fine(chosen: list[list[str]]) -> dict[str, int]:
    """The exit codes other than 0 of some examples, by their line, when they run one after another."""
    codes = {}
    for words in sorted(chosen, key=lambda words: ORDER.index(words[0])):
        before(words)
        codes[" ".join(words)] = cli.main(smaller(expanded(words)))
    # A machine may be too slow for the time that an example of `choose` allows: its verdict is 1 then.
    return {line: code for line, code in codes.items() if code not in ((0, 1) if line.startswith("choose") else (0,))}


def test_every_example_of_every_help_text_is_a_command_that_parses():
    for words in examples():
        cli.parser(words).parse_args(words)
    assert len(examples()) > 40
    assert {words[0] for words in examples()} == {*ORDER}


@pytest.mark.long
def test_the_examples_of_quick_commands_run(scratch):
    quick = [words for words in examples() if words[0] in QUICK or words[:2] == ["encode", "satin"]]
    assert codes_but_fine(quick) == {}


@with_mitsuba
@pytest.mark.long
@pytest.mark.timeout(1800)
def test_every_example_of_every_help_text_runs(scratch):
    assert codes_but_fine(examples()) == {}
