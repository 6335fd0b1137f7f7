"""What stands in a JPEG or PNG before its pixels, and the orientation that a camera noted (EXIF, XMP).

A camera that lies on its side stores the picture turned, and notes how. A picture is read as it is shown, upright, not
as it is stored.
"""

import io
import struct
import warnings
from collections.abc import Callable, Iterator
from itertools import takewhile
from typing import Any

import numpy as np

from bench.btf import Array

TAG = 0x0112  # the EXIF note of the orientation (CIPA DC-008, 4.6.4 A): from 1, upright, to 8
PNG_START = 8  # bytes of the signature of a PNG; its chunks follow

# Orientation → the function from the stored picture (H, W, …) to the upright one.
_TURNS: dict[int, Callable[[Array], Array]] = {
    2: lambda p: p[:, ::-1],
    3: lambda p: p[::-1, ::-1],
    4: lambda p: p[::-1],
    5: lambda p: p.swapaxes(0, 1),
    6: lambda p: p[::-1].swapaxes(0, 1),
    7: lambda p: p[::-1, ::-1].swapaxes(0, 1),
    8: lambda p: p[:, ::-1].swapaxes(0, 1),
}


def orientation(data: bytes) -> int:
    """The orientation, 1 to 8, of a JPEG or PNG from its first bytes; 1 without a valid note."""
    return _stated_orientation(exif(data))


def late_orientation(data: bytes) -> int:
    """The orientation of a whole PNG with notes behind its pixels, where the first bytes do not show them; else 1."""
    names = [name for name, _ in png_chunks(data)]
    late = names[names.index(b"IDAT") :] if b"IDAT" in names else []
    if not {b"eXIf", b"tEXt", b"zTXt", b"iTXt"} & set(late):
        return 1
    return _stated_orientation(exif(data, is_whole=True))


def _stated_orientation(notes: Any) -> int:
    """The orientation, 1 to 8, that a camera's notes state; 1 without a valid one, and for damaged notes (None)."""
    value = None if notes is None else notes.get(TAG)
    if isinstance(value, int) and value in _TURNS:
        return value
    return 1


def exif(data: bytes, is_whole: bool = False) -> Any:
    """The camera's notes in a JPEG or PNG, a `PIL.Image.Exif` (tag → value); empty if it has none, None if they, or the
    picture, are damaged.

    Without `is_whole` only the bytes before the pixels are needed. Pillow finds the notes: in a segment or chunk of
    EXIF, in a PNG's text, and the orientation in XMP.
    """
    from PIL import Image

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Pillow warns of damaged notes, which are no fault of the picture
        try:
            picture = Image.open(io.BytesIO(data), formats=["JPEG", "PNG"])
            # A PNG's own method decodes the pixels first, to reach what stands behind them.
            notes = picture.getexif() if is_whole else Image.Image.getexif(picture)
            notes.get(TAG)  # damaged values raise when they are read
        except Exception:  # damaged notes raise many types; the picture is then used as stored
            return None
    return notes


def upright(picture: Array, turn: int) -> Array:
    """The upright picture of one (H, W, …) stored in orientation `turn`, 1 to 8; 5 to 8 swap its height and width."""
    if turn not in _TURNS:
        return picture
    return np.ascontiguousarray(_TURNS[turn](picture))


def upright_size(size: tuple[int, int], turn: int) -> tuple[int, int]:
    """(H, W) of the upright picture from that of one stored in orientation `turn`, or the stored from the upright.

    Pictures in the orientations 5 to 8 lie on their side.
    """
    return size[::-1] if turn >= 5 else size


def before_pixels(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """(name, content) of the parts of a PNG or JPEG before its pixels, as far as the data contain them.

    The parts of a PNG are chunks, with a name of four bytes; those of a JPEG are segments (ITU T.81, B.1.1), with a
    marker of one byte as the name.
    """
    if not data.startswith(b"\xff\xd8"):  # how a JPEG begins; so it is a PNG
        yield from takewhile(lambda chunk: chunk[0] != b"IDAT", png_chunks(data))
        return
    offset = 2  # behind these two bytes
    # A segment is 0xFF, its marker, its size (two bytes, which count themselves) and its content; further 0xFF may
    # stand before the marker.
    while offset + 4 <= len(data) and data[offset] == 0xFF:
        marker = data[offset + 1]
        if marker in (0xDA, 0xD9):  # the pixels, the end of the picture
            return
        if marker == 0xFF:  # fills up
            offset += 1
            continue
        (size,) = struct.unpack_from(">H", data, offset + 2)
        yield data[offset + 1 : offset + 2], data[offset + 4 : offset + 2 + size]
        offset += 2 + max(2, size)  # a damaged size below 2 still moves on


def png_chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """(name, content) of the chunks of a PNG in their order, as far as the data contain them; the last may be cut."""
    offset = PNG_START
    # A chunk is the size of its content, its name, its content and a checksum; all but the content have 4 bytes.
    while offset + 8 <= len(data):
        size, name = struct.unpack_from(">I4s", data, offset)
        yield name, data[offset + 8 : offset + 8 + size]
        offset += 12 + size
