import numpy as np
import pytest
from PIL import Image

from bench.data.readers import open_btf
from bench.data.readers.folder import write_exr, write_folder
from bench.errors import InputError
from bench.hemisphere import from_degrees

HEADER = "file,theta_o_deg,phi_o_deg,theta_i_deg,phi_i_deg"


def make(path, lines, header=HEADER, size=(4, 3)):
    """A folder with grey pictures a.png, b.png, c.png and a list."""
    path.mkdir(exist_ok=True)
    for i, name in enumerate("abc"):
        Image.new("RGB", size, (60 * i + 10,) * 3).save(path / f"{name}.png")
    (path / "pairs.csv").write_text("\n".join([header, *lines]) + "\n")
    return path


def test_written_folder_reads_back_without_loss(tmp_path, btf):
    write_folder(btf, tmp_path / "out")
    again = open_btf(tmp_path / "out")
    assert np.array_equal([*again], [*btf])
    np.testing.assert_allclose(again.wo, btf.wo, atol=2e-7)
    np.testing.assert_allclose(again.wi, btf.wi, atol=2e-7)
    assert np.array_equal(again.heldout, btf.heldout)
    assert (again.name, again.periodic) == ("sample", True)
    assert again.provenance["note"] == "kept"
    assert again[0].max() > 1


def test_a_folder_is_never_overwritten(tmp_path, btf):
    write_folder(btf, tmp_path)
    with pytest.raises(InputError, match=r"already holds pairs\.csv: choose another"):
        write_folder(btf, tmp_path)


def test_columns_in_any_order_and_pairs_sorted_by_view_then_light(tmp_path):
    folder = make(
        tmp_path / "x",
        ["15,20,30,0, c.png,x", "", "0,0,0,0,a.png,y", "15,10,10,0,b.png,z"],
        "theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,file,comment",
    )
    btf = open_btf(folder)
    np.testing.assert_allclose(btf.wo, from_degrees([0, 10, 30], 0), atol=1e-7)
    np.testing.assert_allclose(btf.wi, from_degrees([0, 15, 15], [0, 10, 20]), atol=1e-7)
    assert btf.shape == (3, 4)
    assert btf.heldout is None
    assert [float(s[0, 0, 0]) for s in btf] == sorted(float(s[0, 0, 0]) for s in btf)
    assert len(open_btf(folder / "pairs.csv")) == 3


def test_angles_that_seem_to_be_radians_are_warned_of(tmp_path, caplog):
    open_btf(make(tmp_path / "x", ["a.png,0,0,0.5,6.2", "b.png,0,0,1.5,3"]))
    assert "pairs.csv: every theta is below 1.6 degrees" in caplog.text
    caplog.clear()
    open_btf(make(tmp_path / "y", ["a.png,0,0,0.5,6.2", "b.png,0,0,15,3"]))
    assert caplog.text == ""


def test_split_column_declares_what_is_held_out(tmp_path):
    lines = ["a.png,0,0,0,0,train", "b.png,0,0,10,0,heldout", "c.png,0,0,20,0,train"]
    btf = open_btf(make(tmp_path / "x", lines, HEADER + ",split"))
    assert btf.heldout.tolist() == [False, True, False]
    assert btf.split().heldout["heldout"].tolist() == [1]


A, B = "a.png,0,0,0,0", "b.png,0,0,10,0"
BAD = {
    "missing image": ([A, "d.png,0,0,10,0"], r"pairs\.csv, line 3: d\.png is missing: add the picture"),
    "theta": ([A, "b.png,0,0,95,0"], r"line 3: theta_i_deg = 95 degrees is outside \[0, 90\)"),
    "horizon": ([A, "b.png,90,0,0,0"], r"line 3: theta_o_deg = 90 degrees is outside"),
    "phi": ([A, "b.png,0,0,10,4000"], r"line 3: phi_i_deg = 4000 degrees is outside"),
    "nan angle": ([A, "b.png,nan,0,10,0"], r"line 3: theta_o_deg = nan degrees is outside"),
    "duplicate": ([A, B, "c.png,0,0,10,360"], r"line 4: it has the same view and light as .*line 3: leave one"),
    "duplicate at the pole": ([A, "b.png,0,90,0,180"], r"line 3: it has the same view and light as .*line 2"),
    "no number": ([A, "b.png,0,0,ten,0"], r"line 3: theta_i_deg = 'ten' is not a number: give degrees"),
    "cells": ([A, "b.png,0,0"], r"line 3: 3 cells under 5 columns"),
    "no rows": ([], r"pairs\.csv: it lists no picture"),
    "outside": ([A, "../b.png,0,0,10,0"], r"line 3: the name '\.\./b\.png' leads out of the folder"),
    "absolute": ([A, "/etc/passwd,0,0,10,0"], r"line 3: the name '/etc/passwd' leads out"),
    "no picture": ([A, "pairs.csv,0,0,10,0"], r"pairs\.csv: it begins with b'file,the', like no known picture"),
}


@pytest.mark.parametrize(("lines", "message"), BAD.values(), ids=BAD.keys())
def test_bad_lists_name_the_file_and_the_line(refused, tmp_path, lines, message):
    refused(make(tmp_path / "x", lines), message)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"pairs\.csv: it is empty"),
        (b"\xff\xfe\x00\x01", "comma-separated text in UTF-8"),
        ("file,theta_o_deg\n", r"without column phi_o_deg, theta_i_deg, phi_i_deg"),
        (HEADER + ",file\na.png,0,0,0,0,a.png\n", "with a column twice"),
        (HEADER + ",split\na.png,0,0,0,0,test\n", r"line 2: split = 'test': write train or heldout"),
        (HEADER + ",split\na.png,0,0,0,0,heldout\n", "every line is heldout"),
    ],
)
def test_bad_headers_say_what_is_needed(refused, tmp_path, text, message):
    folder = make(tmp_path / "x", [])
    (folder / "pairs.csv").write_bytes(text if isinstance(text, bytes) else text.encode())
    refused(folder, message)


def test_sizes_that_differ_name_both_pictures(refused, tmp_path):
    folder = make(tmp_path / "x", [A, B])
    Image.new("RGB", (5, 3)).save(folder / "b.png")
    refused(folder, r"line 3: b\.png is 5 x 3 pixels, but a\.png is 4 x 3: give all")


def test_nan_pixels_are_named_when_the_slice_is_read(tmp_path):
    folder = make(tmp_path / "x", ["bad.exr,0,0,0,0"])
    picture = np.ones((4, 4, 3), np.float32)
    picture[2, 1] = np.nan
    write_exr(folder / "bad.exr", picture)
    btf = open_btf(folder)
    with pytest.raises(InputError, match=r"bad\.exr: 3 of 48 values are not finite .* \(2, 1, 0\): mend"):
        btf[0]


def test_fingerprint_follows_the_pictures(tmp_path):
    folder = make(tmp_path / "x", [A, B])
    before = open_btf(folder).fingerprint
    assert open_btf(folder).fingerprint == before
    Image.new("RGB", (4, 3), (1, 2, 3)).save(folder / "b.png")
    assert open_btf(folder).fingerprint != before


def test_scattered_reads_agree_with_slices(tmp_path, monkeypatch, btf):
    monkeypatch.setenv("NEUBTF_CACHE", str(tmp_path / "cache"))
    write_folder(btf, tmp_path / "x")
    again = open_btf(tmp_path / "x")
    # The scratch file is half float: a relative error of 2^-11.
    np.testing.assert_allclose(again.texels([4], [5])[0], [s[4, 5] for s in btf], rtol=5e-4, atol=1e-6)
    np.testing.assert_allclose(again.gather([3], [1], [2])[0], btf[3][1, 2], rtol=5e-4, atol=1e-6)


def test_notes_that_are_no_object_are_refused(refused, tmp_path, btf):
    write_folder(btf, tmp_path / "x")
    (tmp_path / "x" / "btf.json").write_text("[1]")
    refused(tmp_path / "x", r"btf\.json: it must hold an object")
