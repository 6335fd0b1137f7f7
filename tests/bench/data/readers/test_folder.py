import numpy as np
import pytest
from PIL import Image

from bench.data.open import open_named
from bench.data.readers import open_btf
from bench.data.readers.folder import write_folder
from bench.directions.hemisphere import from_angles, from_degrees
from bench.files.exr import write_exr
from bench.inputs.errors import InputError

HEADER = "file,theta_o_deg,phi_o_deg,theta_i_deg,phi_i_deg"


def make(path, lines, header=HEADER, size=(4, 3)):
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
    before = again.fingerprint
    write_exr(tmp_path / "out" / again.source.names[0], np.ones((5, 6, 3), np.float32))
    assert open_btf(tmp_path / "out").fingerprint != before
    with pytest.raises(InputError, match=r"pairs\.csv"):
        write_folder(btf, tmp_path / "out")
    (tmp_path / "out" / "btf.json").write_text("[1]")
    with pytest.raises(InputError, match=r"btf\.json"):
        open_btf(tmp_path / "out")


def test_columns_in_any_order_and_pairs_sorted_by_view_then_light(tmp_path):
    folder = make(
        tmp_path / "x",
        ["15,20,30,0, c.png,x", "", " \t", "0,0,0,0,a.png,y", "15,10,10,0,b.png,z"],
        "theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,file,comment",
    )
    btf = open_btf(folder)
    np.testing.assert_allclose(btf.wo, from_degrees([0, 10, 30], 0), atol=1e-7)
    np.testing.assert_allclose(btf.wi, from_degrees([0, 15, 15], [0, 10, 20]), atol=1e-7)
    assert btf.shape == (3, 4)
    assert btf.heldout is None
    assert [float(s[0, 0, 0]) for s in btf] == sorted(float(s[0, 0, 0]) for s in btf)
    assert len(open_btf(folder / "pairs.csv")) == 3


def test_angles_that_seem_to_be_radians_are_refused_until_the_user_says_what_they_are(refused, tmp_path):
    folder = make(tmp_path / "x", ["a.png,0,0,0.5,6.2", "b.png,0.1,1,1.5,3"])
    refused(folder, r"pairs\.csv: .*--radians.*--degrees.*data\.angles")
    radians, degrees = (open_btf(folder, angles=unit) for unit in ("radians", "degrees"))
    np.testing.assert_allclose(radians.wi, from_angles(np.array([0.5, 1.5]), np.array([6.2, 3])), atol=1e-7)
    np.testing.assert_allclose(radians.wo, from_angles(np.array([0, 0.1]), np.array([0, 1])), atol=1e-7)
    np.testing.assert_allclose(degrees.wi, from_degrees([0.5, 1.5], [6.2, 3]), atol=1e-7)
    assert "radians" in radians.provenance["angles"]
    write_folder(degrees, tmp_path / "out")
    np.testing.assert_allclose(open_btf(tmp_path / "out").wi, degrees.wi, atol=1e-7)  # which holds degrees for sure
    np.testing.assert_allclose(open_named(str(tmp_path / "out"), {}).wi, degrees.wi, atol=1e-7)  # also for a suite
    assert len(open_btf(make(tmp_path / "y", ["a.png,0,0,0.5,6.2", "b.png,0,0,15,3"]))) == 2
    refused(make(tmp_path / "z", ["a.png,0,0,0.5,6.2", "b.png,0,0,15,7"]), "theta_i_deg", angles="radians")


A, B = "a.png,0,0,0,0", "b.png,0,0,10,0"
BAD = [
    ([A, "d.png,0,0,10,0"], r"line 3: d\.png"),
    ([A, "a.png,0,0,10,0"], r"line 3: a\.png .*line 2"),
    ([A, "b.png,0,0,95,0"], "line 3: theta_i_deg"),
    ([A, "B.PNG,0,0,10,0"], r"line 3: B\.PNG.*b\.png"),
    (HEADER.replace(",", ";").encode() + b"\na.png;0;0;0,5;0\n", "semicolons"),
    (HEADER.replace(",", "\t").encode() + b"\na.png\t0\t0\t0\t0\n", "tabs"),
    (HEADER.replace("theta", "Theta").encode() + b"\n", "Theta_o_deg, Theta_i_deg"),
    ([A, "b.png,90,0,0,0"], "line 3: theta_o_deg"),
    ([A, "b.png,0,0,10,4000"], "line 3: phi_i_deg"),
    ([A, B, "c.png,0,0,10,360"], "line 4: .*line 3"),
    ([A, "b.png,0,0,ten,0"], "line 3: theta_i_deg"),
    ([A, "b.png,0,0"], "line 3: 3 cells"),
    ([], r"pairs\.csv: .*picture"),
    ([A, "../b.png,0,0,10,0"], "line 3: .*leads out"),
    ([A, "pairs.csv,0,0,10,0"], r"pairs\.csv: .*b'file"),
    ([A, "d5.png,0,0,10,0"], r"line 3: d5\.png .*5 x 3"),
    (b"", "empty"),
    (b"\xff\xfe\x00\x01", "UTF-8"),
    (b"file,theta_o_deg\n", "phi_o_deg, theta_i_deg, phi_i_deg"),
    (f"{HEADER},file\n{A},a.png\n".encode(), "column 'file' stands twice .*: leave one out"),
    (f"{HEADER},split\n{A},test\n".encode(), "line 2: split"),
    (f"{HEADER},split\n{A},heldout\n".encode(), "heldout"),
]


@pytest.mark.parametrize(("given", "message"), BAD)
def test_bad_lists_name_the_file_and_the_line(refused, tmp_path, given, message):
    folder = make(tmp_path / "x", given if isinstance(given, list) else [])
    Image.new("RGB", (5, 3)).save(folder / "d5.png")
    if isinstance(given, bytes):
        (folder / "pairs.csv").write_bytes(given)
    refused(folder, message)


def test_a_list_whose_name_differs_in_letter_case_is_named(refused, tmp_path):
    folder = make(tmp_path / "x", [A, B])
    (folder / "pairs.csv").rename(folder / "Pairs.CSV")
    refused(folder, r"Pairs\.CSV: .*pairs\.csv")


def test_a_list_under_another_name_is_not_taken_for_the_one_beside_it(refused, tmp_path):
    folder = make(tmp_path / "x", [A, B])
    (folder / "some.csv").write_text(f"{HEADER}\n{A}\n")
    assert len(open_btf(folder / "pairs.csv")) == 2
    refused(folder / "some.csv", r"call it pairs\.csv")


def test_what_says_periodic_is_a_boolean(refused, tmp_path):
    folder = make(tmp_path / "x", [A, B])
    (folder / "btf.json").write_text('{"periodic": "false"}')
    refused(folder, r"btf\.json: periodic = 'false': write true or false")


def test_nan_pixels_are_named_when_the_slice_is_read(tmp_path):
    folder = make(tmp_path / "x", ["bad.exr,0,0,0,0"])
    picture = np.ones((4, 4, 3), np.float32)
    picture[2, 1] = np.nan
    write_exr(folder / "bad.exr", picture)
    btf = open_btf(folder)
    with pytest.raises(InputError, match=r"bad\.exr: 3 of 48 .* \(2, 1, 0\)"):
        btf[0]
