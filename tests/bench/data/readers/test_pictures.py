import io
import struct
import zlib

import imageio.v3 as imageio
import numpy as np
import OpenEXR
import png
import pytest
from PIL import Image, ImageOps
from skimage.color import xyz2rgb

from bench.data.readers.exr import XYZ_TO_REC709
from bench.data.readers.files import FolderFiles
from bench.data.readers.pictures import PictureSource, picture_size, read_alpha, read_picture
from bench.files.exr import write_exr
from bench.inputs.errors import InputError

RNG = np.random.default_rng(0)
CODES = RNG.integers(0, 256, (7, 9, 3), np.uint8)


def read(path, **options):
    files = FolderFiles(path.parent)
    size = picture_size(files, path.name)
    picture = read_picture(files, path.name, **options)
    assert picture.shape == (*size, 3)
    assert picture.dtype == np.float32
    return picture


def decode(codes, top):
    x = codes.astype(np.float64) / top
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


def exr(path, channels, header=None):
    base = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(base | (header or {}), channels).write(str(path))


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "L", "LA", "P", "1"])
def test_8_bit_png_of_every_kind(tmp_path, mode):
    image = Image.fromarray(CODES).convert(mode)
    image.save(tmp_path / "a.png")
    np.testing.assert_allclose(read(tmp_path / "a.png"), decode(np.asarray(image.convert("RGB")), 255), atol=1e-6)


@pytest.mark.parametrize(
    ("planes", "options"), [(3, {"greyscale": False}), (1, {"greyscale": True}), (4, {"alpha": True})]
)
def test_16_bit_png_keeps_all_bits(tmp_path, planes, options):
    codes = RNG.integers(0, 65536, (7, 9, planes)).astype(np.uint16)
    options = {"greyscale": False} | options
    with open(tmp_path / "a.png", "wb") as stream:
        png.Writer(9, 7, bitdepth=16, **options).write(stream, codes.reshape(7, -1))
    rgb = codes[..., :3] if planes > 1 else np.repeat(codes, 3, 2)
    np.testing.assert_allclose(read(tmp_path / "a.png"), decode(rgb, 65535), atol=1e-6)


def test_jpeg_agrees_with_another_decoder(tmp_path):
    for name, mode in (("rgb.jpg", "RGB"), ("grey.jpg", "L")):
        Image.fromarray(CODES).convert(mode).save(tmp_path / name, quality=95)
        codes = imageio.imread(tmp_path / name)
        codes = codes if codes.ndim == 3 else np.repeat(codes[..., None], 3, 2)
        np.testing.assert_allclose(read(tmp_path / name), decode(codes, 255), atol=1e-6)


@pytest.mark.parametrize("noted", range(1, 9))
@pytest.mark.parametrize("name", ["a.jpg", "a.png"])
def test_a_picture_is_turned_as_its_exif_notes_say(tmp_path, name, noted):
    exif = Image.Exif()
    exif[0x0112] = noted
    Image.fromarray(CODES).save(tmp_path / name, exif=exif)
    with Image.open(tmp_path / name) as stored:
        shown = np.asarray(ImageOps.exif_transpose(stored))  # another implementation
    assert shown.shape == ((9, 7, 3) if noted > 4 else (7, 9, 3))
    np.testing.assert_allclose(read(tmp_path / name), decode(shown, 255), atol=1e-6)
    files = FolderFiles(tmp_path)
    assert (PictureSource(files, [name]).fingerprint() == files.digest([name])) == (noted == 1)


def test_notes_behind_bytes_that_fill_up_are_read(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(CODES).save(tmp_path / "a.jpg", exif=exif)
    plain = (tmp_path / "a.jpg").read_bytes()
    at = plain.index(b"\xff\xe1")  # the segment of the notes
    (tmp_path / "b.jpg").write_bytes(plain[:at] + b"\xff\xff" + plain[at:])
    np.testing.assert_array_equal(read(tmp_path / "b.jpg"), read(tmp_path / "a.jpg"))


XMP = b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:Description tiff:Orientation="6"/></x:xmpmeta>'


def raw_profile(exif):
    """The text of ImageMagick for a camera's notes: a name, their length and their hexadecimal digits."""
    return b"Raw profile type exif\0\nexif\n%8d\n%s\n" % (len(exif), exif.hex().encode())


def png_with(name, content, before):
    def change(data):
        at = data.index(before) - 4
        return data[:at] + chunk(name, content) + data[at:]

    return change


def jpeg_with(content, before):
    def change(data):
        at = data.index(before, 2)
        return data[:at] + b"\xff\xe1" + struct.pack(">H", len(content) + 2) + content + data[at:]

    return change


EXIF = Image.Exif()
EXIF[0x0112] = 6
NOTES = EXIF.tobytes()
PLACES = {
    "png eXIf": ("PNG", png_with(b"eXIf", NOTES.removeprefix(b"Exif\0\0"), b"IDAT")),
    "png raw profile": ("PNG", png_with(b"tEXt", raw_profile(NOTES), b"IDAT")),
    "png XMP": ("PNG", png_with(b"iTXt", b"XML:com.adobe.xmp\0\0\0\0\0" + XMP, b"IDAT")),
    "jpeg first": ("JPEG", jpeg_with(NOTES, b"\xff\xe0")),
    "jpeg behind the frame": ("JPEG", jpeg_with(NOTES, b"\xff\xda")),
    "jpeg far behind the frame": ("JPEG", jpeg_with(NOTES + bytes(9000), b"\xff\xda")),
    "jpeg XMP": ("JPEG", jpeg_with(b"http://ns.adobe.com/xap/1.0/\0" + XMP, b"\xff\xda")),
}


@pytest.mark.parametrize("place", PLACES)
def test_a_picture_is_turned_wherever_pillow_turns_it(tmp_path, place):
    form, change = PLACES[place]
    stream = io.BytesIO()
    Image.fromarray(CODES).save(stream, form)
    (tmp_path / "a").write_bytes(change(stream.getvalue()))
    with Image.open(tmp_path / "a") as stored:
        shown = np.asarray(ImageOps.exif_transpose(stored))
    assert shown.shape == (9, 7, 3) or place == "jpeg XMP"  # which Pillow reads since version 11
    np.testing.assert_allclose(read(tmp_path / "a"), decode(shown, 255), atol=1e-6)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        (b"eXIf", NOTES.removeprefix(b"Exif\0\0")),
        (b"tEXt", raw_profile(NOTES)),
        (b"iTXt", b"XML:com.adobe.xmp\0\0\0\0\0" + XMP),
    ],
)
@pytest.mark.parametrize("bits", [8, 16])
def test_a_png_whose_orientation_stands_behind_its_pixels_is_refused(tmp_path, name, content, bits):
    with open(tmp_path / "a.png", "wb") as stream:
        png.Writer(9, 7, bitdepth=bits, greyscale=False).write(stream, CODES.reshape(7, -1))
    plain = (tmp_path / "a.png").read_bytes()
    (tmp_path / "a.png").write_bytes(png_with(name, content, b"IEND")(plain))
    with pytest.raises(InputError, match=r"a\.png: .*upright"):
        read(tmp_path / "a.png")
    (tmp_path / "a.png").write_bytes(png_with(b"tEXt", b"Software\0x", b"IEND")(plain))
    assert read(tmp_path / "a.png").shape == (7, 9, 3)


def with_notes(content, payload):
    at = content.index(b"IDAT") - 4
    return content[:at] + chunk(b"eXIf", payload) + content[at:]


def test_a_16_bit_png_is_turned_too_and_notes_far_from_the_start_or_damaged_are_met(tmp_path):
    codes = RNG.integers(0, 65536, (7, 9, 3)).astype(np.uint16)
    with open(tmp_path / "a.png", "wb") as stream:
        png.Writer(9, 7, bitdepth=16, greyscale=False).write(stream, codes.reshape(7, -1))
    exif = Image.Exif()
    exif[0x0112] = 6
    plain, notes = (tmp_path / "a.png").read_bytes(), exif.tobytes().removeprefix(b"Exif\0\0")
    (tmp_path / "a.png").write_bytes(with_notes(plain, notes))
    np.testing.assert_allclose(read(tmp_path / "a.png"), decode(np.rot90(codes, -1), 65535), atol=1e-6)
    far = plain[:33] + chunk(b"tEXt", b"x" * 9999) + plain[33:]
    (tmp_path / "b.png").write_bytes(with_notes(far, notes))
    assert read(tmp_path / "b.png").shape == (9, 7, 3)
    for damaged in (notes[:9], b"\xff" * 99, notes.replace(b"\x06", b"\x63")):
        (tmp_path / "c.png").write_bytes(with_notes(plain, damaged))
        np.testing.assert_allclose(read(tmp_path / "c.png"), decode(codes, 65535), atol=1e-6)


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_exr_keeps_highlights(tmp_path, dtype):
    picture = RNG.gamma(0.5, 20, (7, 9, 3)).astype(dtype)
    plane = np.ascontiguousarray(picture[..., 0])
    for channels in ({"RGB": picture}, dict.fromkeys("RGBA", plane), {"Y": plane}):
        exr(tmp_path / "a.exr", channels)
        expected = picture if "RGB" in channels else np.repeat(plane[..., None], 3, 2)
        assert np.array_equal(read(tmp_path / "a.exr"), expected.astype(np.float32))
    assert picture.max() > 1


def test_exr_in_xyz_becomes_rec709(tmp_path):
    rgb = RNG.random((7, 9, 3)) * 0.9
    xyz = (rgb @ np.linalg.inv(XYZ_TO_REC709).T).astype(np.float32)
    exr(tmp_path / "xyz.exr", {name: np.ascontiguousarray(xyz[..., i]) for i, name in enumerate("XYZ")})
    write_exr(tmp_path / "rgb.exr", xyz)
    np.testing.assert_allclose(read(tmp_path / "xyz.exr"), rgb, atol=1e-5)
    np.testing.assert_allclose(read(tmp_path / "rgb.exr", rgb_is_xyz=True), rgb, atol=1e-5)
    # scikit-image is the oracle; its matrix is rounded to six digits and its result encoded as sRGB.
    np.testing.assert_allclose(decode(xyz2rgb(xyz), 1), rgb, atol=1e-4)


@pytest.mark.parametrize(
    ("channels", "dtype", "header", "message"),
    [
        ("RG", np.float32, {}, "no channel B "),
        ("RGB", np.uint32, {}, "not full-size half or float"),
        ("RGB", np.float32, {"chromaticities": (0.3, 0.3) * 4}, "chromaticities"),
    ],
)
def test_exr_of_other_channels_numbers_or_primaries_is_refused(tmp_path, channels, dtype, header, message):
    exr(tmp_path / "a.exr", {name: np.zeros((7, 9), dtype) for name in channels}, header)
    with pytest.raises(InputError, match=rf"a\.exr: .*{message}"):
        read(tmp_path / "a.exr")


def test_exr_channels_of_mixed_types_are_read_each_as_its_own_or_refused_by_name(tmp_path):
    plane = RNG.integers(0, 100, (7, 9))
    colours = {"R": plane.astype(np.float32), "G": plane.astype(np.float16), "B": (plane / 2).astype(np.float32)}
    exr(tmp_path / "a.exr", colours | {"A": plane.astype(np.float16), "id": plane.astype(np.uint32)})
    np.testing.assert_array_equal(read(tmp_path / "a.exr"), np.stack([plane, plane, plane / 2], -1))
    exr(tmp_path / "b.exr", colours | {"B": plane.astype(np.uint32)})
    with pytest.raises(InputError, match=r"b\.exr: .*\bB\b"):
        read(tmp_path / "b.exr")


@pytest.mark.parametrize("name", ["NO", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "B44", "DWAA", "DWAB"])
def test_a_truncated_exr_is_named_wherever_it_ends(tmp_path, capfd, name):
    planes = {channel: RNG.random((70, 20)).astype(np.float32) for channel in "RGB"}
    exr(tmp_path / "a.exr", planes, {"compression": getattr(OpenEXR, f"{name}_COMPRESSION")})
    whole = (tmp_path / "a.exr").read_bytes()
    assert read(tmp_path / "a.exr").shape == (70, 20, 3)
    for length in (len(whole) - 1, len(whole) // 2, 420):
        (tmp_path / "a.exr").write_bytes(whole[:length])
        with pytest.raises(InputError, match=rf"a\.exr: .*{length:,} bytes.*truncated"):
            read(tmp_path / "a.exr")
    assert capfd.readouterr() == ("", "")


def test_a_jpeg_of_12_bits_or_without_loss_is_refused_by_that_word(tmp_path):
    Image.fromarray(CODES).save(tmp_path / "a.jpg")
    whole = (tmp_path / "a.jpg").read_bytes()
    frame = whole.index(b"\xff\xc0")
    for marker, bits, message in ((0xC1, 12, "12-bit.*PNG of 8 or 16 bits"), (0xC3, 8, "lossless.*as PNG")):
        changed = bytearray(whole)
        changed[frame + 1], changed[frame + 4] = marker, bits
        (tmp_path / "a.jpg").write_bytes(changed)
        with pytest.raises(InputError, match=rf"a\.jpg: .*{message}"):
            picture_size(FolderFiles(tmp_path), "a.jpg")


def test_a_jpeg_with_bytes_between_its_segments_is_refused(tmp_path):
    Image.fromarray(CODES).save(tmp_path / "a.jpg")
    whole = (tmp_path / "a.jpg").read_bytes()
    frame = whole.index(b"\xff\xc0")
    (tmp_path / "a.jpg").write_bytes(whole[:frame] + b"\0" + whole[frame:])
    with pytest.raises(InputError, match=rf"a\.jpg: .*no JPEG marker at offset {frame}: .*get it again"):
        picture_size(FolderFiles(tmp_path), "a.jpg")


@pytest.mark.parametrize(("greyscale", "bits"), [(True, 16), (True, 4), (False, 16)])
def test_a_transparent_colour_of_other_than_8_bits_is_no_alpha(tmp_path, greyscale, bits):
    transparent = 7 if greyscale else (7, 7, 7)
    row = [7] * (4 if greyscale else 12)
    with (tmp_path / "a.png").open("wb") as stream:
        png.Writer(4, 3, greyscale=greyscale, bitdepth=bits, transparent=transparent).write(stream, [row] * 3)
    with pytest.raises(InputError, match=r"a\.png: it has no alpha"):
        read_alpha(FolderFiles(tmp_path), "a.png")


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def header(side, bits):
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", side, side, bits, 2, 0, 0, 0))


HDR = b"#?RADIANCE\nFORMAT=32-bit_rle_%s\n\n-Y %d +X %d\n\0\0\0\0"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (header(60000, 8) + b"\0\0\0\0IDAT", "pixels, but it has"),
        (header(64, 16) + chunk(b"IDAT", zlib.compress(bytes(50_000_000), 9)) + chunk(b"IEND", b""), "inflate beyond"),
        (HDR % (b"rgbe", 1000000000, 1000000000), "pixels, but it has"),
        (
            header(9000, 8) + chunk(b"IDAT", bytes(10_000)),
            "9000 x 9000 pixels are more than 67,108,864: save it smaller",
        ),
        (b"\x76\x2f\x31\x01" + struct.pack("<I", 1), "version 1, not 2"),
        (b"\x76\x2f\x31\x01" + struct.pack("<I", 0x1002), "deep or multi-part"),
        (HDR % (b"xyze", 1, 1), "32-bit_rle_rgbe"),
        (b"\xff\xd8\xff\xe0\0\x10JFIF", "Truncated"),
        (b"hello world, no picture", "begins with b'hello wo'"),
        (b"", "begins with b''"),
        ("CMYK", "4 channels"),
    ],
    ids=range(11),
)
def test_damaged_headers_are_refused_before_anything_is_allocated(tmp_path, content, message):
    if content == "CMYK":
        Image.new("CMYK", (9, 7)).save(tmp_path / "a", "JPEG")
    else:
        (tmp_path / "a").write_bytes(content)
    with pytest.raises(InputError, match=f"a: .*{message}"):
        read(tmp_path / "a")


def test_truncated_pictures_are_refused(tmp_path):
    write_exr(tmp_path / "a.exr", CODES / np.float32(64))
    Image.fromarray(CODES).save(tmp_path / "a.png")
    Image.fromarray(CODES).save(tmp_path / "a.jpg")
    for path in sorted(tmp_path.iterdir()):
        path.write_bytes(path.read_bytes()[:-60])
        with pytest.raises(InputError, match=f"{path.name}: "):
            read(path)
