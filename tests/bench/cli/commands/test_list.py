"""The fields that `list --json` writes: the listed things by name."""

import json
from pathlib import Path

import pytest

from bench import cli, metrics
from bench.codec import described_settings
from bench.codecs.registry import codec_entries, load_codec
from bench.data import materials
from bench.inputs.settings import descriptions


@pytest.fixture(autouse=True)
def _here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def written(*words):
    """What `list` writes as JSON."""
    assert cli.main(["list", *words, "--json", "listed.json"]) == 0
    return json.loads(Path("listed.json").read_text())


def test_of_all_and_of_one_kind():
    listed = written()
    assert listed["codecs"].keys() == codec_entries().keys()
    assert listed["metrics"] == metrics.listed()
    assert listed["materials"] == materials.describe()
    assert written("materials") == {"materials": materials.describe()}


@pytest.mark.parametrize("name", ["pca", "biplane"])  # the second shares a network over materials
def test_of_one_codec(name):
    listed, codec = written("codecs", name), load_codec(name)
    assert (listed["codec"], listed["version"]) == (name, codec.version)

    def by_name(settings):
        return {each.name: {"default": each.default, "kind": each.kind, "meaning": each.meaning} for each in settings}

    assert listed["settings"] == by_name(described_settings(codec))
    network = by_name(descriptions(codec.network.Settings)) if codec.network else None
    assert listed.get("network_settings") == network


def test_of_programs_behind_the_interface():
    assert "encode" in written("codecs", "command")["settings"]
