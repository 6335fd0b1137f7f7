import re
import shlex
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import bench
from bench import cli
from bench.conformance.check import tiny_btf
from bench.data.readers.folder import write_folder
from bench.records import load_run
from tests.bench.outside import install

PAGE = Path(__file__).parents[2] / "docs" / "api.md"
STUDENT, STUDIO = (part for part in PAGE.read_text(encoding="utf-8").split("\n## ") if "'s way" in part[:20])


def blocks(text, language=""):
    found = re.findall(r"^```(\w*)\n(.*?)^```$", text, re.S | re.M)
    return [block for kind, block in found if kind == language]


@pytest.fixture(autouse=True)
def small(tmp_path, monkeypatch, brief):
    monkeypatch.chdir(tmp_path)


@pytest.mark.long
def test_a_student_comes_from_arrays_and_a_codec_to_a_table_of_latex(tmp_path, monkeypatch, capsys):
    exec(blocks(STUDENT, "python")[0], {})
    assert len(bench.open("cloth.npz")) == 33
    site = ""
    for line in blocks(STUDENT)[0].splitlines():
        words = shlex.split(line)
        if words[0] == "pip":  # what it does, without the network
            source = tmp_path / words[-1]
            (module,) = source.glob("*.py")
            (entry,) = re.findall(r'^mine = "(.*)"$', (source / "pyproject.toml").read_text(), re.M)
            site = str(install(tmp_path / "site", "mine", {"mine": entry}, {module.stem: module.read_text()}))
            monkeypatch.syspath_prepend(site)
            monkeypatch.setenv("PYTHONPATH", site, prepend=":")
            continue
        words, place = (words[:-2], words[-1]) if ">" in words else (words, "")
        assert cli.main(words[1:]) == 0, line
        said = capsys.readouterr().out
        if place:
            (tmp_path / place).write_text(said)
    assert site
    table = (tmp_path / "summary.tex").read_text()
    assert re.search(r"^Ours & ", table, re.M)
    assert list((tmp_path / "runs/mine/figures").glob("*.pdf"))
    article = blocks(STUDENT, "latex")[0]
    (tmp_path / "a.tex").write_text(article)
    packages = re.search(r"% needs \\usepackage\{(.*)\}", table)[1]
    assert rf"\usepackage{{{packages}}}" in article
    assert re.search(r"\\label\{(.*)\}", table)[1] == re.search(r"\\ref\{(.*)\}", article)[1]
    if not shutil.which("pdflatex"):
        pytest.skip("the last step alone, to compile a.tex: pdflatex is not installed")
    done = subprocess.run(["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "a.tex"], capture_output=True)
    assert done.returncode == 0, done.stdout[-2000:]


@pytest.mark.long
def test_a_studio_comes_from_maps_to_a_shader_and_its_bytes_on_a_gpu(tmp_path, capsys):
    wave = np.sin(np.linspace(0, 2 * np.pi, 16, endpoint=False))
    (tmp_path / "maps").mkdir()
    for name, levels in {
        "cloth_color": np.dstack([120 + 80 * np.outer(wave, wave)] * 3),
        "cloth_roughness": 128 + 60 * np.outer(wave, wave),
    }.items():
        Image.fromarray(levels.astype(np.uint8)).save(tmp_path / "maps" / f"{name}.png")
    (tmp_path / "small.toml").write_text(blocks(STUDIO, "toml")[0])
    choose, *look, export = map(shlex.split, blocks(STUDIO)[0].splitlines())
    assert cli.main(choose[1:]) == 0
    command = shlex.split(capsys.readouterr().out.splitlines()[-1])
    assert command[:2] == ["neubtf-bench", "encode"]
    assert cli.main(command[1:]) == 0
    assert [cli.main(words[1:]) for words in look] == [0, 0]
    assert (tmp_path / "maps.html").exists()
    assert (tmp_path / "maps.png").exists()
    assert cli.main(export[1:]) == 0
    said = capsys.readouterr().out
    (held,) = re.findall(r"^([\d,]+) bytes of textures on a GPU", said, re.M)
    assert int(held.replace(",", "")) > 0
    assert "material(" in (tmp_path / "shader" / "maps.glsl").read_text()


@pytest.mark.long
def test_twenty_scattered_pairs_in_a_folder_are_run_and_drawn(tmp_path):
    chosen = np.random.default_rng(0).choice(81, 20, replace=False)
    write_folder(tiny_btf(16).subset(chosen), tmp_path / "own")
    words = ["run", "quick", "--material", str(tmp_path / "own"), "--codec", "pca", "--codec", "mean-colour"]
    assert cli.main([*words, "--out", str(tmp_path / "run")]) == 0
    assert all("drawing" in job for job in load_run(tmp_path / "run").jobs)
    assert [*(tmp_path / "run").glob("drawings/truth-*.npz")]
