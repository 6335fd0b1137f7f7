import numpy as np
import pytest

from bench.btf import BTF
from bench.check import tiny_btf
from bench.codec import silent
from bench.errors import InputError, MissingDataError
from bench.open import open_material, thinned
from bench.suite import Data, MaterialSpec


def test_thinning_measured_data_keeps_the_product():
    thin = thinned(tiny_btf(4, 20, 30), 100)
    assert len(thin) == 100
    assert thin.layout.grid is not None
    assert thin.layout.views.shape == (10, 3)


@pytest.mark.parametrize(("views", "lights", "expected"), [(1, 40, (1, 20)), (3, 40, (3, 6)), (40, 2, (10, 2))])
def test_a_side_of_few_directions_keeps_them_all(views, lights, expected):
    layout = thinned(tiny_btf(4, views, lights), 20).layout
    assert (len(layout.views), len(layout.lights)) == expected


def test_no_thinning_where_none_is_asked_or_needed():
    btf = tiny_btf(4, 5, 5)
    assert thinned(btf, 0) is btf
    assert thinned(btf, 25) is btf


def test_pairs_that_are_no_product_are_drawn_by_seed():
    btf = tiny_btf(4, 6, 6).subset(np.arange(35))
    assert len(thinned(btf, 10)) == 10
    np.testing.assert_array_equal(thinned(btf, 10).pairs, thinned(btf, 10).pairs)


def test_built_in_and_measured_materials_open(tmp_path, monkeypatch):
    monkeypatch.setenv("NEUBTF_CACHE", str(tmp_path / "cache"))
    small = Data(size=8, views=4, lights=4, heldout=3)
    btf = open_material(MaterialSpec("satin"), small, silent)
    assert isinstance(btf, BTF)
    assert (btf.shape, len(btf)) == ((8, 8), 19)
    np.savez(tmp_path / "a.npz", radiance=np.ones((2, 4, 4, 3), "f4"), wo=btf.wo[:2], wi=btf.wi[:2])
    assert len(open_material(MaterialSpec("a", str(tmp_path / "a.npz")), small, silent)) == 2


def test_measured_data_that_are_not_there_say_where_to_get_them(monkeypatch):
    monkeypatch.setenv("NEUBTF_DATA", "/no/such/data")
    with pytest.raises(MissingDataError, match=r"f\.btf: not there or under NEUBTF_DATA=/no/such/data: ask UBO"):
        open_material(MaterialSpec("f", "f.btf", "ask UBO"), Data(), silent)
    with pytest.raises(InputError, match=r"f\.btf: not there.*check the path"):
        open_material(MaterialSpec("f", "f.btf"), Data(), silent)
