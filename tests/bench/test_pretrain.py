import re

import pytest

from bench import cli
from bench.btf.npz import write_npz
from bench.codecs import shared
from bench.conformance.check import others, tiny_btf
from bench.inputs.errors import InputError
from bench.runs.library import pretrain

BRIEF = ["--materials", "0", "--steps", "2", "--set", "texels=2", "--set", "pairs=2", "--set", "kept=8"]


@pytest.fixture(autouse=True)
def places(tmp_path, monkeypatch):
    monkeypatch.setenv("NEUBTF_SHARED", str(tmp_path / "shared"))
    monkeypatch.setenv("NEUBTF_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def measured(tmp_path):
    paths = [tmp_path / "one.npz", tmp_path / "two.npz"]
    for path, btf in zip(paths, others(tiny_btf(4, 4, 4)), strict=False):
        write_npz(btf, path)
    return [str(path) for path in paths]


@pytest.mark.long
def test_pretrain_encode_info_and_decode(measured, tmp_path, capsys):
    one, two = measured
    encode = ["encode", two, "--codec", "rainer2020", "-o", "two.nbtf"]
    assert cli.main(encode) == 0, "by the network that the package ships"
    assert "networks/rainer2020.nbtf" in capsys.readouterr().out
    assert cli.main(["pretrain", "rainer2020", "--add", one, *BRIEF]) == 0
    said = capsys.readouterr().out
    assert str(shared.place("rainer2020")) in said
    assert re.search("^trained_on .*: 1$", said, re.M)
    assert cli.main(encode) == 0
    network = shared.find("rainer2020")
    assert f"path: {network.path}\n    bytes: {network.file_bytes:,}\n" in capsys.readouterr().out
    assert cli.main(["info", str(network.path)]) == 0
    assert "no material" in capsys.readouterr().out
    assert cli.main(["decode", "two.nbtf", "--count", "1", "-o", "slices"]) == 0
    assert len(list((tmp_path / "slices").glob("*.exr"))) == 1
    assert cli.main(["decode", str(network.path), "-o", "none"]) == 2


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["pretrain", "pca"], "codec pca shares no network over materials"),
        (["pretrain", "rainer2020", "--materials", "0"], "at least one training material"),
        (["pretrain", "rainer2020", "--set", "step=3"], "no setting 'step'; did you mean 'steps'?"),
        (["pretrain", "rainer2021"], "did you mean"),
        (["pretrain", "rainer2020", "--steps", "3", "--set", "steps=5"], "they are the same: give only one"),
    ],
)
def test_what_cannot_be_pretrained_is_explained(words, message, capsys):
    assert cli.main(words) == 2
    assert message in capsys.readouterr().err


def test_a_count_below_zero_is_refused_however_many_materials_are_added(tmp_path):
    with pytest.raises(InputError, match=r"-1 variations and 3 BTFs: .* no number below 0"):
        pretrain(None, None, tmp_path / "n.nbtf", -1, [tiny_btf(4, 4, 4)] * 3)
