import io
import zipfile

import numpy as np
import pytest

from bench.btf.npz import write_npz
from bench.data.readers import open_btf
from bench.directions.hemisphere import from_angles, from_degrees, to_degrees, ubo2014
from bench.inputs.errors import InputError

UP = np.array([[0, 0, 1], [0.6, 0, 0.8]], np.float32)


def arrays(**changes):
    good = {"radiance": np.ones((2, 3, 4, 3), np.float32), "wo": UP[[0, 0]], "wi": UP}
    return {k: v for k, v in (good | changes).items() if v is not None}


def test_written_file_reads_back_memory_mapped(tmp_path, btf):
    write_npz(btf, tmp_path / "any.name")
    again = open_btf(tmp_path / "any.name")
    assert isinstance(again.source.values, np.memmap)
    assert np.array_equal([*again], [*btf])
    assert np.array_equal(again.wo, btf.wo)
    assert np.array_equal(again.heldout, btf.heldout)
    assert again.periodic
    assert again.provenance["ppmm"] == 10.0
    assert np.array_equal(again.texels([4, 0], [5, 1]), btf.texels([4, 0], [5, 1]))
    with np.load(tmp_path / "any.name", allow_pickle=False) as plain:
        assert plain["radiance"].shape == (12, 5, 6, 3)


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_files_of_numpy_are_read(tmp_path, save):
    values = np.random.default_rng(0).random((2, 3, 4, 3))
    save(tmp_path / "a.npz", **arrays(radiance=values, heldout=np.array([False, True])))
    btf = open_btf(tmp_path / "a.npz")
    np.testing.assert_allclose([*btf], values, rtol=1e-6)
    assert btf.split().train.tolist() == [0]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"radiance": np.ones((2, 3, 4), np.float32)}, r"radiance is \(2, 3, 4\)"),
        ({"radiance": np.ones((2, 3, 4, 3), np.uint8)}, "uint8: .*255"),
        ({"radiance": np.ones((2, 3, 4, 3), np.int64)}, "int64: .*255"),
        ({"wo": None}, "'wo'"),
        ({"wi": UP[:1]}, r"wi is \(1, 3\)"),
        ({"wi": UP * 2}, r"wi\[0\]: .* unit vector"),
        ({"wi": -UP}, r"wi\[0\]: .* not above"),
        ({"wi": UP[[1, 1]]}, "pair 1: .*pair 0"),
        ({"heldout": np.array([True, True])}, "heldout.*train"),
        ({"heldout": np.array([1.0, 0.0])}, "mask"),
        ({"wo": np.array([{}, {}], object)}, r"wo\.npy"),
        ({"wo": UP > 0}, r"wo is \(2, 3\) bool"),
        ({"rgb_geomean": np.ones((2, 3, 3), np.float32)}, r"rgb_geomean is \(2, 3, 3\)"),
        ({"theta_deg": np.array([0.0, 91.0])}, "direction 1: theta_deg"),
        ({"phi_deg": np.zeros(3)}, "phi_deg"),
        ({"rgb_geomean": np.full((2, 2, 3), np.inf, np.float32)}, "rgb_geomean: 12 of 12"),
    ],
)
def test_bad_arrays_are_named(refused, tmp_path, changes, message):
    mean = {"rgb_geomean": np.ones((2, 2, 3), np.float32), "theta_deg": np.array([0.0, 9.0]), "phi_deg": np.zeros(2)}
    np.savez(tmp_path / "a.npz", **(mean | changes if set(changes) <= set(mean) else arrays(**changes)))
    refused(tmp_path / "a.npz", message)


def test_nan_is_named_when_read(tmp_path):
    values = np.ones((2, 3, 4, 3), np.float32)
    values[1, 2, 3, 0] = np.nan
    np.savez(tmp_path / "a.npz", **arrays(radiance=values))
    btf = open_btf(tmp_path / "a.npz")
    for reading in (lambda: btf[1], lambda: btf.texels([2], [3]), lambda: btf.gather([1], [2], [3])):
        with pytest.raises(InputError, match=r"\b1\b.*finite"):
            reading()


def test_radians_of_a_mean_abrdf_are_refused_or_converted_and_vectors_have_no_unit(refused, tmp_path, caplog):
    mean = {
        "rgb_geomean": np.ones((2, 2, 3), np.float32),
        "theta_deg": np.array([0.0, 1.5]),
        "phi_deg": np.array([0, 6]),
    }
    np.savez(tmp_path / "a.npz", **mean)
    refused(tmp_path / "a.npz", "theta_deg.*phi_deg: .*--radians.*--degrees")
    btf = open_btf(tmp_path / "a.npz", angles="radians")
    np.testing.assert_allclose(btf.wi, from_angles(np.array([0, 1.5]), np.array([0, 6]))[[0, 1, 0, 1]], atol=1e-7)
    write_npz(btf, tmp_path / "c.npz")  # of vectors; it keeps the note on the angles that they were made of
    assert "radians" in open_btf(tmp_path / "c.npz").provenance["angles"]
    refused(tmp_path / "c.npz", "leave out --degrees", angles="degrees")
    np.savez(tmp_path / "b.npz", **arrays(wi=from_degrees([0, 1.5], [0, 6])))
    assert len(open_btf(tmp_path / "b.npz")) == 2
    assert "radians" in caplog.text
    refused(tmp_path / "b.npz", "--radians", angles="radians")


def entry(shape, descr="<f4", fill=b""):
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": descr, "fortran_order": False, "shape": shape})
    return header.getvalue() + fill


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("radiance", entry((-2, -3, 4, 3), fill=b"\0" * 288), "impossible"),
        ("radiance", entry((1 << 20, 1 << 20, 1 << 20, 3)), "do not hold"),
        ("radiance", entry((2**50, 0, 4, 3)), "impossible"),
        ("radiance", entry((2**40, 0, 4, 3)), "must be"),
        ("wo", entry((2**47, 2**47, 0)), "must be"),
        ("wo", entry((1,) * 99, fill=b"\0" * 4), "must be"),
        ("provenance", entry((2**40,), "<U0"), "<U0"),
        ("provenance", entry((9,), "<U9", b"\0" * 324), "short text"),
        ("provenance", entry((), "<U4000000", bytes(16_000_000)), "cannot be read"),
        ("provenance", entry((), "<U5000000", bytes(20_000_000)), "short text"),
        ("provenance", np.lib.format.magic(1, 0) + b"\xff\xff" + b"[" * 65535, "cannot be read"),
        ("provenance", None, "object"),
        ("periodic", entry((2**40,), "|b1"), "do not hold"),
        ("periodic", entry((0,), "|b1"), "one boolean"),
        ("heldout", entry((2,), "<f8", b"\0" * 16), "mask"),
    ],
)
def test_absurd_headers_are_refused_by_name(refused, tmp_path, name, content, message):
    np.savez(tmp_path / "good.npz", **arrays(), provenance=np.array("[1]"))
    with zipfile.ZipFile(tmp_path / "good.npz") as good, zipfile.ZipFile(tmp_path / "a.npz", "w") as bad:
        for old in good.namelist():
            if old != f"{name}.npy" or content is None:
                bad.writestr(old, good.read(old))
        if content is not None:
            bad.writestr(f"{name}.npy", content, zipfile.ZIP_DEFLATED)
    refused(tmp_path / "a.npz", f"{name}.*{message}")


@pytest.mark.long
def test_an_archive_that_inflates_beyond_all_proportion_is_refused_before_it_is_inflated(refused, tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as bomb:
        for name in ("wo", "wi"):
            with bomb.open(f"{name}.npy", "w") as file:
                np.lib.format.write_array(file, UP)
        with bomb.open("radiance.npy", "w") as file:
            file.write(entry((2, 4096, 4096, 3)))
            for _ in range(384):
                file.write(bytes(1 << 20))
    assert (tmp_path / "a.npz").stat().st_size < 1 << 20
    refused(tmp_path / "a.npz", r"radiance\.npy: .*402653")


def test_a_mean_abrdf_is_a_btf_of_one_texel(tmp_path):
    theta, phi = (angle.astype(np.float32) for angle in to_degrees(ubo2014()))
    values = np.random.default_rng(0).gamma(1.0, 1.0, (151, 151, 3)).astype(np.float32)
    np.savez(tmp_path / "a.npz", rgb_geomean=values, theta_deg=theta, phi_deg=phi)
    btf = open_btf(tmp_path / "a.npz")
    assert np.array_equal(btf.texels([0], [0])[0], values.reshape(-1, 3))
    assert (len(btf), btf.shape) == (151 * 151, (1, 1))
    assert btf.layout.grid is not None
    assert np.array_equal(btf[5], btf.gather([5], [0], [0])[None])
