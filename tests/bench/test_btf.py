from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest

from bench.btf import BTF, ArraySource, Layout, NotFiniteError, Source
from bench.directions.hemisphere import from_degrees, thin, ubo2003, uniform
from bench.inputs.errors import InputError

pytestmark = pytest.mark.usefixtures("brief")


class Slices(Source):
    def __init__(self, values, name="slices"):
        self.values, self.name, self.reads = values, name, 0
        self.count, self.shape = len(values), values.shape[1:3]

    def slice(self, pair):
        self.reads += 1
        return self.values[pair]

    def fingerprint(self):
        return self.name.ljust(32, "0")


def product(views=5, lights=5, size=(4, 6), source=ArraySource, top=1.0):
    directions = ubo2003()
    view, light = directions[thin(directions, views)], directions[thin(directions, lights)]
    values = np.random.default_rng(0).random((views * lights, *size, 3), np.float32) * top
    wo, wi = np.repeat(view, lights, 0), np.tile(light, (views, 1))
    return BTF("test", wo, wi, source(values)), values


@pytest.mark.parametrize("source", [ArraySource, Slices])
@pytest.mark.parametrize("together", [None, 10])
def test_slices_texels_and_scattered_values_are_the_same_table(source, together, monkeypatch):
    if together:
        monkeypatch.setattr("bench.btf.scratch.TOGETHER", together)  # fewer than there are pairs
    btf, values = product(source=source)
    # Half precision of the scratch file: 11 bits of significand.
    tolerance = 0 if source is ArraySource else 2**-11
    np.testing.assert_array_equal(np.stack(list(btf)), values)
    rows, cols = np.array([0, 3, 2]), np.array([5, 0, 1])
    np.testing.assert_allclose(btf.texels(rows, cols), values[:, rows, cols].swapaxes(0, 1), rtol=tolerance)
    pairs = np.arange(len(btf))
    places = pairs, pairs % 4, pairs % 6
    np.testing.assert_allclose(btf.gather(*places), values[places], rtol=tolerance)
    with pytest.raises(ValueError, match="wo and wi"):
        BTF("short", btf.wo[:-1], btf.wi[:-1], btf.source)


@pytest.mark.parametrize("value", [1e300, -1e40])
def test_finite_values_beyond_float32_are_refused_as_such_however_they_are_read(value):
    values = np.ones((25, 2, 2, 3))
    values[3, 1, 0, 2] = value
    source = ArraySource(values)
    one = np.array([3]), np.array([1]), np.array([0])
    for read in (lambda: source.slice(3), lambda: source.texels(one[1], one[2], one[0]), lambda: source.gather(*one)):
        with pytest.raises(InputError, match="beyond float32"):
            read()
    assert np.array_equal(source.slice(2), np.ones((2, 2, 3), np.float32))


def test_an_error_names_the_pair_by_its_index_also_in_a_range_of_pairs():
    btf, values = product()
    values[5, 1, 2, 0] = np.nan
    for read in (lambda: btf[5], lambda: btf[3:9], lambda: list(btf)):
        with pytest.raises(NotFiniteError, match="test: pair 5: 1 of 72 values"):
            read()


def test_a_subset_reads_only_its_own_pairs():
    btf, values = product()
    some = btf.subset([3, 20]).subset([1])
    assert len(some) == 1
    np.testing.assert_array_equal(some[0], values[20])
    np.testing.assert_array_equal(some.texels([1], [2])[0, 0], values[20, 1, 2])
    np.testing.assert_array_equal(some.wi[0], btf.wi[20])


def test_scattered_reads_of_slices_make_one_scratch_file(caplog):
    btf, _ = product(source=Slices)
    btf.gather([0], [0], [0])
    btf.texels([0], [0])
    assert btf.source.reads == len(btf)
    assert caplog.text.count("scratch file") == 1
    (announced,) = [record for record in caplog.records if "scratch file" in record.getMessage()]
    megabytes, memory, _ = announced.args
    assert 0 < memory <= megabytes
    again, _ = product(source=Slices)
    again.gather([0], [0], [0])
    assert again.source.reads == 0


def test_values_beyond_half_precision_survive_the_scratch_file():
    btf, values = product(source=lambda v: Slices(v, "large"), top=1e6)
    np.testing.assert_allclose(btf.gather([3], [1], [1])[0], values[3, 1, 1], rtol=1e-6)


@pytest.mark.parametrize("top", [1e-6, 1e-30])
def test_dim_values_survive_the_scratch_file_with_the_precision_of_a_half(top):
    btf, values = product(source=lambda v: Slices(v, f"dim {top}"), top=top)
    texels = btf.texels([0, 3, 2], [5, 0, 1])
    np.testing.assert_allclose(texels, values[:, [0, 3, 2], [5, 0, 1]].swapaxes(0, 1), rtol=2**-11)


def test_a_few_dim_values_among_bright_ones_leave_the_scratch_file_in_halves():
    btf, values = product(source=lambda v: Slices(v, "few dim"))
    values[:, 0, 0, 0] = 0  # black is no dim value
    values[0, 1, :2] = 1e-6
    btf.gather([0], [0], [0])
    assert btf.source._scratch.dtype == np.float16


def test_a_scratch_file_that_fails_leaves_nothing(tmp_path):
    btf, values = product(source=Slices)
    btf.source.slice = Mock(side_effect=[*values[:20], OSError("gone")])
    with pytest.raises(OSError, match="gone"):
        btf.gather([0], [0], [0])
    assert not [path for path in (tmp_path / "cache").rglob("*") if path.is_file()]


def test_downsampling_averages_boxes_however_it_is_read():
    btf, values = product(size=(5, 6))
    half = btf.downsample(2)
    assert half.shape == (2, 3)
    expected = values[:, :4].reshape(25, 2, 2, 3, 2, 3).mean((2, 4))
    np.testing.assert_allclose(np.stack(list(half)), expected, rtol=1e-6)
    np.testing.assert_allclose(half.texels([1], [2])[0], expected[:, 1, 2], rtol=1e-6)
    np.testing.assert_allclose(half.gather([7], [0], [1])[0], expected[7, 0, 1], rtol=1e-6)
    assert half.provenance["downsampled"] == 2
    with pytest.raises(ValueError, match="factor"):
        btf.downsample(6)
    for size in ((4, 6), (5, 6), (4, 7)):  # a period that is cut is none
        btf, _ = product(size=size)
        btf.periodic = True
        assert btf.downsample(2).periodic == (size == (4, 6))


def test_layout_finds_views_lights_and_their_product():
    btf, _ = product(5, 3)
    layout = btf.layout
    assert layout.views.shape == (5, 3)
    assert layout.lights.shape == (3, 3)
    np.testing.assert_array_equal(layout.grid, np.arange(15).reshape(5, 3))
    np.testing.assert_array_equal(layout.views[layout.view], btf.wo)
    assert btf.subset(np.arange(14)).layout.grid is None
    assert Layout.of(from_degrees([0, 0, 30, 30], 0), from_degrees([10, 10, 10, 20], 0)).grid is None  # one pair twice


def test_directions_that_differ_by_rounding_are_one():
    btf, _ = product(9, 8)
    noise = np.random.default_rng(0).uniform(-3e-8, 3e-8, (2, len(btf), 3))
    layout = Layout.of(btf.wo + noise[0], btf.wi + noise[1])
    assert layout.grid is not None
    np.testing.assert_array_equal(layout.grid, btf.layout.grid)
    np.testing.assert_allclose(layout.views, btf.layout.views, atol=1e-7)


@pytest.mark.parametrize("seed", range(5))
def test_a_drawn_split_is_disjoint_complete_and_keeps_the_product(seed):
    btf, _ = product(9, 8)
    split = btf.split(seed)
    parts = [split.train, *split.heldout.values()]
    np.testing.assert_array_equal(np.sort(np.concatenate(parts)), np.arange(len(btf)))
    assert set(split.heldout) == {"new view", "new light", "both new"}
    training = btf.subset(split.train).layout
    assert training.grid is not None
    views = {tuple(w) for w in training.views}
    lights = {tuple(w) for w in training.lights}
    assert not any(tuple(btf.wo[i]) in views for i in split.heldout["new view"])
    assert not any(tuple(btf.wi[i]) in lights for i in split.heldout["new light"])
    assert not any(tuple(btf.wo[i]) in views or tuple(btf.wi[i]) in lights for i in split.heldout["both new"])


def test_the_share_that_is_held_out_is_an_eighth_by_default_and_any_other_may_be_asked_for():
    btf, _ = product(9, 9)
    heldout = btf.split().heldout
    # Published records were measured with these pairs: one view of nine, and one light.
    assert heldout["new view"].tolist() == [36, 37, 39, 40, 41, 42, 43, 44]
    assert heldout["new light"].tolist() == [2, 11, 20, 29, 47, 56, 65, 74]
    assert heldout["both new"].tolist() == [38]
    nothing, third = replace(btf, holdout=0).split(), replace(btf, holdout=0.3).split()
    assert (nothing.heldout, nothing.train.tolist()) == ({}, list(range(81)))
    assert len(third.train) == 6 * 6
    with pytest.raises(InputError, match=r"data\.holdout=0\.99"):
        replace(btf, holdout=0.99).split()


def test_the_fingerprint_follows_the_share_that_is_held_out_but_where_the_data_declare_it():
    btf, _ = product()
    assert len({replace(btf, holdout=share).fingerprint for share in (0, 0.0, 0.125, 0.3)}) == 3
    declared = replace(btf, heldout=np.arange(25) >= 20)
    none = replace(declared, holdout=0)
    assert (none.fingerprint, none.split().train.tolist()) == (declared.fingerprint, list(range(20)))


def test_held_out_pairs_of_scattered_directions_are_new_on_both_sides():
    rng = np.random.default_rng(0)
    btf = BTF("x", uniform(rng, 80), uniform(rng, 80), ArraySource(np.ones((80, 1, 1, 3), np.float32)))
    split = btf.split()
    assert set(split.heldout) == {"both new"}
    np.testing.assert_array_equal(np.sort(np.concatenate([split.train, split.heldout["both new"]])), np.arange(80))


def test_a_declared_split_is_kept():
    btf, _ = product()
    mask = np.arange(25) >= 20
    btf = BTF("declared", btf.wo, btf.wi, btf.source, heldout=mask)
    assert set(product(1, 12)[0].split().heldout) == {"new light"}
    split = btf.split()
    np.testing.assert_array_equal(split.train, np.arange(20))
    np.testing.assert_array_equal(split.heldout["heldout"], np.arange(20, 25))


def test_the_fingerprint_follows_content_pairs_directions_and_split():
    btf, values = product()
    same, _ = product()
    assert btf.fingerprint == same.fingerprint
    changed = values.copy()
    changed[3, 1, 1, 1] += 1e-3
    others = [
        BTF("test", btf.wo, btf.wi, ArraySource(changed)),
        btf.subset(np.arange(24)),
        BTF("test", btf.wo, btf.wi[::-1], btf.source),
        BTF("test", btf.wo, btf.wi, btf.source, heldout=np.arange(25) > 20),
        btf.downsample(2),
    ]
    assert len({btf.fingerprint, *(other.fingerprint for other in others)}) == 6


def test_a_block_of_the_scratch_file_stays_small_whatever_the_picture(monkeypatch):
    monkeypatch.setattr("bench.btf.scratch.BLOCK", 6 * 4 * 6 * 3)
    btf, values = product(source=Slices)
    assert btf.source._scratch.shape == (-(-len(btf) // 3), 4 * 6, 3, 3)
    pairs = np.arange(len(btf))
    np.testing.assert_allclose(
        btf.gather(pairs, pairs % 4, pairs % 6), values[pairs, pairs % 4, pairs % 6], rtol=2**-11
    )


def test_few_texels_of_a_coarser_level_are_read_from_the_scratch_file_part_by_part(monkeypatch):
    monkeypatch.setattr("bench.btf.MANY_TEXELS", 6)
    btf, values = product(source=Slices)
    coarse, (rows, cols) = btf.downsample(2), np.array([[0, 1, 1], [2, 0, 1]])
    coarse.texels(rows[:1], cols[:1])  # makes the file
    reads = btf.source.reads
    texels = coarse.texels(rows, cols)
    means = values.reshape(len(btf), 2, 2, 3, 2, 3).mean((2, 4))
    np.testing.assert_allclose(texels, means[:, rows, cols].swapaxes(0, 1), rtol=2**-9)
    assert btf.source.reads == reads


def test_many_texels_are_read_out_of_slices_without_a_scratch_file(monkeypatch, caplog):
    monkeypatch.setattr("bench.btf.MANY_TEXELS", 2)
    btf, values = product(source=Slices)
    rows, cols = np.array([0, 3, 2]), np.array([5, 0, 1])
    some = btf.subset([4, 20])
    np.testing.assert_array_equal(some.texels(rows, cols), values[[4, 20]][:, rows, cols].swapaxes(0, 1))
    assert btf.source.reads == 2
    assert "scratch" not in caplog.text
