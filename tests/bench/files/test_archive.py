import zipfile

import numpy as np
import pytest

from bench.files.archive import MAX_FILE, MOST_AT_ONCE, read_arrays
from bench.inputs.errors import InputError

HEADER = 128  # bytes of a `.npy` before its values

ARRAYS = {
    "plain": np.arange(12, dtype=np.float32).reshape(3, 4),
    "turned": np.asfortranarray(np.arange(6, dtype=np.int16).reshape(2, 3)),
    "none": np.zeros((0, 3), bool),
    "number": np.array(7),
}


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_arrays_come_back_writable_and_as_they_were_stored(save, tmp_path):
    save(tmp_path / "a.npz", **ARRAYS)
    arrays = read_arrays(tmp_path / "a.npz", MAX_FILE)
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(arrays[name], array)
        assert (arrays[name].dtype, arrays[name].flags.writeable) == (array.dtype, True)
    arrays["plain"][0, 0] = 5
    assert list(read_arrays(tmp_path / "a.npz", MAX_FILE, ["number", "absent"])) == ["number"]
    assert read_arrays(tmp_path / "a.npz", MAX_FILE)["plain"][0, 0] == 0


def test_a_header_of_the_second_version_is_read_and_one_of_a_later_is_refused(tmp_path):
    for version in ((2, 0), (3, 0)):
        with zipfile.ZipFile(tmp_path / f"{version[0]}.npz", "w") as archive, archive.open("plain.npy", "w") as entry:
            np.lib.format.write_array(entry, np.arange(5), version)
    np.testing.assert_array_equal(read_arrays(tmp_path / "2.npz", MAX_FILE)["plain"], np.arange(5))
    with pytest.raises(InputError, match=r"plain\.npy.*\(3, 0\)"):
        read_arrays(tmp_path / "3.npz", MAX_FILE)


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_a_value_that_was_altered_is_refused_by_name(save, tmp_path):
    save(tmp_path / "a.npz", plain=np.arange(1000.0))
    data = bytearray((tmp_path / "a.npz").read_bytes())
    data[len(data) // 2] ^= 1
    (tmp_path / "a.npz").write_bytes(data)
    with pytest.raises(InputError, match=r"a\.npz: plain\.npy: "):
        read_arrays(tmp_path / "a.npz", MAX_FILE)


@pytest.mark.parametrize("beyond", [1, 70, 300, 5000])
def test_an_array_that_ends_just_behind_a_whole_piece_is_read_to_its_end(beyond, tmp_path):
    # Of zeros the inflater reads the last bytes of the stream before it has given all that they stand for.
    values = np.zeros(MOST_AT_ONCE + beyond - HEADER, np.uint8)
    np.savez_compressed(tmp_path / "a.npz", values=values)
    assert np.array_equal(read_arrays(tmp_path / "a.npz", MAX_FILE)["values"], values)


def test_an_uncompressed_entry_that_claims_more_than_it_has_is_damaged(tmp_path):
    np.savez(tmp_path / "a.npz", plain=np.arange(1000.0))
    data = (tmp_path / "a.npz").read_bytes()
    directory = data.index(b"PK\x01\x02")
    claimed = directory + 24  # where the inflated size stands, four bytes
    (tmp_path / "a.npz").write_bytes(data[:claimed] + b"\0\0\1\0" + data[claimed + 4 :])
    with pytest.raises(InputError, match=r"65536 bytes, but 8128 are stored: .*damaged"):
        read_arrays(tmp_path / "a.npz", MAX_FILE)
