import re
import sys

import numpy as np
import pytest

from bench.data.readers import hdf5, open_btf
from bench.directions.hemisphere import uniform
from bench.inputs.errors import InputError

h5py = pytest.importorskip("h5py", reason="needs the extra hdf5")
KEYS = ("ground_color", "ground_camera_dir", "ground_light")


@pytest.fixture
def pictures(btf):
    return np.stack(list(btf))


@pytest.fixture
def full(btf, pictures, samples, tmp_path):
    path = tmp_path / "real_felt_01_full_factor1.hdf5"
    samples.write_hdf5(path, btf.wo, btf.wi, pictures)
    return path


def test_a_file_of_one_direction_a_picture_is_read_from_the_bottom_row_up(full, btf, pictures, tmp_path, monkeypatch):
    monkeypatch.setenv("NEUBTF_CACHE", str(tmp_path / "cache"))
    with h5py.File(full) as file:
        np.testing.assert_array_equal(file["ground_color"][:, 0], pictures[:, -1])
    opened = open_btf(full)
    assert (opened.name, opened.shape, opened.periodic) == (full.stem, btf.shape, False)
    np.testing.assert_allclose(opened.wo, btf.wo, atol=1e-6)
    np.testing.assert_allclose(opened.wi, btf.wi, atol=1e-6)
    np.testing.assert_array_equal(np.stack(list(opened)), pictures)
    np.testing.assert_array_equal(opened[3], pictures[3])
    some = [3, 11], [0, 4], [5, 1]
    np.testing.assert_allclose(opened.gather(*some), pictures[some], rtol=1e-3)
    assert {"new view", "new light", "both new"} > set(opened.split().heldout)


def test_the_file_of_random_directions_beside_it_is_the_test_split(refused, full, btf, pictures, samples):
    rng = np.random.default_rng(0)
    wo, wi = uniform(rng, 3), uniform(rng, 3)
    heldout = full.with_name("real_felt_01_random_factor1.hdf5")
    samples.write_hdf5(heldout, wo, wi, pictures[4:7])
    opened = open_btf(full)
    np.testing.assert_array_equal(np.flatnonzero(opened.heldout), [12, 13, 14])
    np.testing.assert_allclose(opened.wo[12:], wo, atol=1e-6)
    np.testing.assert_array_equal(opened[13], pictures[5])
    np.testing.assert_array_equal(opened.crop(1, 2, 2, 3)[14], pictures[6, 1:3, 2:5])
    assert re.search(rf"\b3\b.*{heldout.name}", opened.provenance["heldout"])
    assert opened.fingerprint != open_btf(heldout).fingerprint
    assert len(open_btf(heldout)) == 3
    samples.write_hdf5(heldout, wo, wi, pictures[4:7, :3])
    refused(full, "6 x 3.*full.* 6 x 5", heldout)
    samples.write_hdf5(heldout, btf.wo[:1], btf.wi[:1], pictures[:1])
    refused(full, "pair 0: .*full.*: pair 0", heldout)


def test_a_file_above_a_limit_is_told_which(refused, full, monkeypatch):
    monkeypatch.setattr(hdf5, "MAX_PIXELS", 29)
    refused(full, "29 pixels")
    monkeypatch.setattr(hdf5, "MAX_PAIRS", 11)
    refused(full, "11 pairs")


@pytest.mark.parametrize("dtype", ["f2", "f4", "f8"])
@pytest.mark.parametrize("chunks", [None, (1, 5, 6, 3), (5, 2, 4, 1)])
def test_all_floats_and_chunks_give_the_same_windows(full, btf, pictures, samples, monkeypatch, chunks, dtype):
    monkeypatch.setattr(hdf5, "AT_ONCE", 12 * 5 * 6 * 4)
    values = (pictures / 8).astype(dtype)
    packed = {} if chunks is None else {"chunks": chunks, "compression": "gzip", "shuffle": True}
    samples.write_hdf5(full, btf.wo, btf.wi, values, **packed)
    opened, expected = open_btf(full), values.astype(np.float32)
    np.testing.assert_array_equal(np.stack(list(opened)), expected)
    np.testing.assert_array_equal(np.stack(list(opened.subset([11, 2, 7, 0]))), expected[[11, 2, 7, 0]])
    window = opened.crop(1, 2, 3, 4)
    assert type(window.source) is hdf5.HDF5Source  # reads no more than the window
    np.testing.assert_array_equal(np.stack(list(window)), expected[:, 1:4, 2:6])
    np.testing.assert_array_equal(window.crop(1, 1, 2, 2)[5], expected[5, 2:4, 3:5])
    around = opened.crop(3, 4, 4, 4)
    np.testing.assert_array_equal(around[2], np.roll(expected[2], (-3, -4), (0, 1))[:4, :4])
    assert len({opened.fingerprint, window.fingerprint, around.fingerprint}) == 3


def virtual(file):
    layout = h5py.VirtualLayout((12, 2), "f4")
    layout[:] = h5py.VirtualSource("other.hdf5", "x", (12, 2))
    file.create_virtual_dataset("ground_light", layout)


def half_written(file):
    colour = file.create_dataset("ground_color", (12, 5, 6, 3), "f4", chunks=(1, 5, 6, 3))
    colour[3:7] = 1.0


COLOUR, LIGHT = KEYS[0], KEYS[2]


@pytest.mark.parametrize(
    ("key", "change", "message"),
    [
        (LIGHT, None, "data set"),
        (LIGHT, h5py.ExternalLink("/etc/passwd", "/x"), "link.*/x.*/etc/passwd"),
        (LIGHT, h5py.SoftLink("/ground_camera_dir"), "link.*/ground_camera_dir"),
        (LIGHT, h5py.SoftLink("/nowhere"), "link.*/nowhere"),
        (LIGHT, {"shape": (12, 2)}, "written"),
        (COLOUR, {"shape": (12, 5, 6, 3), "chunks": (1, 5, 6, 3)}, "written"),
        (COLOUR, half_written, "8 of the 12 chunks"),
        (LIGHT, virtual, "other files"),
        (LIGHT, {"shape": (12, 2), "external": [("/etc/passwd", 0, 96)]}, "other files"),
        (COLOUR, np.zeros((12, 5, 6, 4), "f4"), r"\(12, 5, 6, 4\)"),
        (COLOUR, np.zeros((0, 5, 6, 3), "f4"), r"\(0, 5, 6, 3\)"),
        (COLOUR, np.zeros((12, 5, 6, 3), "u1"), "uint8"),
        (LIGHT, np.zeros((11, 2), "f4"), r"\(11, 2\)"),
        (LIGHT, np.zeros((12, 5, 6, 2), "f2"), r"\(12, 5, 6, 2\)"),  # for each pixel, as NeuMIP's generator
        (KEYS[1], np.zeros((12, 5, 6, 2), "f2"), r"\(12, 5, 6, 2\)"),
        (LIGHT, np.full((12, 2), np.nan, "f4"), "unit vector"),
        (LIGHT, np.full((12, 2), 0.9, "f4"), "unit vector"),
        (LIGHT, np.tile([1.0, 0], (12, 1)), "not above"),
        (LIGHT, np.zeros((12, 2), "f4"), None),
        (LIGHT, h5py.Empty("f4"), "None float32"),
        (COLOUR, {"shape": (12, 1 << 20, 1 << 20, 3), "chunks": (1, 64, 64, 3)}, "bytes"),
        (LIGHT, {"shape": (1 << 40, 2), "chunks": (64, 2)}, "bytes"),
        (COLOUR, {"shape": (12, 1 << 12, 1 << 12, 3), "chunks": (12, 1 << 12, 1 << 12, 3)}, "bytes"),
    ],
)
def test_a_file_that_is_no_btf_is_an_error_with_the_name_of_the_data_set(refused, full, key, change, message):
    with h5py.File(full, "r+") as file:
        del file[key]
        if isinstance(change, dict):
            file.create_dataset(key, dtype="f4", **change)
        elif callable(change):
            change(file)
        elif change is not None:
            file[key] = change
    refused(full, f"{key}.*{message}|{message}.*{key}" if message else "pair 7: .* pair 6")


def test_values_that_are_not_finite_or_cut_off_are_named(refused, full, monkeypatch):
    with h5py.File(full, "r+") as file:
        doubles = file["ground_color"][:].astype(np.float64)
        del file["ground_color"]
        file["ground_color"] = doubles
        file["ground_color"][5, 1, 1] = 1e300
        file["ground_color"][7, 1, 1] = np.inf
    with pytest.raises(InputError, match=r"ground_color\[5\]: 3 of 90"):
        open_btf(full)[5]
    with pytest.raises(InputError, match=r"ground_color\[7\]: 3 of 90"):
        open_btf(full)[7]
    others = open_btf(full).subset(np.array([4, 6, 8]))  # around them, so read with them
    assert np.isfinite(np.stack(list(others))).all()
    whole = full.read_bytes()
    for length in (9, 100, len(whole) // 2, len(whole) - 1):
        full.write_bytes(whole[:length])
        with pytest.raises(InputError, match=str(full)):
            open_btf(full)[11]
    monkeypatch.setitem(sys.modules, "h5py", None)
    refused(full, r"neubtf-bench\[hdf5\]")
