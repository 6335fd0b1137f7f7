import importlib
import inspect
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from bench import cli, training
from bench.codec import Fit
from bench.conformance.check import tiny_btf
from bench.data.readers.folder import write_folder
from bench.records import load_run
from bench.runs.suite import load_suite
from tests.bench.outside import install

PAGE = Path(__file__).parents[2] / "docs" / "adding-a-codec.md"


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("outside")
    (folder / "source").mkdir()
    (folder / "source" / "polynomial_codec.py").write_text(blocks("python")[0], encoding="utf-8")
    (folder / "source" / "pyproject.toml").write_text(blocks("toml")[0], encoding="utf-8")
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*pip, "--target", folder / "site", folder / "source"], check=True)
    return os.environ | {"PYTHONPATH": str(folder / "site"), "NEUBTF_CACHE": str(folder / "cache")}


def neubtf_bench(environment, *words):
    command = [sys.executable, "-m", "bench.cli", *map(str, words)]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


@pytest.mark.long
def test_its_files_are_refused_by_name_where_it_is_not_installed(installed, tmp_path):
    file = tmp_path / "a.nbtf"
    size = [part for key in ("size=8", "views=4", "lights=4", "heldout=2") for part in ("--set", f"data.{key}")]
    done = neubtf_bench(installed, "encode", "satin", "--codec", "polynomial", "-o", file, *size)
    assert done.returncode == 0, done.stderr
    assert re.search(r"^  polynomial +\w", neubtf_bench(installed, "list", "codecs").stdout, re.M)
    without = neubtf_bench(installed | {"PYTHONPATH": ""}, "info", file)
    assert without.returncode == 2
    assert "'polynomial'" in without.stderr


def test_the_public_interface_holds_what_the_page_lists():
    rows = re.findall(r"^\| `(bench[\w.]*)` \| (.*) \|$", PAGE.read_text(encoding="utf-8"), re.M)
    assert len(rows) > 8
    for module, text in rows:
        for name in re.findall(r"`(\w+)`", text):
            assert hasattr(importlib.import_module(module), name), f"{module}.{name}"


def installed_here(folder, monkeypatch, name, place, module, text):
    """Makes a codec one of this process."""
    site = install(folder / "site", "mine", {name: place}, {module: text})
    monkeypatch.syspath_prepend(str(site))
    monkeypatch.delitem(sys.modules, module, raising=False)


@pytest.mark.long
@pytest.mark.usefixtures("decodes_here")
def test_a_new_codec_is_the_one_of_the_page_and_passes_the_conformance_test(tmp_path, monkeypatch):
    assert cli.main(["new", "codec", "polynomial", "--out", str(tmp_path)]) == 0
    written = {path.name: path.read_text() for path in (tmp_path / "polynomial-codec").iterdir()}
    assert written["polynomial_codec.py"] == blocks("python")[0]
    assert written["pyproject.toml"] == blocks("toml")[0]
    assert cli.main(["new", "codec", "my-codec", "--out", str(tmp_path)]) == 0
    text = (tmp_path / "my-codec-codec" / "my_codec_codec.py").read_text()
    installed_here(tmp_path, monkeypatch, "my-codec", "my_codec_codec:MyCodec", "my_codec_codec", text)
    assert cli.main(["check", "my-codec"]) == 0


class KilledError(Exception):
    pass


@pytest.fixture
def neural(tmp_path, monkeypatch):
    """The codec of `new codec --neural`, installed."""
    assert cli.main(["new", "codec", "my-net", "--neural", "--out", str(tmp_path)]) == 0
    text = (tmp_path / "my-net-codec" / "my_net_codec.py").read_text()
    assert 'my-net = "my_net_codec:MyNet"' in (tmp_path / "my-net-codec" / "pyproject.toml").read_text()
    installed_here(tmp_path, monkeypatch, "my-net", "my_net_codec:MyNet", "my_net_codec", text)


@pytest.mark.long
@pytest.mark.usefixtures("brief", "undrawn", "neural")
def test_a_new_neural_codec_is_run(tmp_path):
    write_folder(tiny_btf(12, 6, 6), tmp_path / "btf")
    words = ["run", "quick", "--material", str(tmp_path / "btf"), "--codec", "my-net", "--set", "my-net.steps=120"]
    assert cli.main([*words, "--out", str(tmp_path / "run")]) == 0  # the first job of a new folder
    assert load_run(tmp_path / "run").jobs[0]["status"] == "ok"


@pytest.mark.usefixtures("neural", "decodes_here")
@pytest.mark.long
def test_a_new_neural_codec_passes_the_test_and_a_killed_fit_of_it_goes_on(tmp_path):
    assert cli.main(["check", "my-net"]) == 0
    codec = importlib.import_module("my_net_codec").MyNet(steps=400, batch=64, latents=2, width=8)

    def parts(fit):
        found = codec.encode(tiny_btf(), fit)
        return [value for part in (found.decoder, found.texture, found.other) for value in part.values()]

    def kills(label, done, total):
        if done == 350:
            raise KilledError

    whole = Fit()
    wanted = parts(whole)
    assert [point["step"] for point in whole.history] == [100, 200, 300, 400]
    assert {"psnr", "seconds"} <= whole.history[0].keys()
    state = tmp_path / "state"
    with pytest.raises(KilledError):
        parts(Fit(checkpoint=state, show=kills))
    shown = []
    found = parts(Fit(checkpoint=state, show=lambda *told: shown.append(told)))
    assert ("fitting", 100, 100) in shown  # of 400 steps, 300 were done
    assert all(torch.equal(ours, theirs) for ours, theirs in zip(wanted, found, strict=True))


def test_ci_installs_the_codec_from_where_new_codec_put_it(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["new", "codec", "polynomial"]) == 0
    assert cli.main(["new", "ci", "polynomial"]) == 0
    assert "pip install ./neubtf-bench ./polynomial-codec --extra" in Path(".github/workflows/quality.yml").read_text()
    assert len(load_suite("tracking.toml").seeds) == 6
    assert cli.main(["new", "ci", "polynomial", "--neural"]) == 2
    assert "--neural: " in capsys.readouterr().err


def test_new_files_of_ci_are_a_suite_and_a_workflow(tmp_path, capsys):
    assert cli.main(["new", "ci", "pca", "--out", str(tmp_path)]) == 0
    suite = load_suite(str(tmp_path / "tracking.toml"))
    assert [spec.codec for spec in suite.codecs] == ["pca"]
    assert suite.data.split == "validation"  # or margins would be those of pairs, ten times those of fits
    flow = (tmp_path / ".github" / "workflows" / "quality.yml").read_text()
    assert "${{ !cancelled() }}" in flow
    steps = re.findall(r"run: (?:>-\n)?((?:.|\n {10})*)", flow)
    (installs,) = (step.split()[2:] for step in steps if step.startswith("pip install"))
    sources = installs[: next(i for i, word in enumerate(installs) if word.startswith("--"))]
    assert sources == ["./neubtf-bench", "."]  # a path or a Git URL each: no index has the suite
    assert all(re.match(r"\.|git\+https://", source) for source in sources)
    assert "submodules: true" in flow  # or the clone of the suite would be an empty folder
    commands = [" ".join(step.split()).split()[1:] for step in steps if step.split()[0] == "neubtf-bench"]
    assert [words[0] for words in commands] == ["run", "compare"]
    for words in commands:
        cli.parser(words[:1]).parse_args(words)
    check = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", "vendor.github-workflows"]
    done = subprocess.run([*check, tmp_path / ".github/workflows/quality.yml"], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert cli.main(["new", "ci", "pca", "--out", str(tmp_path)]) == 2
    assert "tracking.toml: " in capsys.readouterr().err
    assert cli.main(["new", "codec", "pca"]) == 2
    assert cli.main(["new", "codec", "My Codec"]) == 2


@pytest.mark.parametrize(("name", "class_name"), [("none", "None"), ("parts", "Parts")])
def test_a_new_codec_needs_a_class_name_that_is_free(name, class_name, tmp_path, capsys):
    assert cli.main(["new", "codec", name, "--out", str(tmp_path)]) == 2
    assert f"new codec {name}: its class cannot be called {class_name}" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_the_page_names_every_function_of_training():
    functions = [name for name, each in vars(training).items() if inspect.isfunction(each)]
    assert len(functions) > 15
    assert [name for name in functions if f"`{name}`" not in PAGE.read_text(encoding="utf-8")] == []
