"""A short form of `benchmarks/fuzz_*.py`: bad files are refused in one line, or read; nothing else is ever raised."""

import importlib
from pathlib import Path

import pytest

PLACE = Path(__file__).parents[2] / "benchmarks"
CODECS = ["mean-colour", "table", "pca", "vq", "rainer2019", "neumip", "neubtf-direct"]
CODECS += ["bcf", "ntc", "relief", "biplane"]
READERS = ["folder-png", "rti-turned", "npz", "npz-compressed", "mean-abrdf", "ubo2014-log", "ubo2003", "utia-exr"]
READERS += ["ubo2003-pca", "hdf5"]
INPUTS = ["suites", "scenes", "demands", "records", "trades", "facts"]


@pytest.fixture
def known(monkeypatch):
    """Every target by name, and the module that attacks them."""
    monkeypatch.syspath_prepend(PLACE)
    modules = [importlib.import_module(f"fuzz_{name}") for name in ("codec_files", "readers", "inputs")]
    targets = [target for module in modules for target in module.TARGETS]
    return {target.name: target for target in targets}, importlib.import_module("fuzzing")


@pytest.mark.parametrize("name", [*CODECS, *READERS, *INPUTS])
def test_bad_files_are_refused_or_read_and_nothing_else_is_raised(name, known, tmp_path):
    targets, fuzzing = known
    found, _, first = fuzzing.attacked(targets[name], range(12 if name in ("records", "trades") else 60), 7, tmp_path)
    assert set(found) <= {fuzzing.READ, fuzzing.REFUSED}, first
    assert found[fuzzing.REFUSED] > 3


def test_every_reader_and_every_kind_of_file_is_attacked(known):
    targets, _ = known
    assert set(CODECS + READERS + INPUTS) <= set(targets)


def test_what_else_is_raised_is_counted_and_named(known, tmp_path):
    _, fuzzing = known

    def attack(sample, scratch, rng):
        def reading():
            raise KeyError("a")

        return reading

    found, _, first = fuzzing.attacked(fuzzing.Target("bad", lambda folder: None, attack), range(3), 0, tmp_path)
    assert (found, first) == ({"KeyError": 3}, {"KeyError": 0})
