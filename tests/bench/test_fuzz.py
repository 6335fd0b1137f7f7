"""A short form of `tests/fuzz/fuzz_*.py`: bad files are refused in one line, or read; nothing else is ever raised."""

import fuzz_codec_files
import fuzz_inputs
import fuzz_readers
import fuzzing
import pytest

TARGETS = {target.name: target for module in (fuzz_codec_files, fuzz_readers, fuzz_inputs) for target in module.TARGETS}
CODECS = ["mean-colour", "table", "pca", "vq", "rainer2019", "neumip", "neubtf-direct"]
CODECS += ["bcf", "ntc", "relief", "biplane", "svbrdf"]
READERS = ["folder-png", "rti-turned", "npz", "npz-compressed", "mean-abrdf", "ubo2014-log", "ubo2003", "utia-exr"]
READERS += ["ubo2003-pca", "hdf5"]
INPUTS = ["suites", "scenes", "demands", "records", "trades", "facts"]


@pytest.mark.parametrize("name", [*CODECS, *READERS, *INPUTS])
def test_bad_files_are_refused_or_read_and_nothing_else_is_raised(name, tmp_path):
    attacks = range(4 if name in ("records", "trades") else 12)  # a whole run a time for these two
    found, _, first = fuzzing.attacked(TARGETS[name], attacks, 7, tmp_path)
    assert set(found) <= {fuzzing.READ, fuzzing.REFUSED}, first
    assert found[fuzzing.REFUSED] > 1


def test_what_else_is_raised_is_counted_and_named(tmp_path):
    def attack(sample, scratch, rng):
        def reading():
            raise KeyError("a")

        return reading

    found, _, first = fuzzing.attacked(fuzzing.Target("bad", lambda folder: None, attack), range(3), 0, tmp_path)
    assert (found, first) == ({"KeyError": 3}, {"KeyError": 0})
