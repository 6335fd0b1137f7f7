import logging

import numpy as np
import pytest

from bench.btf import BTF, ArraySource
from bench.cli import main
from bench.conformance.check import tiny_btf
from bench.data.derived import over_own_pairs, repaired
from bench.data.readers import open_btf
from bench.inputs.errors import InputError


def spoiled() -> BTF:
    like = tiny_btf()
    values = np.stack(list(like))
    values[4, 0, :2, 1], values[4, 5, 5, 0], values[7, 2, 3, 2] = np.nan, np.inf, -np.inf
    return BTF("spoiled", like.wo, like.wi, ArraySource(values), periodic=True)


@pytest.mark.parametrize(
    ("read", "message"),
    [
        (lambda btf: btf[4], r"spoiled: pair 4: 3 .*\(0, 0, 1\)"),
        (lambda btf: btf.texels([5, 2], [5, 3]), r"spoiled: texels, .* 2 .*\(0, 4, 0\)"),
        (lambda btf: btf.gather([0, 7], [2, 2], [3, 3]), r"spoiled: samples, .* 1 .*\(1, 2\)"),
    ],
)
def test_values_that_are_not_finite_are_refused_by_count_and_place(read, message):
    with pytest.raises(InputError, match=message):
        read(spoiled())


def test_they_are_masked_by_the_mean_of_their_pair_and_channel(caplog):
    btf = spoiled()
    with caplog.at_level(logging.WARNING):
        mended = repaired(btf)
    assert "4 values" in caplog.text
    assert "4, 7" in mended.provenance["repaired"]
    truth, raw = tiny_btf(), btf.source.values
    np.testing.assert_array_equal(mended[5], truth[5])
    good = np.isfinite(raw[4])
    np.testing.assert_array_equal(mended[4][good], raw[4][good])
    assert mended[4][0, 0, 1] == pytest.approx(raw[4][..., 1][good[..., 1]].mean(), rel=1e-6)
    assert mended.fingerprint != btf.fingerprint
    assert repaired(truth) is truth
    some = over_own_pairs(btf.subset(np.array([1, 7])))  # as `data.pairs` chooses them: pairs keep the file's numbers
    assert "pairs 7" in repaired(some).provenance["repaired"]
    btf.source.values[9, ..., 2] = np.nan
    with pytest.raises(InputError, match="spoiled: pair 9"):
        repaired(btf)


def test_scattered_reads_give_the_same_values(tmp_path, monkeypatch):
    monkeypatch.setenv("NEUBTF_CACHE", str(tmp_path))
    mended = repaired(spoiled()).subset(np.arange(3, 9))
    # The scratch file holds halves.
    np.testing.assert_allclose(mended.texels([0, 5], [1, 5])[:, 1], [mended[1][0, 1], mended[1][5, 5]], rtol=5e-4)
    np.testing.assert_allclose(mended.gather([4], [2], [3]), mended[4][2, 3][None], rtol=5e-4)


def test_repair_from_the_command_line(tmp_path, capsys, caplog, monkeypatch):
    monkeypatch.setenv("NEUBTF_CACHE", str(tmp_path / "cache"))
    like = tiny_btf(4, 4, 4)
    values, pair = np.stack(list(like)), int(like.split().train[1])
    values[pair, 1, 1, 0] = np.nan
    np.savez(tmp_path / "a.npz", radiance=values, wo=like.wo, wi=like.wi)
    command = ["encode", str(tmp_path / "a.npz"), "--codec", "mean-colour", "-o", str(tmp_path / "a.nbtf")]
    assert main(command) == 2
    message = capsys.readouterr().err
    assert f"radiance[{pair}]: 1" in message
    assert "--repair" in message
    assert not (tmp_path / "a.nbtf").exists()
    assert main([*command, "--repair"]) == 0
    assert (tmp_path / "a.nbtf").exists()
    assert "1 values" in caplog.text
    score = ["score", str(tmp_path / "a.nbtf"), str(tmp_path / "a.npz")]
    assert main(score) == 2
    assert "--repair" in capsys.readouterr().err
    assert main([*score, "--repair"]) == 0
    assert main(["convert", str(tmp_path / "a.npz"), "--repair", "-o", str(tmp_path / "b.npz")]) == 0
    mended = open_btf(tmp_path / "b.npz")[pair][1, 1, 0]
    assert mended == pytest.approx(np.delete(values[pair][..., 0], 5).mean(), rel=1e-6)
