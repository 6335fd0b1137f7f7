"""What stands in a JPEG or PNG before its pixels, and the orientation that a camera noted there (EXIF): a picture is
read as it is shown, not as it is stored."""

import struct
import warnings
from collections.abc import Callable, Iterator
from itertools import takewhile
from typing import Any

import numpy as np

from bench.btf import Array

TAG = 0x0112  # CIPA DC-008, 4.6.4 A: from 1, upright, to 8
MARK = b"Exif\0\0"
PNG_START = 8

# From the stored picture (H, W, …) to the upright one.
_TURNS: dict[int, Callable[[Array], Array]] = {
    2: lambda p: p[:, ::-1],
    3: lambda p: p[::-1, ::-1],
    4: lambda p: p[::-1],
    5: lambda p: p.swapaxes(0, 1),
    6: lambda p: p[::-1].swapaxes(0, 1),
    7: lambda p: p[::-1, ::-1].swapaxes(0, 1),
    8: lambda p: p[:, ::-1].swapaxes(0, 1),
}


def orientation(data: bytes, kind: str | None) -> int:
    """The orientation, 1 to 8, of a JPEG or PNG from its first bytes; 1 without a valid note."""
    notes = exif(data, kind)
    value = None if notes is None else notes.get(TAG)
    if isinstance(value, int) and value in _TURNS:
        return value
    return 1


def exif(data: bytes, kind: str | None) -> Any:
    """The camera's notes in a JPEG or PNG, a `PIL.Image.Exif`, from its first bytes; None without valid ones."""
    encoded = b""
    if kind in ("jpeg", "png"):
        for name, content in before_pixels(data):
            is_jpeg_note = kind == "jpeg" and name == b"\xe1" and content.startswith(MARK)
            is_png_note = kind == "png" and name == b"eXIf"
            if is_jpeg_note or is_png_note:
                encoded = content
                break
    if not encoded:
        return None
    from PIL import Image

    notes = Image.Exif()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            notes.load(encoded)
            notes.get(TAG)  # damaged values raise when they are read
        except Exception:  # damaged notes raise many types; the picture is then used as stored
            return None
    return notes


def upright(picture: Array, turn: int) -> Array:
    """The upright picture of one that is stored in orientation `turn`, (H, W, …); 5 to 8 swap its height and width."""
    if turn not in _TURNS:
        return picture
    return np.ascontiguousarray(_TURNS[turn](picture))


def upright_size(size: tuple[int, int], turn: int) -> tuple[int, int]:
    """(H, W) of the upright picture from that of one stored in orientation `turn`, or the stored from the upright.

    Pictures in the orientations 5 to 8 lie on their side.
    """
    return size[::-1] if turn >= 5 else size


def before_pixels(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Name and content of the chunks of a PNG, or marker (one byte) and content of the segments of a JPEG (ITU T.81,
    B.1.1), as far as they stand before the pixels."""
    if not data.startswith(b"\xff\xd8"):
        yield from takewhile(lambda chunk: chunk[0] != b"IDAT", png_chunks(data))
        return
    offset = 2
    # A segment is 0xFF, its marker, its size (two bytes, which count themselves) and its content; further 0xFF may
    # stand before the marker.
    while offset + 4 <= len(data) and data[offset] == 0xFF:
        marker = data[offset + 1]
        if marker in (0xC0, 0xC1, 0xC2, 0xDA, 0xD9):  # the first three begin a frame, then its pixels; the picture ends
            return
        if marker == 0xFF:
            offset += 1
            continue
        (size,) = struct.unpack_from(">H", data, offset + 2)
        yield data[offset + 1 : offset + 2], data[offset + 4 : offset + 2 + size]
        offset += 2 + max(2, size)  # a damaged size below 2 still moves on


def png_chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Name and content of the chunks of a PNG, as far as the data contain them."""
    offset = PNG_START
    # A chunk is the size of its content, its name, its content and a checksum; all but the content have 4 bytes.
    while offset + 8 <= len(data):
        size, name = struct.unpack_from(">I4s", data, offset)
        yield name, data[offset + 8 : offset + 8 + size]
        offset += 12 + size
