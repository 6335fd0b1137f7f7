import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fuzz_readers import READERS

from bench.data import readers
from bench.data.readers import open_btf
from bench.data.readers.files import list_folder


def test_a_folder_is_listed_three_levels_deep(tmp_path):
    (tmp_path / "a" / "b" / "c").mkdir(parents=True)
    for name in ("x", "a/x", "a/b/x", "a/b/c/x"):
        (tmp_path / name).write_text("")
    assert list_folder(tmp_path) == ["a/b/x", "a/x", "x"]


@pytest.mark.parametrize("name", READERS)
def test_a_reader_is_chosen_by_content_and_splits_are_disjoint(samples, tmp_path, monkeypatch, name):
    monkeypatch.setattr(samples, "ANGLES", [(0, 0), (15, 0), (15, 60), (30, 120), (75, 315)])
    path = samples.READERS[name](tmp_path)
    if path.is_file():
        path = path.rename(tmp_path / "without extension")
    btf = open_btf(path)
    split = replace(btf, holdout=0.3).split(seed=3)
    groups = [split.train, *split.heldout.values()]
    assert np.array_equal(np.sort(np.concatenate(groups)), np.arange(len(btf)))
    assert len(btf) == {"rti": 5, "rti-turned": 5, "ubo2003-pca": 6561}.get(name, 25)
    assert 0 < len(split.train) < len(btf)
    assert {"format", "colour", "cosine", "clamp"} <= set(btf.provenance)
    assert btf.fingerprint == open_btf(path).fingerprint
    assert (btf.wo[:, 2] > 0).all()
    np.testing.assert_allclose(np.linalg.norm(btf.wi, axis=1), 1, atol=1e-6)


def test_unknown_files_and_folders_say_what_was_seen(refused, tmp_path):
    refused(tmp_path, "nothing")
    refused("a" * 5000, "no such file")
    refused(tmp_path / "missing", "missing: ")
    for content in (b"\x89PNG\r\n\x1a\n", b"", b"hello"):
        (tmp_path / "a.btf").write_bytes(content)
        refused(tmp_path / "a.btf", re.escape(repr(content)))


def test_a_reader_is_one_file_and_one_line(refused, tmp_path, monkeypatch):
    page = (Path(__file__).parents[4] / "docs" / "datasets.md").read_text(encoding="utf-8")
    code = re.search(r"```python\n(# bench/data/readers/colours\.py.*?)```", page, re.DOTALL).group(1)
    name, opens = re.search(r'^"(colours)": "(.*)",$', page, re.M).groups()
    (tmp_path / "outside").mkdir()
    (tmp_path / "outside" / f"{name}.py").write_text(code)
    monkeypatch.setattr(readers, "__path__", [*readers.__path__, str(tmp_path / "outside")])
    monkeypatch.setitem(readers.READERS, name, opens)
    (tmp_path / "a.txt").write_text("colours\n0 0 1 0 0 1 .1 .2 .3\n0 0 1 .6 0 .8 .2 .3 .4\n")
    btf = open_btf(tmp_path / "a.txt")
    assert (len(btf), btf.shape) == (2, (1, 1))
    np.testing.assert_allclose(btf[1], [[[0.2, 0.3, 0.4]]])
    (tmp_path / "bad.txt").write_text("colours\n0 0 1 0 0 1 .1 .2\n")
    refused(tmp_path / "bad.txt", r"bad\.txt")
    refused(tmp_path / "none", r"none: .*colours")
