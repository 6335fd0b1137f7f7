"""A reader of another package: opens, is listed; what is wrong with one is one line that names it."""

import re
import subprocess
import sys
import tomllib

import numpy as np
import pytest

import bench
from bench import cli
from bench.data import readers
from bench.data.readers import open_btf, outside
from bench.inputs.errors import InputError
from bench.inputs.plugins import PluginError
from tests.bench.outside import install

SOURCE = '''
"""One `grey` texel."""

import numpy as np
from bench.btf import BTF, ArraySource

def opened(seen):
    if not seen.head.startswith(b"grey"):
        return None
    rows = np.loadtxt(seen.path, np.float32, skiprows=1, ndmin=2)
    source = ArraySource(rows[:, 6:][:, None, None])
    return BTF(seen.path.stem, rows[:, :3], rows[:, 3:6], source, provenance={"format": "grey"})
'''
PAIRS = [(0, 0, 1), (0.6, 0, 0.8), (0, 0.6, 0.8), (-0.6, 0, 0.8)]


@pytest.fixture
def installed(tmp_path, monkeypatch):
    def make(source, name="grey", package="greys"):
        site = install(tmp_path / package, package, {name: "grey_reader"}, {"grey_reader": source}, outside.GROUP)
        monkeypatch.syspath_prepend(str(site))
        monkeypatch.delitem(sys.modules, "grey_reader", raising=False)
        return site

    yield make
    sys.modules.pop("grey_reader", None)


@pytest.fixture
def file(tmp_path):
    """Four views by four lights of one grey texel."""
    rows = [[*wo, *wi, 0.2, 0.3, 0.4] for wo in PAIRS for wi in PAIRS]
    np.savetxt(tmp_path / "some.grey", rows, header="grey", comments="")
    return tmp_path / "some.grey"


def test_it_opens_files_and_lists_show_it(installed, file):
    installed(SOURCE)
    btf = bench.open(file)
    assert (len(btf), btf.shape) == (16, (1, 1))
    assert readers.listed()["grey"] == "One `grey` texel."
    other = file.with_name("other")
    other.write_text("other")
    with pytest.raises(InputError, match=r"b'other'.*reader grey"):
        open_btf(other)


def test_files_of_built_in_formats_import_none(installed, file):
    installed("1 / 0")
    arrays = {"radiance": np.ones((1, 1, 1, 3), np.float32), "wo": [PAIRS[0]], "wi": [PAIRS[0]]}
    np.savez(file.with_name("a.npz"), **arrays)
    assert len(open_btf(file.with_name("a.npz"))) == 1
    assert re.search("FAILS: .*greys.*ZeroDivisionError", readers.listed()["grey"])


@pytest.mark.long
@pytest.mark.usefixtures("brief", "undrawn")
def test_run_encode_and_list_take_it(installed, file, tmp_path, capsys):
    installed(SOURCE)
    said = []
    for words in (
        ["list", "readers"],
        ["encode", file, "--codec", "mean-colour", "-o", tmp_path / "a.nbtf"],
        ["run", "quick", "--material", file, "--codec", "mean-colour", "--out", tmp_path / "run"],
        ["table", "main", tmp_path / "run"],
    ):
        assert cli.main([*map(str, words)]) == 0
        said.append(capsys.readouterr().out)
    assert "One `grey`" in said[0]
    assert "some" in said[-1]


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("import numpy", "import no_such_module, numpy", "ModuleNotFound.*uninstall greys"),
        ("def opened", "def open", "grey_reader.*`opened`"),
        ("rows = np", "rows = 1 / 0, np", "ZeroDivisionError"),
        ("return BTF(", "return repr(seen) or BTF(", r"opened.*\bstr\b.*\bBTF\b"),
        ("ArraySource(rows", "Odd(rows", r"\(3,\) float64.*\(1, 1, 3\) float32"),
        ("ndmin=2)", "ndmin=2)[:0]", "IndexError"),
        ("ArraySource(rows", "Listed(rows", r"slice 0 is a list.*\(1, 1, 3\) float32"),
    ],
)
def test_what_is_wrong_with_it_is_one_line_that_names_it_and_the_file(installed, file, old, new, says):
    odd = "\nclass Odd(ArraySource):\n    def slice(self, pair):\n        return np.ones(3)\n"
    odd += "\nclass Listed(ArraySource):\n    def slice(self, pair):\n        return [[[1.0, 1.0, 1.0]]]\n"
    assert old in SOURCE
    installed(SOURCE.replace(old, new) + odd)
    with pytest.raises(InputError, match=rf"some\.grey: .*reader grey.*greys.*{says}") as raised:
        open_btf(file)
    assert "\n" not in str(raised.value)


def test_the_name_of_a_built_in_reader_is_refused(installed, file):
    installed(SOURCE, "npz")
    with pytest.raises(PluginError, match=r"reader npz.*greys"):
        open_btf(file)
    assert "FAILS: reader" in " ".join(readers.listed().values())


@pytest.mark.long
def test_a_new_reader_is_a_package_whose_test_passes(installed, tmp_path):
    assert cli.main(["new", "reader", "my-format", "--out", str(tmp_path)]) == 0
    folder = tmp_path / "my-format-reader"
    project = tomllib.loads((folder / "pyproject.toml").read_text())["project"]
    assert project["entry-points"][outside.GROUP] == {"my-format": "my_format_reader"}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    installed((folder / "my_format_reader.py").read_text(), "my-format")
    (tmp_path / "a.txt").write_text("my-format\n0 0 1 0 0 1 .1 .2 .3\n")
    assert len(open_btf(tmp_path / "a.txt")) == 1
    assert cli.main(["new", "reader", "my-format", "--out", str(tmp_path / "again")]) == 2
