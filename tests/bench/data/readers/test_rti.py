import re

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import gaussian_filter

from bench.data.readers import open_btf
from bench.data.readers.pictures import srgb_table
from bench.data.readers.rti import _is_entry
from bench.directions.hemisphere import from_angles


def make(folder, lines, images=3):
    for i in range(images):
        Image.new("RGB", (4, 3), (50 * i, 0, 0)).save(folder / f"im {i}.png")
    (folder / "dirs.lp").write_text("\n".join(lines) + "\n")
    return folder


GOOD = ["3", "im 0.png 0 0 1", "im 1.png 0.6 0 0.8", r"C:\photos\im 2.png 0 0.6 0.8"]


def test_one_view_many_lights_as_photographed(tmp_path):
    btf = open_btf(make(tmp_path, GOOD))
    assert (btf.wo == [0, 0, 1]).all()
    np.testing.assert_allclose(btf.wi, [[0, 0, 1], [0.6, 0, 0.8], [0, 0.6, 0.8]], atol=1e-7)
    np.testing.assert_allclose([s[0, 0, 0] for s in btf], srgb_table(256)[[0, 50, 100]])
    assert "photographed" in btf.provenance["cosine"]
    assert len(open_btf(tmp_path / "dirs.lp")) == 3


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["4", *GOOD[1:], "im 3.png 0.8 0 0.6"], r"dirs\.lp, line 5: im 3\.png"),
        (["4", *GOOD[1:]], r"dirs\.lp: line 1 .*4 .*3"),
        (["0"], r"dirs\.lp: it lists no image: add"),
        (["", "4", *GOOD[1:]], r"dirs\.lp: line 2 .*4 .*3"),
        (["1", "im 0.png a b c"], "line 2: 'im"),
        (["1", "im 0.png 0 0 -1"], "line 2: .* not above"),
        (["2", "im 0.png 0 0 -1", "im 1.png 0.6 0 -0.8"], "line 2: .*negated"),
        (["2", "im 0.png 0 0 1", "im 0.png 0.6 0 0.8"], r"line 3: im 0\.png .*line 2"),
        ([*GOOD[:3], "im two.png 0 0.6 0.8"], r"line 4: im two\.png"),
        ([], r"dirs\.lp: .*empty"),
        (["1", "im 0.png nan 0 1"], "line 2: .* unit vector"),
        (["2", "im 0.png 0 0 1", "im 1.png 0 0 1"], "line 3: .*line 2"),
        (["1", "../../../etc/passwd 0 0 1"], "line 2: passwd"),
        (None, r"dirs\.lp, other\.lp"),
    ],
)
def test_bad_lists_name_the_line(refused, tmp_path, lines, message):
    make(tmp_path, GOOD if lines is None else lines)
    if lines is None:
        (tmp_path / "other.lp").write_text("0\n")
    refused(tmp_path, message)


@pytest.mark.parametrize("place", ["", "dirs.lp"])
def test_a_list_without_its_count_is_a_list(tmp_path, caplog, place):
    btf = open_btf(make(tmp_path, GOOD[1:]) / place)
    np.testing.assert_allclose(btf.wi, [[0, 0, 1], [0.6, 0, 0.8], [0, 0.6, 0.8]], atol=1e-7)
    assert re.search(r"dirs\.lp: .*\b3\b", caplog.text)


def test_a_name_of_other_case_or_accents_means_the_only_file_like_it(refused, tmp_path):
    make(tmp_path, ["2", "IM 0.PNG 0 0 1", "caf\u00e9.png 0.6 0 0.8"])
    (tmp_path / "im 1.png").rename(tmp_path / "cafe\u0301.png")  # as macOS writes it
    assert open_btf(tmp_path).source.names == ["im 0.png", "cafe\u0301.png"]
    Image.new("RGB", (4, 3)).save(tmp_path / "im 0.Png")
    refused(tmp_path, r"line 2: IM 0\.PNG.*im 0\.Png.*im 0\.png", "dirs.lp")


def test_hidden_lists_are_no_lists(tmp_path):
    (make(tmp_path, GOOD) / "._dirs.lp").write_bytes(b"\0\5\x16\7")
    assert len(open_btf(tmp_path)) == 3


@pytest.mark.parametrize("encoding", ["utf-8-sig", "latin-1", "utf-16"])
@pytest.mark.parametrize("place", ["", "dirs.lp"])
def test_lists_in_other_encodings_are_read(refused, tmp_path, encoding, place):
    make(tmp_path, [])
    (tmp_path / "im 0.png").rename(tmp_path / "b\u00fc.png")
    text = "2\nb\u00fc.png 0 0 1\nim 1.png 0.6 0 0.8\n"
    (tmp_path / "dirs.lp").write_text(text, encoding)
    assert open_btf(tmp_path / place).source.names == ["b\u00fc.png", "im 1.png"]
    (tmp_path / "dirs.lp").write_bytes(text.encode("utf-16-le"))
    refused(tmp_path, "UTF-16")


def make_bumps(folder, lights, shape):
    rows, cols = np.mgrid[: shape[0], : shape[1]]
    x, y = cols / 5, -rows / 7  # y points up
    p, q = np.cos(x) * np.sin(y) / 2, np.sin(x) * np.cos(y) * 5 / 14  # the slopes of 2.5 sin x sin y
    normals = np.stack([-p, -q, np.ones(shape)], -1) / np.sqrt(1 + p**2 + q**2)[..., None]
    azimuth = 2 * np.pi * np.arange(lights) / lights
    theta = np.radians(np.array([15, 30, 45])[np.arange(lights) % 3])
    wi = from_angles(theta, azimuth)
    for i, light in enumerate(wi):
        codes = np.searchsorted(srgb_table(256), 0.9 * np.maximum(normals @ light, 0)).clip(0, 255)
        Image.fromarray(codes.astype(np.uint8)).convert("RGB").save(folder / f"{i}.png")
    lines = [f"{i}.png {x:.6f} {y:.6f} {z:.6f}" for i, (x, y, z) in enumerate(wi)]
    (folder / "dirs.lp").write_text("\n".join([str(lights), *lines]) + "\n")
    return folder


SETS = [("made", 30, (60, 80)), ("gold_icon", 72, (395, 402)), ("painted_door", 60, (439, 487))]


@pytest.mark.parametrize(("name", "lights", "shape"), SETS)
def test_the_normals_of_a_set_are_those_of_a_surface(request, tmp_path, name, lights, shape):
    given = make_bumps(tmp_path, lights, shape) if name == "made" else None
    btf = open_btf(given or request.getfixturevalue("data") / "rti" / name)
    assert (len(btf), btf.shape) == (lights, shape)
    btf = btf.subset(range(0, lights, 3))
    values = np.stack([s.mean(-1).reshape(-1) for s in btf])
    x, y, z = np.linalg.lstsq(btf.wi, values, rcond=None)[0].reshape(3, *shape)
    p, q = (gaussian_filter(np.clip(-side / np.maximum(z, 1e-3), -2, 2), 1.5) for side in (x, y))
    # The slopes of a surface have no curl, d2z/dxdy = d2z/dydx; with y pointing down the two would differ in sign.
    assert np.corrcoef(-np.gradient(p, axis=0).reshape(-1), np.gradient(q, axis=1).reshape(-1))[0, 1] > 0.05


@pytest.mark.parametrize("line", ["", "0.1 0.2 0.3 0.4", "Fig. 3 1 2 3", "word 1 2 3", "im.png 1 2"])
def test_a_line_that_names_no_picture_begins_no_list(line):
    assert not _is_entry(line)
    assert _is_entry("im 0.png 0 0 1")
