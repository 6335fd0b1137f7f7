from dataclasses import make_dataclass
from unittest.mock import Mock

import numpy as np
import pytest

from bench.data import materials
from bench.data.materials import store
from bench.data.materials.maps import Maps
from bench.data.materials.renderer import render
from bench.data.spec import Preparation
from bench.directions.hemisphere import thin, to_degrees, ubo2003
from bench.inputs.errors import InputError

SMALL = {"size": 8, "views": 3, "lights": 4, "heldout": 5}


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("NEUBTF_CACHE", str(tmp_path))
    return tmp_path / "materials"


def test_the_pairs_are_a_view_major_product_followed_by_random_heldout_ones():
    btf = materials.load("satin", **SMALL)
    assert len(btf) == 3 * 4 + 5
    assert btf.shape == (8, 8)
    assert btf.periodic
    assert btf.heldout.tolist() == [False] * 12 + [True] * 5
    views, lights = (ubo2003()[thin(ubo2003(), n)] for n in (3, 4))
    for pair in range(12):
        np.testing.assert_array_equal(btf.wo[pair], views[pair // 4])
        np.testing.assert_array_equal(btf.wi[pair], lights[pair % 4])
    theta_deg, _ = to_degrees(np.concatenate([btf.wo[12:], btf.wi[12:]]))
    assert theta_deg.max() <= 75 + 1e-4
    split = btf.split()
    assert len(split.train) == 12
    assert split.heldout["heldout"].tolist() == [12, 13, 14, 15, 16]


def test_the_second_load_renders_nothing_and_gives_the_same(monkeypatch):
    first = materials.load("leather", **SMALL)
    exact = store.render(materials.recipe("leather").maps(0), first.wo, first.wi, (8, 8), store.SUB_POINTS)
    np.testing.assert_allclose(np.stack(list(first)), exact, rtol=2**-11, atol=2**-25)
    monkeypatch.setattr(store, "render", None)
    second = materials.load("leather", **SMALL)
    assert all(isinstance(part.values, np.memmap) for part in second.source.parts)
    assert second.fingerprint == first.fingerprint
    np.testing.assert_array_equal(np.stack(list(second)), np.stack(list(first)))


@pytest.mark.parametrize(
    "change", [{"size": 4}, {"views": 2}, {"lights": 2}, {"heldout": 6}, {"seed": 1}, {"directions": "ubo2014"}]
)
def test_whatever_shapes_the_values_is_in_the_fingerprint(change):
    assert materials.load("brick", **SMALL).fingerprint != materials.load("brick", **SMALL | change).fingerprint


@pytest.mark.parametrize("constant", ["RENDERER_VERSION", "SUB_POINTS"])
def test_a_changed_renderer_renders_anew(constant, monkeypatch, cache):
    materials.load("satin", **SMALL)
    monkeypatch.setattr(store, constant, getattr(store, constant) + 1)
    materials.load("satin", **SMALL)
    assert len(list(cache.glob("*.npy"))) == 4  # the product and the held-out pairs, twice


def test_an_interrupted_rendering_leaves_nothing_behind(monkeypatch, cache):
    with pytest.raises(KeyboardInterrupt):
        materials.load("satin", **SMALL, show=Mock(side_effect=KeyboardInterrupt))
    assert list(cache.iterdir()) == []


@pytest.mark.parametrize("keep", [None, 0, 60, 1000])
def test_a_truncated_file_or_one_without_its_description_is_rendered_again(cache, keep):
    """The description is written last: a crash between the two leaves values alone."""
    first = np.stack(list(materials.load("satin", **SMALL)))
    values = next(cache.glob("*.npy"))
    if keep is None:
        values.with_suffix(".json").unlink()
        values.write_bytes(values.read_bytes()[:-1] + b"\x7b")
    else:
        values.write_bytes(values.read_bytes()[:keep])
    np.testing.assert_array_equal(np.stack(list(materials.load("satin", **SMALL))), first)


def test_another_draw_renders_its_pairs_and_no_product(cache, monkeypatch):
    first = materials.load("satin", **SMALL, split="validation")
    rendered = []
    monkeypatch.setattr(store, "render", lambda maps, wo, *rest: rendered.append(len(wo)) or render(maps, wo, *rest))
    tests = [materials.load("satin", **SMALL, split="test", draw=draw) for draw in (0, 1)]
    assert rendered == [5, 5]
    for btf in tests:
        np.testing.assert_array_equal(btf.wo[:12], first.wo[:12])
        assert btf.subset(btf.split().train).fingerprint == first.subset(first.split().train).fingerprint
    assert len({btf.fingerprint for btf in (first, *tests)}) == 3


def test_no_two_draws_share_a_pair_and_validation_pairs_are_one_draw():
    def drawn(material="satin", split="test", draw=0):
        pairs = Preparation(heldout=200, split=split).heldout_pairs(material, 0, draw)
        return {tuple(w) for w in np.concatenate(pairs)}

    tests = [drawn(split="test", draw=draw) for draw in range(3)]
    everything = [*tests, drawn(split="validation"), drawn("brick", split="test")]
    assert len(set.union(*everything)) == sum(map(len, everything))
    assert drawn(split="validation", draw=1) == drawn("brick", split="validation")
    assert drawn(split="test", draw=1) == tests[1]
    with pytest.raises(InputError, match=r"split.*'tset'"):
        Preparation(split="tset")


def test_joined_tables_answer_as_their_parts():
    btf = materials.load("leather", **SMALL)
    whole = np.stack(list(btf))
    pair, row, col = np.array([0, 13, 5, 16, 12]), np.array([0, 7, 3, 2, 1]), np.array([4, 5, 6, 7, 0])
    np.testing.assert_array_equal(btf.gather(pair, row, col), whole[pair, row, col])
    np.testing.assert_array_equal(btf.texels(row, col), whole[:, row, col].swapaxes(0, 1))
    np.testing.assert_array_equal(np.stack(btf.source.slices(np.array([16, 0, 13]))), whole[[16, 0, 13]])
    some = btf.subset([3, 15])
    np.testing.assert_array_equal(some.texels(row, col), whole[[3, 15]][:, row, col].swapaxes(0, 1))


def test_highlights_beyond_half_precision_are_kept_in_single():
    polished = make_dataclass("Polished", [], namespace={"maps": lambda self, seed: Maps(0, 1.0, 0.03, metalness=1.0)})
    btf = store.load_or_render("polished", polished(), Preparation(2, views=1, lights=1, heldout=0))
    assert btf.source.values.dtype == np.float32
    assert np.isfinite(btf[0]).all()
    assert btf[0].max() > 65504


@pytest.mark.parametrize("bad", [{"directions": "nowhere"}, {"views": 82}, {"lights": 0}, {"size": 0}, {"heldout": -1}])
def test_names_counts_and_sets_that_do_not_exist_are_refused(bad):
    with pytest.raises(InputError):
        materials.load("satin", **SMALL | bad)
    with pytest.raises(InputError, match="'cable-knit'"):
        materials.load("cable_knit")
