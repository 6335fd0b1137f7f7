import numpy as np
import pytest

from bench.btf import BTF, ArraySource, Source, scratch
from bench.codec import silent
from bench.conformance.check import tiny_btf
from bench.data.derived import shrunk, thinned
from bench.data.kinds.measured import Measured
from bench.data.spec import MaterialSpec, Preparation


def test_thinning_measured_data_keeps_the_product_and_draws_other_pairs_by_seed():
    btf = tiny_btf(4, 20, 30)
    assert thinned(btf, 0) is thinned(btf, 600) is btf
    thin = thinned(btf, 100)
    assert len(thin) == 100
    assert thin.layout.grid is not None
    assert thin.layout.views.shape == (10, 3)
    some = btf.subset(np.arange(35))
    assert len(thinned(some, 10)) == 10
    np.testing.assert_array_equal(thinned(some, 10).pairs, thinned(some, 10).pairs)


@pytest.mark.parametrize(("views", "lights", "expected"), [(1, 40, (1, 20)), (3, 40, (3, 6)), (40, 2, (10, 2))])
def test_a_side_of_few_directions_keeps_them_all(views, lights, expected):
    layout = thinned(tiny_btf(4, views, lights), 20).layout
    assert (len(layout.views), len(layout.lights)) == expected


def test_declared_heldout_pairs_keep_their_share_and_the_training_pairs_their_product():
    whole = tiny_btf(4, 10, 10)
    btf = whole.subset(np.arange(95))  # 9 × 10 training pairs and five others
    btf = BTF("declared", btf.wo, btf.wi, whole.source, heldout=np.arange(95) >= 90, pairs=btf.pairs)
    thin = thinned(btf, 57)
    assert thin.heldout.sum() == 3
    assert thin.subset(np.flatnonzero(~thin.heldout)).layout.grid is not None


@pytest.mark.parametrize("pairs", [1, 16])
def test_declared_heldout_pairs_of_a_product_keep_their_share(pairs):
    btf = tiny_btf(4, 9, 9)
    third_view = btf.layout.view == 3
    btf = BTF("declared", btf.wo, btf.wi, btf.source, heldout=third_view)
    thin = thinned(btf, pairs)
    assert thin.heldout.sum() == max(1, round(pairs / 9))
    assert (~thin.heldout).sum() >= 1
    assert thin.subset(np.flatnonzero(~thin.heldout)).layout.grid is not None


class Watched(ArraySource):
    """An array that notes which pairs are read; it has no scattered reads of its own, like a folder of pictures."""

    gather = Source.gather
    texels = Source.texels

    def __init__(self, values):
        super().__init__(values)
        self.read = set()

    def slice(self, pair):
        self.read.add(pair)
        return super().slice(pair)


def test_pairs_that_are_left_out_are_neither_read_nor_copied_nor_repaired(brief, monkeypatch):
    """22 GB of a measurement are not read for 500 of its pairs, and an unused pair that is spoiled does no harm."""
    btf = tiny_btf(8, 9, 9)
    values = np.stack(list(btf))
    used = set(thinned(btf, 16).pairs.tolist())
    values[next(pair for pair in range(81) if pair not in used)] = np.nan
    source = Watched(values)
    whole = BTF("watched", btf.wo, btf.wi, source)
    monkeypatch.setattr("bench.data.readers.open_btf", lambda *_: whole)
    preparation = Preparation(pairs=16, texels=4, repair=True)
    small = Measured().open(MaterialSpec("watched", path="."), preparation, silent, 0, None)
    rows, cols = np.array([0, 3]), np.array([1, 2])
    expected = thinned(btf, 16).downsample(2)
    np.testing.assert_allclose(small.texels(rows, cols), expected.texels(rows, cols), rtol=1e-3)
    np.testing.assert_array_equal(small.wo, expected.wo)
    assert source.read == used


def test_shrunk_pictures_are_averages_of_whole_boxes_and_scattered_reads_agree(brief, monkeypatch):
    btf = tiny_btf(13, 4, 4)
    small = shrunk(btf, 4)
    assert small.shape == (4, 4)
    pictures = np.stack(list(small))
    np.testing.assert_allclose(pictures, np.stack(list(btf.downsample(3))), rtol=2**-11)  # halves
    np.testing.assert_array_equal(pictures[5], small[5])
    rng = np.random.default_rng(0)
    pair, row, col = rng.integers(0, [[16], [4], [4]], (3, 40))
    np.testing.assert_array_equal(small.gather(pair, row, col), pictures[pair, row, col])
    np.testing.assert_array_equal(small.texels(row, col)[np.arange(40), pair], pictures[pair, row, col])
    monkeypatch.delattr(scratch, "scattered")  # whole pictures do without, which takes a third of the time
    some = small.subset([9, 2])
    np.testing.assert_array_equal(np.stack(list(some)), pictures[[9, 2]])
    assert small.fingerprint not in (btf.fingerprint, btf.downsample(3).fingerprint)
    assert shrunk(btf, 0) is btf
    assert shrunk(btf, 7) is btf  # a box of one texel
