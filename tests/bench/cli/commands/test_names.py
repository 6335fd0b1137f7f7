"""Names of files, materials and codecs of others neither steer a terminal nor command a CI service."""

import numpy as np
import pytest

from bench import cli
from bench.conformance.check import tiny_btf
from tests.bench.outside import install

NAME = "a\x1b[2Jb\n::error::x"
WRITTEN_OUT = r"a\x1b[2Jb\n::error::x"

pytestmark = pytest.mark.usefixtures("brief", "undrawn")


@pytest.fixture
def hostile(tmp_path, monkeypatch):
    """A measured material of that name in the working directory; returns its file."""
    monkeypatch.chdir(tmp_path)
    btf = tiny_btf(16, 6, 6)
    np.savez(f"{NAME}.npz", radiance=np.stack(list(btf)), wo=btf.wo, wi=btf.wi)
    return f"{NAME}.npz"


def said(capsys, shown=WRITTEN_OUT):
    """What was printed; no line of it steers or commands, and the name is written out."""
    captured = capsys.readouterr()
    text = captured.out + captured.err
    assert "\x1b" not in text
    assert not [line for line in text.splitlines() if line.lstrip().startswith(("::", "##"))]
    assert shown in text
    return text


@pytest.mark.long
def test_of_a_file_that_is_shown_encoded_scored_and_exported(hostile, capsys):
    assert cli.main(["info", hostile, "--picture", f"{NAME}.png"]) == 0
    assert f"wrote {WRITTEN_OUT}.png" in said(capsys)
    assert cli.main(["encode", hostile, "--codec", "pca", "-o", f"{NAME}.nbtf"]) == 0
    said(capsys)
    assert cli.main(["info", f"{NAME}.nbtf"]) == 0
    said(capsys)
    assert cli.main(["score", f"{NAME}.nbtf", hostile, "--json", f"{NAME}.json"]) == 0
    assert f"wrote {WRITTEN_OUT}.json" in said(capsys)
    assert cli.main(["export", f"{NAME}.nbtf", "-o", NAME]) == 0
    said(capsys)
    assert cli.main(["score", f"{NAME}.nbtf", f"{NAME}.btf"]) == 2
    said(capsys)


@pytest.mark.long
def test_of_a_material_that_is_chosen_for(hostile, tmp_path, brief_trade, capsys):
    (tmp_path / "own.toml").write_text('materials = []\ndata = {validation = true}\ncodecs = [{codec = "pca"}]\n')
    words = ["choose", hostile, "--suite", "own.toml", "--out", f"r{NAME}", "-o", f"{NAME}.nbtf"]
    assert cli.main([*words, "--max-bytes", "1M"]) == 0
    assert f"\nwrote {WRITTEN_OUT}.nbtf\n" in said(capsys)
    assert cli.main([*words, "--min-psnr", "99"]) == 1
    assert f"{WRITTEN_OUT}.npz: " in said(capsys)


CODEC = '''
from dataclasses import dataclass

from bench.codec import Codec


class Mine(Codec):
    """Mine \\x1b[2J is best."""

    name, version = "mine", 1

    @dataclass(frozen=True)
    class Settings:
        word: str = "\\x1b[2J\\n::error::x"  # any

    def encode(self, btf, fit):
        raise RuntimeError("\\x1b[2J\\n::error::x")

    def decode(self, parts, device): ...
'''


def test_of_a_codec_that_is_listed_and_stressed(tmp_path, monkeypatch, capsys):
    site = str(install(tmp_path / "site", "mine", {"mine": "mine_codec:Mine"}, {"mine_codec": CODEC}))
    monkeypatch.syspath_prepend(site)
    monkeypatch.setenv("PYTHONPATH", site, prepend=":")
    assert cli.main(["list", "codecs"]) == 0
    said(capsys, r"Mine \x1b[2J is best.")
    assert cli.main(["list", "codecs", "mine"]) == 0
    said(capsys, r"\x1b[2J\n::error::x")
    assert cli.main(["stress", "--codec", "mine", "--data", "4 4 2 2 0 1"]) == 1
    said(capsys, r"FAIL  mine: ")
    words = ["stress", "--codec", "mine", "--case", "two constants", "--jobs", "1", "--out", str(tmp_path / NAME)]
    assert cli.main(words) == 1
    said(capsys)
