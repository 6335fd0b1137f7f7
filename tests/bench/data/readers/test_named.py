import io
import re
import zipfile

import numpy as np
import pytest
from PIL import Image

from bench.data.readers import open_btf
from bench.data.readers.exr import XYZ_TO_REC709
from bench.data.readers.pictures import srgb_table
from bench.directions.hemisphere import to_degrees, ubo2003
from bench.inputs.errors import InputError


def make_ubo2003(path):
    """A zip of 3 views of 81 lights; each picture is flat, of the codes (2 tl, pl // 2, 2 tv)."""
    directions = np.round(np.stack(to_degrees(ubo2003()), -1)).astype(int)
    with zipfile.ZipFile(path, "w") as archive:
        for tv, pv in directions[[0, 5, 40]]:
            for index, (tl, pl) in enumerate(directions):
                jpeg = io.BytesIO()
                Image.new("RGB", (8, 8), (2 * tl, pl // 2, 2 * tv)).save(jpeg, "JPEG", quality=95)
                name = f"{index:05d} tl{tl:03d} pl{pl:03d} tv{tv:03d} pv{pv:03d}.jpg"
                archive.writestr(f"MADE8/tv{tv:03d}_pv{pv:03d}/{name}", jpeg.getvalue())
    return path


@pytest.mark.parametrize("made", [True, False], ids=["made", "real"])
def test_ubo2003_pictures_are_flat_codes_of_their_angles(request, tmp_path, made):
    given = make_ubo2003(tmp_path / "a.zip") if made else None
    btf = open_btf(given or request.getfixturevalue("data") / "tiny_formats" / "tiny_ubo2003.zip")
    assert (len(btf), btf.shape) == (3 * 81, (8, 8))
    assert btf.layout.grid is not None
    np.testing.assert_allclose(np.sort(btf.layout.lights, 0), np.sort(ubo2003(), 0), atol=1e-6)
    theta_o, _ = to_degrees(btf.wo)
    theta_i, phi_i = to_degrees(btf.wi)
    codes = np.round([2 * theta_i, np.round(phi_i) // 2, 2 * theta_o]).T
    for index, picture in enumerate(btf):
        decoded = np.searchsorted(srgb_table(256), picture)
        # JPEG at quality 95 rounds in YCbCr: a few codes.
        assert np.abs(decoded - codes[index]).max() <= 5


def test_atrium_hdr_keeps_highlights_and_stands_upright(tmp_path, samples):
    btf = open_btf(samples.make_named(tmp_path, samples.UBO2003 + ".hdr", True))
    for index, name in enumerate(samples.named_names(samples.UBO2003)):
        pair = 2 * [0, 15].index(int(name[2:5])) + [0, 15].index(int(re.search(r"tl(\d+)", name)[1]))
        np.testing.assert_allclose(btf[pair], samples.picture(index) * 2.0**-6)
    assert max(s.max() for s in btf) > 1


def test_utia_exr_is_xyz_and_png_is_srgb(tmp_path, samples):
    png = open_btf(samples.make_named(tmp_path / "a", samples.UTIA + ".png", False))
    exr = open_btf(samples.make_named(tmp_path / "b", samples.UTIA + ".exr", False))
    assert png.provenance["format"] == exr.provenance["format"] == "UTIA"
    np.testing.assert_array_equal(png[0], srgb_table(256)[samples.picture(0)])
    np.testing.assert_allclose(exr[0], samples.picture(0) / 64 @ XYZ_TO_REC709.T, rtol=1e-5, atol=1e-5)
    assert np.array_equal(png.wo, exr.wo)


def test_names_of_bonn_and_sets_that_were_measured_in_part_are_read(tmp_path, samples):
    pattern = "set/WOOL_{index:05d}_tl{tl:03d}_pl{pl:03d}_tv{tv:03d}_pv{pv:03d}.jpg"
    zipped = open_btf(samples.make_named(tmp_path / "a", pattern, True))
    folder = samples.make_named(tmp_path / "b", samples.UBO2003 + ".jpg", False)
    btf = open_btf(folder)
    assert np.array_equal([*zipped], [*btf])
    assert np.array_equal(zipped.wi, btf.wi)
    assert btf.provenance["format"] == zipped.provenance["format"] == "UBO2003"
    next(folder.rglob("*tl015*tv000*")).unlink()
    btf = open_btf(folder)
    assert len(btf) == 3
    assert btf.layout.grid is None


def write(path, entries, **options):
    with zipfile.ZipFile(path, "w", **options) as archive:
        for name, data in entries.items():
            archive.writestr(name, data)
    return path


def jpeg(samples, tmp_path):
    samples.save(tmp_path / "p.jpg", samples.picture(0))
    return (tmp_path / "p.jpg").read_bytes()


NAME = "set/tv000_pv000/00000 tl000 pl000 tv000 pv000.jpg"


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["../" + NAME], "leads out"),
        (["/" + NAME], "leads out"),
        ([NAME, NAME.replace("tl000", "tl091")], "tl091.*theta"),
        ([NAME, NAME.replace("pv000.jpg", "pv999.jpg")], "phi of the view"),
        ([NAME, NAME.replace("set/", "copy/")], "copy"),
        (["a.txt", "b.txt"], r"a\.txt, b\.txt"),
    ],
)
def test_bad_archives_name_the_entry(refused, tmp_path, samples, names, message):
    refused(write(tmp_path / "a.zip", dict.fromkeys(names, jpeg(samples, tmp_path))), message)


def test_archives_that_are_damaged_or_claim_what_they_do_not_hold_are_refused(refused, tmp_path, samples):
    def resized(data, claim):
        path = write(tmp_path / "a.zip", {NAME: data}, compression=zipfile.ZIP_DEFLATED)
        path.write_bytes(path.read_bytes().replace(len(data).to_bytes(4, "little"), claim.to_bytes(4, "little")))
        return path

    refused(resized(bytes(100_000), 1 << 30), "1073741824")
    data = jpeg(samples, tmp_path)
    with pytest.raises(InputError, match="checksum"):
        open_btf(resized(data, len(data) - 100))[0]
    path = write(tmp_path / "a.zip", {NAME: data})
    path.write_bytes(path.read_bytes()[:-30])
    refused(path, "incomplete")
    samples.save(tmp_path / "p.exr", samples.picture(0))
    path = write(tmp_path / "b.zip", {"tl000_pl000_tv000_pv000.exr": (tmp_path / "p.exr").read_bytes()})
    with pytest.raises(InputError, match="extract"):
        open_btf(path)[0]
