import logging
import re

import numpy as np
import pytest

from bench.btf import BTF
from bench.codec import silent
from bench.conformance.check import tiny_btf
from bench.data import convert
from bench.data.open import open_material, open_named
from bench.data.spec import MaterialSpec, Preparation, named
from bench.directions.hemisphere import to_degrees
from bench.inputs.errors import InputError, MissingDataError


def test_measured_data_that_are_not_there_say_where_to_get_them(monkeypatch):
    monkeypatch.setenv("NEUBTF_DATA", "/no/such/data")
    with pytest.raises(MissingDataError, match=r"f\.btf: .*NEUBTF_DATA=/no/such/data: .*UBO"):
        open_material(MaterialSpec("f", "f.btf", "ask UBO"), Preparation(), silent)
    with pytest.raises(InputError, match=r"f\.btf: "):
        open_material(MaterialSpec("f", "f.btf"), Preparation(), silent)
    assert MaterialSpec("a", "x" * 4000).existing_path() is None  # too long for a file


def test_a_name_that_no_record_or_file_of_results_can_hold_is_refused_in_one_line():
    with pytest.raises(InputError, match=r"^data/bad\\udcff\.npz: .*UTF-8") as caught:
        open_named("data/bad\udcff.npz", {})
    with pytest.raises(InputError, match="not UTF-8"):
        MaterialSpec("bad\udcff")
    assert str(caught.value).encode()  # the message can be recorded itself
    named("data/" + "a" * 196 + ".npz")
    with pytest.raises(InputError, match=r"a\.npz: .*\b201\b"):
        named("data/" + "a" * 197 + ".npz")


def test_a_folder_by_its_dots_has_the_name_that_it_has_elsewhere(tmp_path, monkeypatch):
    inside = tmp_path / "wool" / "old"
    inside.mkdir(parents=True)
    monkeypatch.chdir(inside)
    assert [named(path).name for path in (".", "..", "../old/", "/")] == ["old", "wool", "old", "/"]


def test_what_the_data_declare_held_out_are_test_pairs(tmp_path):
    btf = tiny_btf(4, 9, 9)
    declared = BTF("a", btf.wo, btf.wi, btf.source, heldout=np.arange(81) >= 72)
    convert.write_btf(declared, tmp_path / "a.npz")
    choosing = open_material(MaterialSpec("a", str(tmp_path / "a.npz")), Preparation(split="validation"), silent)
    assert len(choosing) == 72
    assert sum(map(len, choosing.split().heldout.values())) > 0


def pairs_of(btf, pairs):
    return np.concatenate([btf.wo[pairs], btf.wi[pairs]], 1)


def test_validation_pairs_of_measured_data_stand_beside_the_test_pairs_and_no_fit_sees_them(tmp_path):
    convert.write_btf(tiny_btf(4, 9, 9), tmp_path / "a.npz")
    spec = MaterialSpec("a", str(tmp_path / "a.npz"))
    plain, both, choosing = (
        open_material(spec, Preparation(**more), silent) for more in ({}, {"validation": True}, {"split": "validation"})
    )

    def directions(btf, pairs):
        return {tuple(w) for w in btf.wo[pairs]}, {tuple(w) for w in btf.wi[pairs]}

    split, other = both.split(), choosing.split()
    # Nothing of the new views and lights of the test pairs is there to choose by; more whole ones the fit never sees.
    left, seen = directions(plain, plain.split().train), directions(choosing, slice(None))
    assert seen == left
    assert other.heldout.keys() == {"new view", "new light", "both new"}
    for fitted, all_of_them in zip(directions(choosing, other.train), left, strict=True):
        assert len(fitted) < len(all_of_them)
    assert split.heldout.keys() == plain.split().heldout.keys()
    for name, pairs in split.heldout.items():
        np.testing.assert_array_equal(pairs, plain.split().heldout[name])
    np.testing.assert_array_equal(pairs_of(both, split.train), pairs_of(choosing, other.train))
    chosen_by = np.sort(np.concatenate([*other.heldout.values()]))
    np.testing.assert_array_equal(pairs_of(both, split.validation), pairs_of(choosing, chosen_by))
    everything = np.concatenate([split.train, split.validation, *split.heldout.values()])
    np.testing.assert_array_equal(np.sort(everything), np.arange(len(both)))
    assert both.fingerprint != plain.fingerprint


def test_validation_pairs_of_rendered_materials_change_neither_training_nor_test_pairs(tmp_path, monkeypatch):
    monkeypatch.setenv("NEUBTF_CACHE", str(tmp_path / "cache"))
    small = {"size": 8, "views": 4, "lights": 4, "heldout": 3}
    plain, both, choosing = (
        open_material(MaterialSpec("satin"), Preparation(**small, **more), silent)
        for more in ({}, {"validation": True}, {"split": "validation"})
    )
    split = both.split()
    assert both.subset(split.train).fingerprint == plain.subset(plain.split().train).fingerprint  # one fit serves both
    for theirs, ours in ((plain, split.heldout["heldout"]), (choosing, split.validation)):
        heldout = theirs.split().heldout["heldout"]
        np.testing.assert_array_equal(pairs_of(both, ours), pairs_of(theirs, heldout))
        np.testing.assert_array_equal(both[int(ours[0])], theirs[int(heldout[0])])


def test_of_measured_data_any_share_is_held_out_of_the_pairs_that_are_kept(tmp_path):
    convert.write_btf(tiny_btf(4, 9, 9), tmp_path / "a.npz")
    path = str(tmp_path / "a.npz")
    usual, whole, thinned = (
        open_named(path, changes)
        for changes in ({"data.holdout": "0.125"}, {"data.holdout": "0"}, {"data.holdout": "0", "data.pairs": "50"})
    )
    assert usual.fingerprint == open_named(path, {}).fingerprint
    for btf, count in ((whole, 81), (thinned, 49)):
        assert (len(btf), btf.split().train.tolist()) == (count, list(range(count)))
    both = open_named(path, {"data.holdout": "0.3", "data.validation": "true"}).split()
    assert (len(both.train), len(both.validation)) == (4 * 4, 6 * 6 - 4 * 4)


def test_what_the_data_declare_held_out_stays_so_whatever_the_share(tmp_path, caplog):
    btf = tiny_btf(4, 9, 9)
    convert.write_btf(BTF("a", btf.wo, btf.wi, btf.source, heldout=np.arange(81) >= 72), tmp_path / "a.npz")
    with caplog.at_level(logging.WARNING):
        opened = open_named(str(tmp_path / "a.npz"), {"data.holdout": "0"})
    assert len(opened.split().train) == 72
    assert re.search(r"a\.npz: .*data\.holdout", caplog.text)


@pytest.mark.parametrize("wrong", [{"validation": True}, {"split": "validation"}, {"holdout": 1}, {"holdout": -0.1}])
def test_a_share_to_hold_out_that_leaves_nothing_to_fit_or_to_choose_by_is_refused(wrong):
    with pytest.raises(InputError, match="holdout"):
        Preparation(**{"holdout": 0} | wrong)


def test_rendered_materials_have_no_share_to_hold_out(tmp_path, monkeypatch):
    monkeypatch.setenv("NEUBTF_CACHE", str(tmp_path / "cache"))
    with pytest.raises(InputError, match=r"data\.holdout: satin.*data\.heldout"):
        open_named("satin", {"data.holdout": "0"})
    small = {"size": 8, "views": 4, "lights": 4, "heldout": 3}
    plain, other = (
        open_material(MaterialSpec("satin"), Preparation(**small, **more), silent) for more in ({}, {"holdout": 0})
    )
    assert other.fingerprint == plain.fingerprint


@pytest.mark.parametrize("wrong", [{"split": "train"}, {"renderer": "embree"}, {"angles": "both"}])
def test_a_word_that_is_no_choice_is_refused_in_scripts_too(wrong):
    with pytest.raises(InputError, match=f"^{next(iter(wrong))} must be .* or .*, not "):
        Preparation(**wrong)


@pytest.mark.parametrize("wrong", [{"split": "validation"}, {"heldout": 0}])
def test_validation_beside_nothing_is_refused(wrong):
    with pytest.raises(InputError, match="validation"):
        Preparation(validation=True, **wrong)


def test_pairs_of_low_light_change_no_other_pair_and_no_fingerprint(tmp_path, monkeypatch):
    monkeypatch.setenv("NEUBTF_CACHE", str(tmp_path / "cache"))
    small = {"size": 8, "views": 4, "lights": 4, "heldout": 3, "validation": True}
    plain, low = (
        open_material(MaterialSpec("satin"), Preparation(**small, low_light=count), silent) for count in (0, 5)
    )
    split = low.split()
    theta_o, theta_i = (to_degrees(side[split.low_light])[0] for side in (low.wo, low.wi))
    assert len(theta_i) == 5
    assert 75 <= theta_i.min() < theta_i.max() <= 89
    assert theta_o.max() <= 75
    assert all(low[int(pair)].max() > 0 for pair in split.low_light)  # rendered, though dim
    np.testing.assert_array_equal(low[:22], plain[:])
    assert split.heldout["heldout"].tolist() == plain.split().heldout["heldout"].tolist()
    assert split.validation.tolist() == plain.split().validation.tolist()
    assert low.subset(split.train).fingerprint == plain.subset(plain.split().train).fingerprint  # one fit serves both
    assert low.fingerprint == low.without_low_light().fingerprint == plain.fingerprint
    assert low.without_low_light().provenance == plain.provenance
    rest = low.without_test()
    assert not rest.low_light.any()
    assert len(rest) == 16
    other = open_material(MaterialSpec("brick"), Preparation(**small, low_light=5), silent)
    assert not np.isin(other.wi[other.low_light], low.wi).all(1).any()  # each material has a draw of its own


def test_what_is_written_leaves_out_pairs_of_low_light_which_a_fit_would_train_on(tmp_path, monkeypatch):
    monkeypatch.setenv("NEUBTF_CACHE", str(tmp_path / "cache"))
    btf = open_named("satin", {"data.size": "8", "data.views": "4", "data.lights": "4", "data.low_light": "5"})
    for name in ("a.npz", "folder"):
        convert.write_btf(btf, tmp_path / name)
        written = open_named(str(tmp_path / name), {})
        assert len(written) == len(btf) - 5
        assert len(written.split().train) == 16


def test_low_light_needs_a_place_beside_declared_pairs():
    btf = tiny_btf(4, 4, 4)
    with pytest.raises(ValueError, match="declared heldout"):
        BTF("a", btf.wo, btf.wi, btf.source, low_light=np.arange(16) == 3)
    with pytest.raises(InputError, match=r"low_light.*-1"):
        Preparation(low_light=-1)


def test_pairs_between_texels_change_no_pair_and_no_fingerprint_and_no_fit_has_them(tmp_path, monkeypatch):
    monkeypatch.setenv("NEUBTF_CACHE", str(tmp_path / "cache"))
    small = {"size": 8, "views": 4, "lights": 4, "heldout": 5, "validation": True, "low_light": 2}
    plain, btf = (open_material(MaterialSpec("satin"), Preparation(**small, between=count), silent) for count in (0, 3))
    assert plain.between is None
    between, chosen = btf.between, btf.split().heldout["heldout"][[0, 2, 4]]
    np.testing.assert_array_equal((between.wo, between.wi), (btf.wo[chosen], btf.wi[chosen]))
    for number, pair in enumerate(chosen.tolist()):
        assert not np.array_equal(between[number], btf[pair])
        assert between[number].mean() == pytest.approx(btf[pair].mean(), rel=1e-3)  # the same surface, moved
    assert re.findall(r"\d+", between.provenance["heldout"])[:3] == ["3", "5", "0"]
    np.testing.assert_array_equal(btf[:], plain[:])
    assert btf.fingerprint == plain.fingerprint
    assert btf.provenance == plain.provenance
    others = (btf.subset([0, 1]), btf.crop(0, 0, 4, 4), btf.downsample(2), btf.without_test(), btf.without_low_light())
    assert [other.between for other in others] == [None] * 5
    few = Preparation(**small | {"heldout": 2, "validation": False}, between=3)
    assert len(open_material(MaterialSpec("satin"), few, silent).between) == 2
    with pytest.raises(InputError, match=r"between.*-1"):
        Preparation(between=-1)
