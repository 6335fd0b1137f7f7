import numpy as np
import pytest

from bench.data.readers.files import FolderFiles
from bench.data.readers.pictures import picture_size, read_picture
from bench.inputs.errors import InputError

RNG = np.random.default_rng(0)


def read(path):
    files = FolderFiles(path.parent)
    picture = read_picture(files, path.name)
    assert picture.shape == (*picture_size(files, path.name), 3)
    return picture


def flat_hdr(rgbe, size, extra=""):
    return f"#?RADIANCE\n{extra}FORMAT=32-bit_rle_rgbe\n\n{size}\n".encode() + rgbe.tobytes()


def test_hdr_agrees_with_the_formula_in_every_orientation(tmp_path):
    rgbe = RNG.integers(0, 256, (5, 6, 4), np.uint8)
    rgbe[..., 3] = RNG.integers(120, 140, (5, 6))
    expected = rgbe[..., :3] * np.ldexp(1.0, rgbe[..., 3:].astype(int) - 136)
    views = {
        "-Y 5 +X 6": expected,
        "+Y 5 +X 6": expected[::-1],
        "-Y 5 -X 6": expected[:, ::-1],
        "+X 5 -Y 6": expected.swapaxes(0, 1),
        "-X 5 +Y 6": expected[::-1, ::-1].swapaxes(0, 1),
    }
    for size, upright in views.items():
        (tmp_path / "a.hdr").write_bytes(flat_hdr(rgbe, size, "EXPOSURE=2\n"))
        np.testing.assert_allclose(read(tmp_path / "a.hdr"), upright / 2, rtol=1e-6)
    assert expected.max() > 1


def test_hdr_with_runs(tmp_path):
    line = b"\2\2\0\x0a" + b"\x8a\x40" + b"\x05\1\2\3\4\5\x85\x09" + b"\x8a\x20" + b"\x8a\x81"
    (tmp_path / "a.hdr").write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 10\n" + line * 2)
    picture = read(tmp_path / "a.hdr")
    assert picture.shape == (2, 10, 3)
    np.testing.assert_allclose(picture[1, :, 1] * 128, [1, 2, 3, 4, 5, 9, 9, 9, 9, 9])


@pytest.mark.parametrize(
    ("lines", "factors"),
    [
        ("EXPOSURE=2\nEXPOSURE=4\n", 8),
        ("COLORCORR=2 1 0.5\n", [2, 1, 0.5]),
        ("COLORCORR=2 1 0.5\nEXPOSURE=2\nCOLORCORR=2 4 1\n", [8, 8, 1]),
        ("EXPOSURE=0\nGAMMA=1\n", 1),
    ],
)
def test_stated_factors_are_divided_out(tmp_path, lines, factors):
    rgbe = RNG.integers(0, 256, (3, 4, 4), np.uint8)
    rgbe[..., 3] = 128
    (tmp_path / "a.hdr").write_bytes(flat_hdr(rgbe, "-Y 3 +X 4", lines))
    np.testing.assert_allclose(read(tmp_path / "a.hdr"), rgbe[..., :3] / 256 / factors, rtol=1e-6)


@pytest.mark.parametrize(
    ("change", "remedy"),
    [
        (lambda data: data.replace(b"\n", b"\r\n"), "binary"),
        (lambda data: data.replace(b"FORMAT=32-bit_rle_rgbe\n", b""), "FORMAT=32-bit_rle_rgbe"),
        (lambda data: data.replace(b"rle_rgbe", b"rle_xyze"), "32-bit_rle_xyze.* save it as RGBE or EXR"),
        (lambda data: data.replace(b"FORMAT", b"GAMMA=1\nGAMMA=2.2\nFORMAT"), "GAMMA is 2.2, .* save it as linear"),
        (lambda data: data.replace(b"FORMAT", b"EXPOSURE=-1\nFORMAT"), "EXPOSURE is -1"),
        (lambda data: data.replace(b"FORMAT", b"COLORCORR=1 0 1\nFORMAT"), "COLORCORR is 1 0 1"),
        (lambda data: data.replace(b"FORMAT", b"COLORCORR=1 1\nFORMAT"), "'1 1'"),
        (lambda data: data.replace(b"FORMAT", b"PRIMARIES=0.3 0.3 0.3 0.3 0.3 0.3 0.3 0.3\nFORMAT"), "PRIMARIES"),
    ],
)
def test_headers_that_state_other_values_are_refused_with_their_remedy(tmp_path, change, remedy):
    (tmp_path / "a.hdr").write_bytes(change(flat_hdr(np.full((3, 4, 4), 128, np.uint8), "-Y 3 +X 4")))
    with pytest.raises(InputError, match=rf"a\.hdr: .*{remedy}"):
        read(tmp_path / "a.hdr")
