import re
import shlex
from pathlib import Path

import pytest

from bench import cli
from tests.bench.outside import install

ROOT = Path(__file__).parents[2]
CODEC = """
from baselines.mean_colour import MeanColour

class Mine(MeanColour):
    name = "mine"
"""


@pytest.mark.long
def test_a_codec_of_one_s_own_stands_beside_the_published_records(tmp_path, monkeypatch, capsys):
    page = (ROOT / "docs" / "sharing.md").read_text(encoding="utf-8")
    block = next(block for block in re.findall(r"^```\n(.*?)^```$", page, re.M | re.S) if "table summary" in block)
    run, table = (shlex.split(line)[1:] for line in block.splitlines())
    site = install(tmp_path / "site", "mine", {"mine": "mine:Mine"}, {"mine": CODEC})
    monkeypatch.syspath_prepend(str(site))
    monkeypatch.setenv("NEUBTF_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("bench.timing.TURNS", 3)
    (tmp_path / "docs").symlink_to(ROOT / "docs")
    monkeypatch.chdir(tmp_path)
    assert cli.main(run) == 0
    capsys.readouterr()
    assert cli.main(table) == 0
    said = capsys.readouterr().out
    rows = {line.split("  ")[0]: line for line in said.splitlines()}
    found = {
        name: re.search(r"2 of 2 +[\d.]+ +\d+ +([\d.]+)", rows[name])[1] for name in ("mine", "mean-colour", "pca")
    }
    assert found["mine"] == found["mean-colour"] < found["pca"]
    assert "Not comparable" not in said
    assert f"neubtf-bench {shlex.join(table)}\n" in (ROOT / "bench" / "cli" / "commands" / "table.py").read_text()
