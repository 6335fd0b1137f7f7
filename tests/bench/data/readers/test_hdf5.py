"""Files as the repositories write them: NeuralBTF's two, NeuMIP's and the Hierarchical Architecture's."""

import sys

import numpy as np
import pytest

from bench.btf import BTF
from bench.conformance.check import tiny_btf
from bench.data.frame import mean_lobe
from bench.data.readers import hdf5, open_btf
from bench.errors import InputError
from bench.hemisphere import uniform

h5py = pytest.importorskip("h5py", reason="needs the extra hdf5")
KEYS = ("ground_color", "ground_camera_dir", "ground_light")


@pytest.fixture
def pictures(btf):
    return np.stack(list(btf))


@pytest.fixture
def full(btf, pictures, samples, tmp_path):
    """The file that NeuralBTF trains on."""
    path = tmp_path / "real_felt_01_full_factor1.hdf5"
    samples.write_hdf5(path, btf.wo, btf.wi, pictures)
    return path


def test_a_file_of_one_direction_a_picture_is_read_from_the_bottom_row_up(full, btf, pictures):
    with h5py.File(full) as file:
        np.testing.assert_array_equal(file["ground_color"][:, 0], pictures[:, -1])
    opened = open_btf(full)
    assert (opened.name, opened.shape, opened.periodic) == (full.stem, btf.shape, False)
    np.testing.assert_allclose(opened.wo, btf.wo, atol=1e-6)
    np.testing.assert_allclose(opened.wi, btf.wi, atol=1e-6)
    np.testing.assert_array_equal(np.stack(list(opened)), pictures)
    np.testing.assert_array_equal(opened[3], pictures[3])
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
    assert opened.provenance["heldout"] == f"the 3 pairs of {heldout.name}"
    assert opened.fingerprint != open_btf(heldout).fingerprint
    assert len(open_btf(heldout)) == 3
    samples.write_hdf5(heldout, wo, wi, pictures[4:7, :3])
    refused(full, "its pictures are 6 x 3, those of .*full.* 6 x 5: move it", heldout)
    samples.write_hdf5(heldout, btf.wo[:1], btf.wi[:1], pictures[:1])
    refused(full, "pair 0: it has the same view and light as .*full.*: pair 0", heldout)


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


def test_the_frame_is_right_where_the_file_was_written_as_it_is_read(samples, tmp_path):
    surface = tiny_btf(8, 25, 25)
    samples.write_hdf5(tmp_path / "a.hdf5", surface.wo, surface.wi, np.stack(list(surface)))
    btf = open_btf(tmp_path / "a.hdf5")
    assert btf.layout.grid is not None
    lobe, known = mean_lobe(btf), mean_lobe(surface)
    assert lobe.given == pytest.approx(known.given, abs=1e-5)


def per_pixel(directions, shape, toward=-1):
    """Directions of travel as NeuMIP stores them: x and y for each pixel."""
    return np.broadcast_to(toward * directions[:, None, None, :2], (len(directions), *shape, 2)).astype("f2")


@pytest.mark.parametrize("key", KEYS[1:])
def test_directions_for_each_pixel_are_refused_by_name(refused, btf, pictures, tmp_path, key):
    """NeuMIP's generator and the Hierarchical Architecture's writers store these, in halves, a picture a chunk."""
    chunk = (1, *btf.shape)
    with h5py.File(tmp_path / "cloth.hdf5", "w") as file:
        file.attrs["base_radius"] = 1 / 10
        for name, side in zip(KEYS[1:], (btf.wo, btf.wi), strict=True):
            stored = per_pixel(side, btf.shape) if name == key else side[:, :2]
            file.create_dataset(name, data=stored, chunks=(*chunk, 2) if name == key else None)
        file.create_dataset("ground_color", data=pictures.astype("f2"), chunks=(*chunk, 3))
        file.create_dataset("ground_camera_target_loc", data=np.zeros((12, *btf.shape, 2), "f2"))
        file.create_dataset("ground_camera_query_radius", data=np.zeros((12, *btf.shape, 1), "f2"))
    refused(tmp_path / "cloth.hdf5", rf"cloth\.hdf5: {key} is \(12, 5, 6, 2\), a direction for each pixel")


def without(file, key):
    del file[key]


def instead(key, values, **options):
    def change(file):
        del file[key]
        file.create_dataset(key, data=values, **options)

    return change


def unfilled(key, shape, **options):
    def change(file):
        del file[key]
        file.create_dataset(key, shape, "f4", **options)

    return change


def linked(file):
    del file["ground_light"]
    file["ground_light"] = h5py.ExternalLink("/etc/passwd", "/x")


def outside(file):
    del file["ground_light"]
    file.create_dataset("ground_light", (12, 2), "f4", external=[("/etc/passwd", 0, 96)])


def virtual(file):
    del file["ground_light"]
    layout = h5py.VirtualLayout((12, 2), "f4")
    layout[:] = h5py.VirtualSource("other.hdf5", "x", (12, 2))
    file.create_virtual_dataset("ground_light", layout)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda file: without(file, "ground_light"), r"no data set ground_light \(it holds ground_camera_dir, gr"),
        (instead("ground_color", np.zeros((12, 5, 6, 4), "f4")), r"ground_color is \(12, 5, 6, 4\): it must be \(N, H"),
        (instead("ground_color", np.zeros((0, 5, 6, 3), "f4")), r"ground_color is \(0, 5, 6, 3\)"),
        (instead("ground_color", np.zeros((12, 5, 6, 3), "u1")), r"ground_color is .* uint8: it must hold floats"),
        (instead("ground_light", np.zeros((11, 2), "f4")), r"ground_light is \(11, 2\): it must be \(12, 2\), x and y"),
        (instead("ground_light", np.full((12, 2), np.nan, "f4")), r"ground_light\[0\]: .* is not a unit vector"),
        (instead("ground_light", np.full((12, 2), 0.9, "f4")), r"ground_light\[0\]: \(0\.9, 0\.9, 0\) is not a unit"),
        (instead("ground_light", np.tile([1.0, 0], (12, 1))), r"ground_light\[0\]: \(1, 0, 0\) is not above"),
        (instead("ground_light", np.zeros((12, 2), "f4")), r"pair 7: it has the same view and light as .* pair 6"),
        (instead("ground_light", h5py.Empty("f4")), "ground_light is None float32"),
        (unfilled("ground_color", (12, 1 << 20, 1 << 20, 3), chunks=(1, 64, 64, 3)), "is more than its bytes can hold"),
        (unfilled("ground_light", (1 << 40, 2), chunks=(64, 2)), "ground_light of .* is more than its bytes can hold"),
        (unfilled("ground_color", (12, 1 << 12, 1 << 12, 3), chunks=(12, 1 << 12, 1 << 12, 3)), "is more than its"),
        (linked, "no data set ground_light"),
        (outside, "ground_light lies in other files: copy it into this one"),
        (virtual, "ground_light lies in other files: copy it into this one"),
    ],
)
def test_a_file_that_is_no_btf_is_an_error_with_the_name_of_the_data_set(refused, full, change, message):
    with h5py.File(full, "r+") as file:
        change(file)
    refused(full, message)


def test_values_that_are_not_finite_are_named(full, pictures):
    with h5py.File(full, "r+") as file:
        file["ground_color"][7, 1, 1] = np.inf
    with pytest.raises(InputError, match=r"ground_color\[7\]: 3 of 90 values are not finite"):
        list(open_btf(full))


def test_bytes_that_are_cut_off_are_an_error(full):
    whole = full.read_bytes()
    for length in (9, 100, len(whole) // 2, len(whole) - 1):
        full.write_bytes(whole[:length])
        with pytest.raises(InputError, match=str(full)):
            open_btf(full)[11]


def test_without_h5py_the_message_names_the_extra(refused, full, monkeypatch):
    monkeypatch.setitem(sys.modules, "h5py", None)
    refused(full, r"factor1\.hdf5: reading HDF5 needs h5py: pip install 'neubtf-bench\[hdf5\]'")


def test_scattered_reads_agree_with_slices(full, pictures, tmp_path, monkeypatch):
    monkeypatch.setenv("NEUBTF_CACHE", str(tmp_path / "cache"))
    btf = open_btf(full)
    assert isinstance(btf, BTF)
    np.testing.assert_allclose(btf.gather([3, 11], [0, 4], [5, 1]), pictures[[3, 11], [0, 4], [5, 1]], rtol=1e-3)
