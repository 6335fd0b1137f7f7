import numpy as np
import pytest

from bench.btf import BTF
from bench.codec import silent
from bench.data.open import open_material
from bench.errors import InputError, MissingDataError
from bench.runs.suite import Data, MaterialSpec


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
