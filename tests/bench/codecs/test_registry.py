import re
from importlib.metadata import EntryPoint

import pytest

from baselines.pca import PCA
from bench.codecs import registry
from bench.codecs.described import described_codecs
from bench.inputs import plugins
from bench.inputs.errors import InputError
from tests.bench.outside import install

MINE = 'class Mine:\n    """My codec."""\n\n    name, version = "mine", 1\n'


@pytest.fixture
def installed(monkeypatch):
    def install(*entries):
        points = [EntryPoint(name, value, registry.GROUP) for name, value in entries]
        monkeypatch.setattr(plugins, "points", lambda group: points)

    return install


def test_every_installed_codec_loads_under_its_name_and_is_described():
    entries = registry.codec_entries()
    assert {"mean-colour", "table", "pca"} <= set(entries)
    for name, entry in entries.items():
        assert registry.load_codec(name).name == name
        assert len(registry.describe(entry)) > 20


def test_two_codecs_of_one_name_are_an_error_and_the_same_one_twice_is_not(installed):
    installed(("pca", "baselines.pca:PCA"), ("pca", "baselines.pca:PCA"))
    assert list(registry.codec_entries()) == ["pca"]
    installed(("pca", "baselines.pca:PCA"), ("pca", "other.pca:PCA"))
    with pytest.raises(InputError, match=r"'pca'.*baselines\.pca:PCA.*other\.pca:PCA"):
        registry.codec_entries()


def test_a_class_must_be_there_bear_the_name_of_its_entry_point_and_have_a_version(installed, monkeypatch):
    installed(("pcb", "baselines.pca:PCA"), ("pca", "baselines.pca:PCA"), ("gone", "no_such_module:Codec"))
    assert "not importable" in registry.describe(registry.codec_entries()["gone"])
    with pytest.raises(InputError, match=r"pcb.*'pca'"):
        registry.load_codec("pcb")
    monkeypatch.setattr(PCA, "name", None)
    with pytest.raises(InputError, match=r"codec pca.*\bname\b"):
        registry.load_codec("pca")
    monkeypatch.setattr(PCA, "name", "pca")
    monkeypatch.delattr(PCA, "version")
    with pytest.raises(InputError, match=r"codec pca.*\bversion\b"):
        registry.load_codec("pca")


@pytest.mark.parametrize("folder", ["mine", "mine-codec"])  # as `new codec mine` calls it
def test_an_unknown_codec_whose_folder_lies_here_is_told_how_to_install_it(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / folder).mkdir()
    text = '[project.entry-points."neubtf_bench.codecs"]\nmine = "mine:Mine"\n'
    (tmp_path / folder / "pyproject.toml").write_text(text)
    with pytest.raises(InputError, match=rf"'mine'.* \./{folder}$"):
        registry.load_codec("mine")


def test_a_codec_that_fails_is_listed_with_its_failure(tmp_path, monkeypatch):
    site = install(tmp_path, "outside", {"fails": "fails:Mine", "mine": "mine:Mine"}, {"fails": "1 / 0", "mine": MINE})
    monkeypatch.syspath_prepend(site)
    entries = registry.codec_entries()
    assert re.match("FAILS: .*fails.*outside.*ZeroDivisionError", registry.listed(entries["fails"]))
    assert registry.listed(entries["mine"]) == "My codec."


def test_a_codec_whose_source_is_no_python_costs_its_own_description_alone(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(install(tmp_path, "outside", {"fails": "fails:Mine"}, {"fails": "class Mine(:"}))
    assert registry.current_versions("fails") == {}
    assert described_codecs()["fails"]["about"].startswith("not importable: fails")


def test_settings_as_published_are_written_as_their_defaults_are():
    published = {name: value for name, _, _, value in described_codecs()["neumip"]["settings"]}
    assert published["blur"] == "true"


def test_codecs_that_cite_each_other_cite_nothing_and_a_tuple_is_one_value(tmp_path, monkeypatch):
    text = 'class {0}:\n    """{0}.\n\n    Cited as `{1}`.\n    """\n\n    name = "{0}"\n    version = (1, 2)\n'
    modules = {"one": text.format("one", "two"), "two": text.format("two", "one")}
    monkeypatch.syspath_prepend(install(tmp_path, "outside", {"one": "one:one", "two": "two:two"}, modules))
    entry = registry.codec_entries()["one"]
    assert registry.reference(entry) == {"bibtex": "", "paper": "", "code": ""}
    assert registry.current_versions("one") == {}  # its version is no number


def test_an_entry_point_without_a_class_is_listed_with_its_fault_and_described_by_its_module(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(install(tmp_path, "outside", {"plain": "plain"}, {"plain": '"""My module."""'}))
    entry = registry.codec_entries()["plain"]
    assert "has no name" in registry.listed(entry)
    assert registry.describe(entry) == "My module."
    assert registry.reference(entry)["bibtex"] == ""
