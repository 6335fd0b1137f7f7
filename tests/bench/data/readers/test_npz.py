import io
import zipfile

import numpy as np
import pytest

from bench.archive import write_npz
from bench.data.readers import open_btf
from bench.errors import InputError
from bench.hemisphere import to_degrees, ubo2014

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
        ({"radiance": np.ones((2, 3, 4), np.float32)}, r"radiance is \(2, 3, 4\) float32: it must be \(N, H, W, 3\)"),
        ({"radiance": np.ones((2, 3, 4, 3), np.uint8)}, "uint8: it must be"),
        ({"wo": None}, "no array 'wo': add it"),
        ({"wi": UP[:1]}, r"wi is \(1, 3\): it must be \(2, 3\)"),
        ({"wi": UP * 2}, r"wi\[0\]: \(0, 0, 2\) is not a unit vector"),
        ({"wi": -UP}, r"wi\[0\]: .* is not above the surface"),
        ({"wi": UP[[1, 1]]}, "pair 1: it has the same view and light as .*pair 0"),
        ({"heldout": np.array([True, True])}, "leaves pairs to train on"),
        ({"heldout": np.array([1.0, 0.0])}, "must be a mask"),
        ({"wo": np.array([{}, {}], object)}, "wo.npy.*type object is not read|wo.npy: .* bytes hold"),
    ],
)
def test_bad_arrays_are_named(refused, tmp_path, changes, message):
    np.savez(tmp_path / "a.npz", **arrays(**changes))
    refused(tmp_path / "a.npz", message)


def test_nan_is_named_when_read(tmp_path):
    values = np.ones((2, 3, 4, 3), np.float32)
    values[1, 2, 3, 0] = np.nan
    np.savez(tmp_path / "a.npz", **arrays(radiance=values))
    btf = open_btf(tmp_path / "a.npz")
    with pytest.raises(InputError, match=r"radiance\[1\]: 1 of 36 values are not finite .* \(2, 3, 0\)"):
        btf[1]
    with pytest.raises(InputError, match="not finite"):
        btf.texels([2], [3])
    with pytest.raises(InputError, match="not finite"):
        btf.gather([1], [2], [3])


def entry(shape, descr="<f4", fill=b""):
    """The bytes of an array with a header of our making."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": descr, "fortran_order": False, "shape": shape})
    return header.getvalue() + fill


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("radiance", entry((-2, -3, 4, 3), fill=b"\0" * 288), r"radiance\.npy: its shape .* is impossible"),
        ("radiance", entry((1 << 20, 1 << 20, 1 << 20, 3)), r"radiance\.npy: its \d+ bytes do not hold"),
        ("radiance", entry((2**50, 0, 4, 3)), r"radiance\.npy: its shape .* is impossible"),
        ("radiance", entry((2**40, 0, 4, 3)), "radiance is .* it must be"),
        ("wo", entry((2**47, 2**47, 0)), "wo is .* it must be"),
        ("wo", entry((1,) * 99, fill=b"\0" * 4), "wo is .* it must be"),
        ("provenance", entry((2**40,), "<U0"), r"provenance\.npy: type <U0 is not read"),
        ("provenance", entry((2**40,), "|S0"), r"provenance\.npy: type .* is not read"),
        ("provenance", entry((9,), "<U9", b"\0" * 324), r"provenance\.npy: \(9,\) <U9 is not a short text"),
        ("provenance", entry((), "<U4000000", bytes(16_000_000)), r"provenance\.npy: cannot be read"),
        ("provenance", entry((), "<U5000000", bytes(20_000_000)), r"provenance\.npy: .* is not a short text"),
        ("provenance", np.lib.format.magic(1, 0) + b"\xff\xff" + b"[" * 65535, r"provenance\.npy: cannot be read"),
        ("provenance", None, "must hold an object"),
        ("periodic", entry((2**40,), "|b1"), r"periodic\.npy: its .* bytes do not hold"),
        ("periodic", entry((0,), "|b1"), "it must be one boolean"),
        ("heldout", entry((2,), "<f8", b"\0" * 16), "must be a mask"),
    ],
)
def test_absurd_headers_are_refused_by_name(refused, tmp_path, name, content, message):
    plain = arrays() | {"provenance": np.array("[1]")}
    np.savez(tmp_path / "good.npz", **plain)
    with zipfile.ZipFile(tmp_path / "good.npz") as good, zipfile.ZipFile(tmp_path / "a.npz", "w") as bad:
        for old in good.namelist():
            if old != f"{name}.npy" or content is None:
                bad.writestr(old, good.read(old))
        if content is not None:
            bad.writestr(f"{name}.npy", content, zipfile.ZIP_DEFLATED)
    refused(tmp_path / "a.npz", message)


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
    refused(tmp_path / "a.npz", r"radiance\.npy: it claims 402653\d* bytes from \d+")


def make_mean_abrdf(path):
    """A mean ABRDF of the UBO2014's 151 directions with random values."""
    theta, phi = (angle.astype(np.float32) for angle in to_degrees(ubo2014()))
    values = np.random.default_rng(0).gamma(1.0, 1.0, (151, 151, 3)).astype(np.float32)
    np.savez(path, rgb_geomean=values, theta_deg=theta, phi_deg=phi, axis=np.array(["view", "light", "rgb"]))
    return path


@pytest.mark.parametrize("made", [True, False], ids=["made", "real"])
def test_a_mean_abrdf_is_a_btf_of_one_texel(request, tmp_path, made):
    given = make_mean_abrdf(tmp_path / "a.npz") if made else None
    path = given or request.getfixturevalue("data") / "ubo2014_mean_abrdf" / "carpet07_mean_abrdf_151x151.npz"
    btf = open_btf(path)
    with np.load(path, allow_pickle=False) as stored:
        assert np.array_equal(btf.texels([0], [0])[0], stored["rgb_geomean"].reshape(-1, 3))
    assert (len(btf), btf.shape) == (151 * 151, (1, 1))
    assert btf.layout.grid is not None
    assert np.array_equal(btf[5], btf.gather([5], [0], [0])[None])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rgb_geomean": np.ones((2, 3, 3), np.float32)}, r"rgb_geomean is \(2, 3, 3\) float32"),
        ({"theta_deg": np.array([0.0, 91.0])}, "direction 1: theta_deg = 91 degrees is outside"),
        ({"phi_deg": np.zeros(3)}, r"theta_deg and phi_deg must be \(2,\)"),
        ({"rgb_geomean": np.full((2, 2, 3), np.inf, np.float32)}, "rgb_geomean: 12 of 12 values are not finite"),
    ],
)
def test_bad_mean_abrdfs_are_named(refused, tmp_path, changes, message):
    good = {"rgb_geomean": np.ones((2, 2, 3), np.float32), "theta_deg": np.array([0.0, 9.0]), "phi_deg": np.zeros(2)}
    np.savez(tmp_path / "a.npz", **(good | changes))
    refused(tmp_path / "a.npz", message)
