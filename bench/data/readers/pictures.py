"""Pictures as linear Rec. 709 RGB: JPEG, PNG (8 and 16 bit), OpenEXR (half and float) and Radiance RGBE.

A picture here is an image file. Its format is told by its first bytes, never by its name. Sizes come only from headers,
so thousands of pictures are checked in a second, and an absurd size is refused before anything is allocated.

JPEG and PNG hold *codes*: whole numbers, from which a curve gives linear values in [0, 1]. EXR and Radiance hold the
values themselves. A JPEG, PNG or Radiance picture may be stored turned; *upright* is a picture as it is shown. `label`
is the name of a file in errors.
"""

import hashlib
import struct
import warnings
import zlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from bench.btf import Array, Source, finite
from bench.data.readers import exr, radiance
from bench.data.readers.colour import Colour, by_attributes, by_radiance, of_codes, srgb_by_profile
from bench.data.readers.files import HEAD, Files, FolderFiles
from bench.data.readers.orientation import (
    late_orientation,
    orientation,
    pillow_image,
    png_chunks,
    upright,
    upright_size,
)
from bench.files.atomic import PNG
from bench.inputs.errors import InputError, readable
from bench.metrics.display import decode_srgb

MAX_PIXELS = 1 << 26  # of one picture
PIXELS_PER_BYTE = 8192  # the most that a byte of a file may claim
PNG_BITS = 24  # offset of the byte in a PNG that holds the bits a channel
_STARTS = {b"\xff\xd8\xff": "jpeg", PNG: "png", b"\x76\x2f\x31\x01": "exr", b"#?": "hdr"}
SUPPORTED = "JPEG, PNG, OpenEXR and Radiance .hdr are read"
# The markers of lossless and hierarchical JPEG, which are not read (ITU T.81, table B.1).
_UNREAD_JPEG = {0xC3, 0xC5, 0xC6, 0xC7, 0xCB, 0xCD, 0xCE, 0xCF, 0xDE}
_DAMAGED = "the picture is damaged; get it again"


@cache
def srgb_table(levels: int) -> Array:
    """Linear values (levels,) float32 in [0, 1] of sRGB codes 0 … levels − 1 (IEC 61966-2-1)."""
    return decode_srgb(np.arange(levels) / (levels - 1)).astype(np.float32)


def picture_format(head: bytes) -> str | None:
    """`jpeg`, `png`, `exr` or `hdr` from the first bytes of a file, None for anything else."""
    return next((kind for start, kind in _STARTS.items() if head.startswith(start)), None)


def picture_size(files: Files, name: str) -> tuple[int, int]:
    """(H, W) of a picture, upright, from its header; raises `InputError` for what `read_picture` would not read."""
    return _header(files, name).size


def colour_note(files: Files, name: str) -> str:
    """What a picture's colours are converted from, in words; "" if they are sRGB or linear Rec. 709."""
    colour = _header(files, name).colour
    return f"converted from {colour.name}" if colour else ""


@dataclass(frozen=True)
class _Header:
    """What the header of a picture says."""

    kind: str  # `jpeg`, `png`, `exr` or `hdr`
    size: tuple[int, int]  # (H, W) of the upright picture
    orientation: int  # in which it is stored: from 1, upright, to 8
    colour: Colour | None  # its colour space; None for sRGB, or linear Rec. 709 of EXR and Radiance
    ignored: list[str]  # what it says of colour that changes no value, in words


def _header(files: Files, name: str, is_colour: bool = True, rgb_is_xyz: bool = False) -> _Header:
    """What the header of a picture says.

    The colour space that it states does not count without `is_colour`; that of an EXR does not with `rgb_is_xyz`. Reads
    the start of the file, or all of it if the header is long. `InputError` for a file that is no supported picture, is
    damaged, claims an absurd size, or states a colour space that cannot be converted.
    """
    head = files.head(name, HEAD)
    kind = picture_format(head)
    if kind in ("jpeg", "png"):
        return _header_of_codes(files, name, kind, head, is_colour)
    if kind in ("exr", "hdr"):
        return _header_of_light(files, name, kind, head, is_colour and not (rgb_is_xyz and kind == "exr"))
    raise InputError(f"{files.label(name)}: it begins with {head[:8]!r}, like no known picture: {SUPPORTED}")


def _header_of_codes(files: Files, name: str, kind: str, data: bytes, is_colour: bool) -> _Header:
    """As `_header`, of a JPEG or PNG that begins with `data`."""
    label = files.label(name)
    with readable(label, "get it again, or save it as PNG of 8 or 16 bits a channel"):
        try:
            picture = pillow_image(data)
        except Exception:  # of many types; a long header, as with a large colour profile, may go on behind the data
            data = files.read(name)
            picture = pillow_image(data)
        if kind == "jpeg":
            _refuse_unread_jpeg(picture, data, label)
        width, height = picture.size
        _refuse_absurd(height, width, files.size(name), label)
        turn = orientation(picture)
        colour = of_codes(picture, data, label) if is_colour else None
    # Profiles are applied by a library that takes 8 bits (`bench.data.readers.colour`).
    if colour and colour.profile and kind == "png" and data[PNG_BITS] == 16:
        fault = f"{colour.name} in 16 bits is not converted"
        raise InputError(f"{label}: {fault}: save it as 16-bit sRGB, or as linear EXR")
    return _Header(kind, upright_size((height, width), turn), turn, colour, [])


def _refuse_unread_jpeg(picture: Any, data: bytes, label: str) -> None:
    """Raise an `InputError` for a JPEG in CMYK, without loss or hierarchical, or with bytes between its segments.

    Pillow passes over such bytes, which show that the header is damaged, and does not tell the kind of JPEG. So the
    segments in the bytes `data` of its image `picture` are counted off.
    """
    if picture.layers == 4:
        raise InputError(f"{label}: this JPEG has 4 channels (CMYK?): save it as RGB")
    offset = 2  # after the marker of the start
    # A segment is 0xFF, its marker and its length, two bytes, which count themselves and the content.
    while offset < picture.fp.tell():  # the end of the header
        if data[offset] != 0xFF:
            fault = f"there is no JPEG marker at offset {offset}"
            raise InputError(f"{label}: {fault}: {_DAMAGED}")
        marker, length = struct.unpack_from(">BH", data, offset + 1)
        if marker == 0xFF:  # fills up
            offset += 1
            continue
        if marker in _UNREAD_JPEG:
            raise InputError(f"{label}: this JPEG is lossless or hierarchical, which is not read: save it as PNG")
        offset += 2 + length


def _header_of_light(files: Files, name: str, kind: str, data: bytes, is_colour: bool) -> _Header:
    """As `_header`, of an EXR or Radiance picture that begins with `data`."""
    label = files.label(name)
    file_bytes = files.size(name)
    size_of, colour_of = (exr.size, by_attributes) if kind == "exr" else (radiance.size, by_radiance)
    with readable(label, _DAMAGED):
        size = size_of(data, label)
        if not size and len(data) < file_bytes:  # a long header
            data = files.read(name)
            size = size_of(data, label)
        if not size:
            raise InputError(f"{label}: the header ends early: the picture is truncated; get it again")
        _refuse_absurd(*size, file_bytes, label)
        colour, ignored = colour_of(data, label) if is_colour else (None, [])
    return _Header(kind, size, 1, colour, ignored)


def _refuse_absurd(height: int, width: int, file_bytes: int, label: str) -> None:
    """Raise an `InputError` for pixels that a file of `file_bytes` cannot hold, or that are too many."""
    # A false size would reserve memory that the file can never fill.
    if min(height, width) < 1 or height * width > PIXELS_PER_BYTE * file_bytes:
        fault = f"its header says {width} x {height} pixels, but it has {file_bytes} bytes"
        raise InputError(f"{label}: {fault}: get it again")
    if height * width > MAX_PIXELS:
        raise InputError(f"{label}: {width} x {height} pixels are more than {MAX_PIXELS:,}: save it smaller")


def read_picture(files: Files, name: str, *, rgb_is_xyz: bool = False, is_colour: bool = True) -> Array:
    """A picture (H, W, 3) float32 in linear Rec. 709, not clamped; grey is repeated, alpha is left out.

    8- and 16-bit codes are decoded to [0, 1] as the colour space says that the picture states, or else as sRGB; without
    `is_colour` (data, such as normals) always as sRGB. EXR channels X, Y, Z (and R, G, B with `rgb_is_xyz`) are taken
    as CIE XYZ under D65; primaries that EXR or Radiance states are converted, not without `is_colour`. A JPEG or PNG is
    turned as its EXIF or XMP notes say. Raises `InputError` for unreadable, CMYK or incomplete pictures and values that
    are not finite.
    """
    header = _header(files, name, is_colour, rgb_is_xyz)
    label = files.label(name)
    with readable(label, _DAMAGED):
        if header.kind in ("jpeg", "png"):
            picture = _decoded(files.read(name), header, label)
        elif header.kind == "hdr":
            picture = radiance.read(files.read(name), label)
        elif isinstance(files, FolderFiles):
            picture = exr.read(files.root / name, label, rgb_is_xyz)
        else:  # its library opens a path, and nothing is extracted from an archive
            raise InputError(f"{label}: EXR is read from folders only: extract the archive and give the folder")
        if header.colour and header.kind in ("exr", "hdr"):
            picture = header.colour.in_rec709(picture)
    if picture.shape != (*header.size, 3):
        raise InputError(f"{label}: it holds {picture.shape}, but its header says {(*header.size, 3)}: get it again")
    return finite(picture, label)


def read_alpha(files: Files, name: str) -> Array:
    """The alpha (H, W) float32 in [0, 1] of a PNG, upright, to 8 bits.

    `InputError` for a picture without it, and for a PNG whose notes behind its pixels turn it. Game engines keep the
    smoothness of a texture map there, so the first error speaks of it.
    """
    header = _header(files, name, is_colour=False)
    label = files.label(name)
    no_alpha = InputError(f"{label}: it has no alpha, which holds the smoothness: save it as PNG with alpha")
    if header.kind != "png":
        raise no_alpha
    with readable(label, _DAMAGED):
        data = files.read(name)
        _refuse_late_orientation(data, header, label)
        picture = pillow_image(data)
        # A PNG has alpha as a channel, or as transparent colours. Without a palette, Pillow compares these with codes
        # that it scaled to 8 bits, and so finds none of them in pictures of 2, 4 or 16 bits.
        is_compared = picture.mode in ("1", "P") or data[PNG_BITS] == 8
        if "A" not in picture.getbands() and not ("transparency" in picture.info and is_compared):
            raise no_alpha
        alpha = np.asarray(picture.convert("RGBA"))[..., 3]
    return upright(np.asarray(alpha / 255, np.float32), header.orientation)


class PictureSource(Source):
    """One picture a pair, all of one size, in a folder or a zip.

    Scattered reads use the defaults of `Source`, which copy all pictures to a scratch file once.
    """

    def __init__(
        self, files: Files, names: Sequence[str], labels: Sequence[str] | None = None, rgb_is_xyz: bool = False
    ):
        """Check by headers that every picture exists, can be read, and has the same size, and that no pair repeats one.

        `InputError` for the first picture at fault. `names` has the file of each pair. `labels` name the entries of the
        pairs in errors, such as lines of a list; by default they are the files themselves. `rgb_is_xyz`: as for
        `read_picture`.
        """
        self.files = files
        self.names = list(names)
        self.rgb_is_xyz = rgb_is_xyz
        self.count = len(self.names)
        self.orientations: dict[str, int] = {}  # file → EXIF orientation, 2 to 8, of pictures that are not upright
        self.colours: dict[str, str] = {}  # file → name of its colour space, of pictures that are converted
        self.ignored: list[str] = []  # what the pictures say of colour that changes no value, in the words of each
        if labels is None:
            labels = [files.label(name) for name in self.names]
        first_labels: dict[str, str] = {}  # name → label of the first entry that lists the picture
        for name, label in zip(self.names, labels, strict=True):
            _refuse_missing(files, name, label)
            # The pairs are known to differ, so one picture cannot be of two of them.
            first_label = first_labels.setdefault(name, label)  # this one, if no earlier entry lists the picture
            if first_label != label:
                fault = f"{name} already stands in {first_label}, for other directions"
                raise InputError(f"{label}: {fault}: give each pair its own picture")
            header = _header(files, name, rgb_is_xyz=rgb_is_xyz)
            if name == self.names[0]:
                self.shape = header.size
            elif header.size != self.shape:
                (height, width), (first_height, first_width) = header.size, self.shape
                first = f"{self.names[0]} is {first_width} x {first_height}: give all pictures one size"
                raise InputError(f"{label}: {name} is {width} x {height} pixels, but {first}")
            self.ignored += header.ignored
            if header.orientation > 1:  # 1 is upright
                self.orientations[name] = header.orientation
            if header.colour:
                self.colours[name] = header.colour.name

    def slice(self, pair: int) -> Array:
        """The picture of a pair (H, W, 3), read and decoded anew; `InputError` if its size is no longer the same."""
        picture = read_picture(self.files, self.names[pair], rgb_is_xyz=self.rgb_is_xyz)
        if picture.shape[:2] != self.shape:
            raise InputError(f"{self.files.label(self.names[pair])}: its size changed since it was opened")
        return picture

    def fingerprint(self) -> str:
        """A digest of the files and, where they state any, of the orientations and colour spaces they are read with."""
        digest = self.files.digest(self.names)
        statements = [str(statement) for statement in (self.orientations, self.colours) if statement]
        # Pictures that state neither keep the plain digest of earlier versions, so that results under it stay valid.
        if not statements:
            return digest
        return hashlib.sha256(" ".join([digest, *statements]).encode()).hexdigest()

    def conversions(self) -> dict[str, str]:
        """The notes for a provenance, by key: colour spaces that are converted, and what is ignored; {} if neither."""
        notes = {}
        if self.colours:
            notes["colour_profiles"] = f"converted to linear Rec. 709 from {self._counted(list(self.colours.values()))}"
        if self.ignored:
            notes["ignored"] = self._counted(self.ignored)
        return notes

    def _counted(self, words: list[str]) -> str:
        """A list of what pictures state, in words, each with the number of pictures that state it."""
        counts = sorted(Counter(words).items())
        return ", ".join(f"{word} ({count} of {self.count} pictures)" for word, count in counts)


def _refuse_missing(files: Files, name: str, label: str) -> None:
    """Raise an `InputError` if a picture does not exist; `label` names the entry that lists it."""
    if files.has(name):
        return
    remedy = "add the picture or leave the entry out"
    others = [other for other in files.beside(name) if other.lower() == name.lower()]
    if others:
        remedy = f"{others[0]} differs in letter case: give both one name"
    raise InputError(f"{label}: {name} is missing: {remedy}")


def _decoded(data: bytes, header: _Header, label: str) -> Array:
    """A JPEG or PNG in linear Rec. 709, (H, W, 3) float32, upright.

    Its codes are decoded as the colour space of `header` says, or else as sRGB. `InputError` for a PNG whose notes
    behind its pixels turn it.
    """
    if header.kind == "png":
        _refuse_late_orientation(data, header, label)
    colour = header.colour
    if header.kind == "png" and data[PNG_BITS] == 16:
        codes = _png16(data, upright_size(header.size, header.orientation), label)
        srgb = srgb_table(1 << 16)
    else:
        codes = _codes_of_8_bits(data, colour, label)
        srgb = srgb_table(256)
    if colour and not colour.profile:  # applying a profile gives sRGB codes
        return upright(colour.linear(codes, srgb), header.orientation)
    return upright(srgb[codes], header.orientation)


def _refuse_late_orientation(data: bytes, header: _Header, label: str) -> None:
    """Raise an `InputError` for a PNG whose notes behind its pixels turn it."""
    if late_orientation(data) not in (1, header.orientation):
        fault = "notes behind its pixels say that it is turned, too late to be seen when its size is read"
        raise InputError(f"{label}: {fault}: save it upright")


def _codes_of_8_bits(data: bytes, colour: Colour | None, label: str) -> Array:
    """Codes (H, W, 3) uint8 of a JPEG or PNG, as stored; in sRGB if `colour` is a profile, else in its own space."""
    picture = pillow_image(data)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Pillow warns of what it passes over
        if colour and colour.profile:
            return srgb_by_profile(picture, colour, label)
        return np.asarray(picture.convert("RGB"))


def _png16(data: bytes, size: tuple[int, int], label: str) -> Array:
    """Codes (H, W, 3) uint16 of a 16-bit PNG of `size` (H, W), as stored; grey is repeated, alpha is left out.

    pypng reads it, because Pillow keeps only the upper 8 bits of 16-bit RGB.
    """
    import png

    # pypng inflates the pixels whatever their size, so a bomb must be found before.
    packed = b"".join(content for name, content in png_chunks(data) if name == b"IDAT")
    height, width = size
    row_bytes = width * 8 + 1  # 16-bit RGBA, the most, has 8 bytes a pixel; one more names the row's filter
    limit = 2 * height * row_bytes + 4096  # twice as much leaves room for interlacing
    inflated = zlib.decompressobj().decompress(packed, limit + 1)
    if len(inflated) > limit:
        raise InputError(f"{label}: its pixels inflate beyond {limit} bytes: the picture is damaged; get it again")
    width, height, rows, info = png.Reader(bytes=data).read()
    planes = info["planes"]  # channels: 1 grey, 2 grey and alpha, 3 RGB, 4 RGB and alpha
    # The pixels of a row lie in one list, their channels together.
    codes = np.vstack([np.asarray(row, np.uint16) for row in rows]).reshape(height, width, planes)
    if planes >= 3:
        return codes[..., :3]
    return np.repeat(codes[..., :1], 3, 2)
