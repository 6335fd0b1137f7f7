"""Pictures that state another colour space than sRGB."""

import io
import struct
import zlib

import numpy as np
import OpenEXR
import png
import pytest
from PIL import Image, ImageCms

from bench.data.readers import open_btf
from bench.data.readers.files import FolderFiles
from bench.data.readers.pictures import PictureSource, colour_note, read_picture, srgb_table
from bench.inputs.errors import InputError
from bench.metrics.display import decode_srgb

CODES = np.random.default_rng(0).integers(40, 216, (6, 5, 3), np.uint8)
SRGB = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()


def with_primaries(profile, primaries):
    """A profile whose primaries (CIE XYZ under D50) are replaced."""
    data = bytearray(profile)
    for index in range(struct.unpack(">I", data[128:132])[0]):
        tag, offset, _ = struct.unpack(">4sII", data[132 + 12 * index : 144 + 12 * index])
        if tag in primaries:
            data[offset + 8 : offset + 20] = struct.pack(">3i", *(int(value * 65536) for value in primaries[tag]))
    return bytes(data)


P3 = with_primaries(
    SRGB, {b"rXYZ": (0.5151, 0.2412, -0.0011), b"gXYZ": (0.2920, 0.6922, 0.0419), b"bXYZ": (0.1571, 0.0666, 0.7841)}
)
# http://www.brucelindbloom.com, "RGB/XYZ Matrices": Adobe RGB (1998), D65; and XYZ to linear sRGB, D65.
ADOBE_TO_XYZ = [[0.5767309, 0.1855540, 0.1881852], [0.2973769, 0.6273491, 0.0752741], [0.0270343, 0.0706872, 0.9911085]]
XYZ_TO_SRGB = [
    [3.2404542, -1.5371385, -0.4985314],
    [-0.9692660, 1.8760108, 0.0415560],
    [0.0556434, -0.2040259, 1.0572252],
]


def read(path, **options):
    return read_picture(FolderFiles(path.parent), path.name, **options)


def with_chunks(path, codes, *chunks, bits=8):
    """A PNG with some chunks after its header."""
    stream = io.BytesIO()
    height, width = codes.shape[:2]
    png.Writer(width, height, greyscale=False, bitdepth=bits).write(stream, codes.reshape(height, -1).tolist())
    data, added = stream.getvalue(), b""
    for name, content in chunks:
        added += struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))
    path.write_bytes(data[:33] + added + data[33:])
    return path


@pytest.mark.parametrize("name", ["a.jpg", "a.png"])
def test_a_picture_is_converted_by_its_profile(tmp_path, name):
    Image.fromarray(CODES).save(tmp_path / name, icc_profile=P3)
    with Image.open(tmp_path / name) as stored:
        shown = ImageCms.profileToProfile(
            stored, ImageCms.ImageCmsProfile(io.BytesIO(P3)), ImageCms.createProfile("sRGB")
        )
    np.testing.assert_allclose(read(tmp_path / name), decode_srgb(np.asarray(shown) / 255), atol=1e-6)
    as_data = srgb_table(256)[np.asarray(Image.open(tmp_path / name))]
    np.testing.assert_array_equal(read(tmp_path / name, is_colour=False), as_data)
    assert np.abs(as_data - read(tmp_path / name)).max() > 0.02
    assert "ICC profile" in colour_note(FolderFiles(tmp_path), name)


def test_a_grey_profile_is_applied_to_grey(tmp_path):
    linear = bytearray(SRGB)  # Little CMS builds no profile of grey in Python: one is written by hand
    curve = b"curv\0\0\0\0\0\0\0\0"  # no entry: linear
    white = b"XYZ \0\0\0\0" + struct.pack(">3i", 63190, 65536, 54061)
    tags = [(b"wtpt", white), (b"kTRC", curve), (b"desc", b"desc\0\0\0\0\0\0\0\5Grey\0" + bytes(75))]
    offset, table, body = 132 + 12 * len(tags), struct.pack(">I", len(tags)), b""
    for tag, content in tags:
        content += bytes(-len(content) % 4)
        table += struct.pack(">4sII", tag, offset + len(body), len(content))
        body += content
    head = linear[:128]
    head[8:12], head[16:20], head[12:16] = b"\2\x10\0\0", b"GRAY", b"mntr"
    head[0:4] = struct.pack(">I", offset + len(body))
    profile = bytes(head) + table + body
    Image.fromarray(CODES[..., 0]).save(tmp_path / "a.png", icc_profile=profile)
    expected = np.repeat(CODES[..., :1] / 255, 3, 2)
    np.testing.assert_allclose(read(tmp_path / "a.png"), expected, atol=4e-3)  # eight bits between
    Image.fromarray(CODES).save(tmp_path / "b.png", icc_profile=profile)
    with pytest.raises(InputError, match=r"b\.png: .*grey"):
        read(tmp_path / "b.png")


def test_what_states_srgb_changes_no_value(tmp_path):
    Image.fromarray(CODES).save(tmp_path / "plain.png")
    Image.fromarray(CODES).save(tmp_path / "profile.png", icc_profile=SRGB)
    chromaticities = struct.pack(">8I", 31270, 32900, 64000, 33000, 30000, 60000, 15000, 6000)
    with_chunks(tmp_path / "chunks.png", CODES, (b"gAMA", struct.pack(">I", 45455)), (b"cHRM", chromaticities))
    with_chunks(tmp_path / "srgb.png", CODES, (b"sRGB", b"\0"), (b"gAMA", struct.pack(">I", 100000)))
    with_chunks(tmp_path / "number.png", CODES, (b"cICP", b"\1\x0d\0\1"))
    files = FolderFiles(tmp_path)
    for name in ("profile.png", "chunks.png", "srgb.png", "number.png"):
        np.testing.assert_array_equal(read(tmp_path / name), read(tmp_path / "plain.png"))
        assert colour_note(files, name) == ""
        source = PictureSource(files, [name])
        assert source.conversions() == {}
        assert source.fingerprint() == files.digest([name])


@pytest.mark.parametrize(("stored", "power"), [(100000, 1.0), (50000, 2.0)])
@pytest.mark.parametrize("bits", [8, 16])
def test_gama_is_the_exponent(tmp_path, stored, power, bits):
    top = 2**bits - 1
    codes = CODES.astype(np.uint16) * (257 if bits == 16 else 1)
    path = with_chunks(tmp_path / "a.png", codes, (b"gAMA", struct.pack(">I", stored)), bits=bits)
    np.testing.assert_allclose(read(path), (codes / top) ** power, atol=1e-6)


def test_primaries_of_chrm_and_adobe_rgb_by_exif_are_converted(tmp_path):
    light = (CODES / 255) ** (563 / 256)
    expected = np.clip(light @ np.transpose(ADOBE_TO_XYZ) @ np.transpose(XYZ_TO_SRGB), 0, 1)
    gamma = struct.pack(">I", round(1e5 * 256 / 563))
    primaries = struct.pack(">8I", 31270, 32900, 64000, 33000, 21000, 71000, 15000, 6000)
    path = with_chunks(tmp_path / "a.png", CODES, (b"gAMA", gamma), (b"cHRM", primaries))
    np.testing.assert_allclose(read(path), expected, atol=3e-4)
    exif = Image.Exif()
    exif[0x8769] = {0xA001: 65535, 0xA005: {1: "R03"}}  # uncalibrated
    Image.fromarray(CODES).save(tmp_path / "b.png", exif=exif)
    np.testing.assert_allclose(read(tmp_path / "b.png"), expected, atol=3e-4)
    assert "Adobe RGB" in colour_note(FolderFiles(tmp_path), "b.png")
    exif = Image.Exif()
    exif[0x8769] = {0xA001: 1, 0xA005: {1: "R98"}}  # sRGB
    Image.fromarray(CODES).save(tmp_path / "c.png", exif=exif)
    assert colour_note(FolderFiles(tmp_path), "c.png") == ""


def test_primaries_beyond_all_colours_are_converted(tmp_path):
    # ProPhoto RGB, whose blue has a y of 0.0001, by Lindbloom's matrices to XYZ under D50, and from there to sRGB.
    to_xyz = [[0.7976749, 0.1351917, 0.0313534], [0.2880402, 0.7118741, 0.0000857], [0.0, 0.0, 0.8252100]]
    to_srgb = [
        [3.1338561, -1.6168667, -0.4906146],
        [-0.9787684, 1.9161415, 0.0334540],
        [0.0719453, -0.2289914, 1.4052427],
    ]
    expected = np.clip(CODES / 255 @ np.transpose(to_xyz) @ np.transpose(to_srgb), 0, 1)
    primaries = struct.pack(">8I", 34570, 35850, 73470, 26530, 15960, 84040, 3660, 10)
    path = with_chunks(tmp_path / "a.png", CODES, (b"gAMA", struct.pack(">I", 100000)), (b"cHRM", primaries))
    np.testing.assert_allclose(read(path), expected, atol=1e-3)


@pytest.mark.parametrize(
    ("chunk", "bits", "message"),
    [
        ((b"iCCP", b"P3\0\0" + zlib.compress(P3)), 16, "16 bits"),
        ((b"iCCP", b"x\0\0" + zlib.compress(SRGB[:16] + b"CMYK" + SRGB[20:])), 8, "ICC.*'CMYK'"),
        ((b"iCCP", b"x\0\0" + zlib.compress(SRGB[:300])), 8, "ICC"),
        ((b"iCCP", b"x\0\0no zlib"), 8, "ICC.*damaged"),
        ((b"cICP", b"\x09\x10\0\1"), 8, "cICP.*9, 16"),
        ((b"cHRM", bytes(32)), 8, "white of its cHRM"),
        ((b"cHRM", struct.pack(">8I", 31270, 32900, *3 * (30000, 60000))), 8, "primaries of its cHRM"),
    ],
)
def test_what_cannot_be_converted_is_refused(tmp_path, chunk, bits, message):
    codes = CODES.astype(np.uint16) * (257 if bits == 16 else 1)
    path = with_chunks(tmp_path / "a.png", codes, chunk, bits=bits)
    with pytest.raises(InputError, match=rf"a\.png: .*{message}"):
        read(path)
    assert read(path, is_colour=False).shape == (6, 5, 3)  # data, which no space affects


def test_a_profile_of_a_jpeg_that_pillow_passes_over_is_refused(tmp_path):
    Image.fromarray(CODES).save(tmp_path / "a.jpg", icc_profile=P3)
    whole = (tmp_path / "a.jpg").read_bytes()
    start = whole.index(b"\xff\xe2")
    end = start + 2 + int.from_bytes(whole[start + 2 : start + 4], "big")
    pixels = whole.index(b"\xff\xda", end)
    behind_size = whole[:start] + whole[end:pixels] + whole[start:end] + whole[pixels:]
    number = start + 4 + len(b"ICC_PROFILE\0") + 1  # of all parts
    of_two_parts = whole[:number] + b"\2" + whole[number + 1 :]
    for changed in (behind_size, of_two_parts):
        (tmp_path / "a.jpg").write_bytes(changed)
        with pytest.raises(InputError, match=r"a\.jpg: .*ICC profile is damaged or stands"):
            read(tmp_path / "a.jpg")


def test_provenance_and_fingerprint_tell_the_conversion(tmp_path):
    for name, profile in (("a.png", P3), ("b.png", None)):
        Image.fromarray(CODES).save(tmp_path / name, icc_profile=profile)
    (tmp_path / "dirs.lp").write_text("2\na.png 0 0 1\nb.png 0.6 0 0.8\n")
    btf = open_btf(tmp_path)
    assert "(1 of" in btf.provenance["colour_profiles"]
    assert btf.source.fingerprint() != FolderFiles(tmp_path).digest(["a.png", "b.png"])
    np.testing.assert_array_equal(btf[0], read(tmp_path / "a.png"))


# Rec. 2020 and AP1 to Rec. 709 by the matrices of ITU-R BT.2087 (inverted there) and of ACES 1.3's ACEScg to sRGB.
REC2020_TO_709 = [[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]]
AP1_TO_709 = [[1.70505, -0.62179, -0.08326], [-0.13026, 1.14080, -0.01055], [-0.02400, -0.12897, 1.15297]]
AP0_TO_709 = [[2.52169, -1.13413, -0.38756], [-0.27648, 1.37272, -0.09624], [-0.01538, -0.15298, 1.16835]]
LIGHT = np.random.default_rng(1).gamma(0.5, 5.0, (6, 5, 3)).astype(np.float32)
REC709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
REC2020 = (0.708, 0.292, 0.17, 0.797, 0.131, 0.046, 0.3127, 0.3290)
AP1 = (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767)


def write_exr(path, **header):
    planes = {name: np.ascontiguousarray(LIGHT[..., i]) for i, name in enumerate("RGB")}
    kind = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(kind | header, planes).write(str(path))


@pytest.mark.parametrize(
    ("header", "matrix", "ignored"),
    [
        ({"chromaticities": AP1}, AP1_TO_709, []),
        ({"chromaticities": REC2020}, REC2020_TO_709, []),
        ({"chromaticities": REC709}, np.eye(3), []),
        ({"colorInteropID": "lin_ap1_scene"}, AP1_TO_709, []),
        ({"colorInteropID": "lin_ap0_scene"}, AP0_TO_709, []),
        ({"colorInteropID": "lin_rec709_scene", "chromaticities": AP1}, np.eye(3), ["chromaticities"]),
        ({"colorInteropID": "unknown", "chromaticities": AP1}, AP1_TO_709, ["colorInteropID unknown"]),
        ({"oiio:ColorSpace": "ACEScg"}, AP1_TO_709, []),
        ({"oiio:ColorSpace": "lin_rec2020"}, REC2020_TO_709, []),
        ({"oiio:ColorSpace": "Linear", "chromaticities": AP1}, AP1_TO_709, ["oiio:ColorSpace Linear"]),
        ({"whiteLuminance": 100.0}, np.eye(3), ["whiteLuminance"]),
    ],
)
def test_a_space_that_an_exr_states_is_converted_and_what_is_ignored_is_named(tmp_path, header, matrix, ignored):
    write_exr(tmp_path / "a.exr", **header)
    expected = LIGHT @ np.transpose(matrix)
    np.testing.assert_allclose(read(tmp_path / "a.exr"), expected, atol=4e-4 * LIGHT.max())
    np.testing.assert_array_equal(read(tmp_path / "a.exr", is_colour=False), LIGHT)
    source = PictureSource(FolderFiles(tmp_path), ["a.exr"])
    assert source.ignored == ignored
    assert ("ignored" in source.conversions()) == bool(ignored)
    assert ("colour_profiles" in source.conversions()) == (not np.array_equal(matrix, np.eye(3)))


@pytest.mark.parametrize(
    ("header", "named"),
    [
        ({"colorInteropID": "srgb_rec709_scene"}, "srgb_rec709_scene"),
        ({"oiio:ColorSpace": "sRGB"}, "sRGB"),
        ({"chromaticities": REC709, "oiio:ColorSpace": "ACEScg"}, "ACEScg"),
    ],
)
def test_a_space_of_an_exr_that_is_unknown_or_contradicts_is_refused(tmp_path, header, named):
    write_exr(tmp_path / "a.exr", **header)
    with pytest.raises(InputError, match=rf"a\.exr: .*{named}"):
        read(tmp_path / "a.exr")


def test_primaries_and_corrections_of_hdr_are_converted_and_told(tmp_path):
    codes = np.concatenate([CODES, np.full((6, 5, 1), 128, np.uint8)], -1)
    head = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n{}\n-Y 6 +X 5\n"
    primaries = "PRIMARIES=" + " ".join(map(str, REC2020)) + "\n"
    (tmp_path / "a.hdr").write_bytes(head.format(primaries).encode() + codes.tobytes())
    np.testing.assert_allclose(read(tmp_path / "a.hdr"), CODES / 256 @ np.transpose(REC2020_TO_709), atol=2e-4)
    files = FolderFiles(tmp_path)
    assert "PRIMARIES" in colour_note(files, "a.hdr")
    (tmp_path / "b.hdr").write_bytes(head.format("COLORCORR=2 1 1\nEXPOSURE=0\n").encode() + codes.tobytes())
    source = PictureSource(files, ["b.hdr"])
    assert "COLORCORR 2 1 1" in source.conversions()["colour_profiles"]
    assert "EXPOSURE=0" in source.conversions()["ignored"]
    assert source.fingerprint() != files.digest(["b.hdr"])  # earlier versions read other values
