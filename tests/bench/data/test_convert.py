import tracemalloc

import numpy as np
import pytest

from bench import cli
from bench.btf import BTF, Source, box_filter
from bench.conformance.check import tiny_btf
from bench.data.convert import changed, write_btf
from bench.data.readers import open_btf
from bench.inputs.errors import InputError


@pytest.fixture
def btf():
    tiny = tiny_btf(12, 6, 5)
    return BTF(tiny.name, tiny.wo, tiny.wi, tiny.source, heldout=np.arange(30) >= 25, periodic=True)


@pytest.mark.parametrize("name", ["a.npz", "folder"])
def test_what_was_written_opens_and_is_the_same(tmp_path, btf, name):
    calls = []
    write_btf(btf, tmp_path / name, lambda *says: calls.append(says))
    again = open_btf(tmp_path / name)
    assert again.periodic
    assert calls[-1] == ("writing", 30, 30)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    far = np.abs(again.wo - btf.wo[:, None]).sum(2) + np.abs(again.wi - btf.wi[:, None]).sum(2)
    order = far.argmin(1)  # a folder sorts its pairs
    np.testing.assert_array_equal(np.stack([again[i] for i in order]), np.stack(list(btf)))
    np.testing.assert_array_equal(again.heldout[order], btf.heldout)


def test_a_window_is_cut_and_wraps_no_longer(btf):
    window = changed(btf, crop=(2, 3, 6, 4))
    assert window.shape == (6, 4)
    assert not window.periodic
    assert window.provenance["cropped"] == [2, 3, 6, 4]
    np.testing.assert_array_equal(window[7], btf[7][2:8, 3:7])
    np.testing.assert_array_equal(window.texels([1], [2]), btf.texels([3], [5]))
    np.testing.assert_array_equal(window.gather([4], [1], [2]), btf.gather([4], [3], [5]))
    assert window.fingerprint != btf.fingerprint
    assert changed(btf, crop=(0, 0, 12, 12)).periodic


def test_the_window_is_in_texels_of_the_source_and_is_averaged_and_thinning_keeps_a_product(btf):
    small = changed(btf, crop=(0, 4, 8, 8), downsample=4)
    np.testing.assert_allclose(small[3], box_filter(btf[3][:8, 4:], 4), rtol=1e-6)
    assert changed(tiny_btf(12, 6, 5), thin=9).layout.grid.shape == (3, 3)
    thin = changed(btf, thin=9)  # a view is held out, which nine pairs of the whole would leave out
    assert thin.heldout.any()
    assert thin.subset(np.flatnonzero(~thin.heldout)).layout.grid is not None


@pytest.mark.parametrize("options", [{"crop": (8, 0, 5, 5)}, {"crop": (0, 0, 0, 5)}, {"downsample": 13}, {"thin": -1}])
def test_changes_that_cannot_be_made_are_named(btf, options):
    with pytest.raises(InputError, match=f"--{next(iter(options))}"):
        changed(btf, **options)


def test_nothing_that_is_there_is_lost_and_nothing_half_done_is_left(tmp_path, btf):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "note").touch()
    with pytest.raises(InputError, match="full: "):
        write_btf(btf, tmp_path / "full")
    for name in ("a.exr", "a.NPZ"):
        with pytest.raises(InputError, match=rf"{name}: .*folder of pictures.*\.npz"):
            write_btf(btf, tmp_path / name)
    with pytest.raises(InputError, match=r"a\.npz: .*folder"):
        write_btf(btf, tmp_path / "no" / "a.npz")

    btf.source.values[4, 0, 0] = np.nan
    for name in ("a.npz", "b"):
        with pytest.raises(InputError, match="pair 4"):
            write_btf(btf, tmp_path / name)
    assert [path.name for path in tmp_path.iterdir()] == ["full"]


def test_memory_stays_small(tmp_path):
    class Large(Source):
        shape, count = (256, 256), 64

        def slice(self, pair):
            return np.full((256, 256, 3), pair, np.float32)

    side = tiny_btf(4, 8, 8)
    tracemalloc.start()
    write_btf(BTF("large", side.wo, side.wi, Large()), tmp_path / "large.npz")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 8e6  # a tenth of what the file holds
    assert open_btf(tmp_path / "large.npz")[63].min() == 63


def test_convert_from_the_command_line(tmp_path, btf, capsys):
    write_btf(btf, tmp_path / "a.npz")
    words = ["convert", str(tmp_path / "a.npz"), "-o", str(tmp_path / "b"), "--crop", "0,0,8,8", "--downsample", "2"]
    assert cli.main(words) == 0
    assert "30 slices" in capsys.readouterr().out
    assert open_btf(tmp_path / "b").shape == (4, 4)
    assert cli.main(words) == 2
    with pytest.raises(SystemExit, match="2"):
        cli.main(["convert", "satin", "--crop=1,2", "-o", str(tmp_path / "a.npz")])
