import importlib
from textwrap import dedent

import pytest

from bench.codecs.registry import load_codec
from bench.runs import identity as subject
from bench.runs.identity import identity

CODEC = """
    from mypackage.deep import helper
    from bench.codec import Codec
    class Mine(Codec):
        '''It is mine.'''
        name, version = "mine", 1
        def encode(self, btf, fit):
            from . import late
            return helper(btf) + late.more
"""
FILES = {"__init__.py": "", "mine.py": CODEC, "unused.py": "word = 1", "deep/__init__.py": "from .inner import helper"}
FILES |= {"deep/inner.py": "def helper(x):\n    return x", "late.py": "import sklearn.cluster, beside\nmore = 1"}
FILES["../beside.py"] = "size = 1"  # not installed, so its text counts


@pytest.fixture
def package(tmp_path, monkeypatch):
    for name, text in FILES.items():
        path = tmp_path / "mypackage" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(dedent(text))
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path / "mypackage"


def forget():
    for cached in (subject._identity_of_modules, subject._digest_and_imports):
        cached.cache_clear()


def identity_of(package):
    forget()
    importlib.invalidate_caches()
    return subject._identity_of_modules(frozenset({"mypackage.mine", "bench.codec", *subject.ALWAYS}))


@pytest.mark.parametrize(
    ("name", "old", "new", "counts"),
    [
        ("mine.py", "late.more", "late.more + 1", True),
        ("deep/inner.py", "return x", "return -x", True),
        ("deep/__init__.py", "from .inner import helper", "from .inner import helper\nx = 1", True),
        ("late.py", "more = 1", "more = 2", True),  # imported within a function
        ("../beside.py", "size = 1", "size = 2", True),
        ("unused.py", "word = 1", "word = 2", False),
    ],
)
def test_it_changes_with_what_the_codec_imports_of_its_own_package_alone(name, old, new, counts, package):
    before = identity_of(package)
    path = package / name
    path.write_text(path.read_text().replace(old, new))
    assert (identity_of(package) != before) == counts


def test_libraries_that_shape_the_file_are_named(package):
    assert "sklearn" in identity_of(package)["libraries"]
    assert "sklearn" in identity(load_codec("vq")())["libraries"]
    assert "sklearn" not in identity(load_codec("pca")())["libraries"]


def test_a_codec_that_inherits_from_the_standard_library_has_the_same_identity_again():
    roots = frozenset({"abc", "bench.codec"})
    forget()
    before = subject._identity_of_modules(roots)
    forget()
    assert subject._identity_of_modules(roots) == before


def changed_source(monkeypatch, tmp_path, module):
    forget()
    file = subject.source_of

    def other(name):
        if name != module:
            return file(name)
        path = tmp_path / "changed.py"
        path.write_text(file(name).read_text() + "\nCHANGED = True\n")
        return path

    monkeypatch.setattr(subject, "source_of", other)


@pytest.mark.parametrize(
    "module", ["bench.training.fitting", "bench.training.decoder", "bench.training.quantise", "bench.codecs.container"]
)
def test_the_part_of_the_suite_that_fits_and_writes_counts(module, monkeypatch, tmp_path):
    codec = load_codec("neubtf-direct")()
    before = identity(codec)
    changed_source(monkeypatch, tmp_path, module)
    try:
        assert identity(codec) != before
    finally:
        monkeypatch.undo()
        forget()
    assert identity(codec) == before
