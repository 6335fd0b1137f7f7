"""The header of a JPEG or PNG, which Pillow reads, and the orientation that a camera noted (EXIF, XMP).

A camera that lies on its side stores the picture turned, and notes how. A picture is read as it is shown, upright, not
as it is stored.
"""

import io
import struct
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from bench.btf import Array
from bench.files.atomic import PNG

TAG = 0x0112  # the EXIF note of the orientation (CIPA DC-008, 4.6.4 A): from 1, upright, to 8

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


def pillow_image(data: bytes) -> Any:
    """A JPEG or PNG as an image of Pillow, from its first bytes at least: its header is read, no pixel is decoded yet.

    `ValueError` if the data end before the pixels. Damaged data, and kinds that Pillow does not read, raise many types.
    """
    from PIL.JpegImagePlugin import JpegImageFile
    from PIL.PngImagePlugin import PngImageFile

    # `PIL.Image.open` would hide why a picture cannot be read, and look for further pictures in a JPEG.
    kind = PngImageFile if data.startswith(PNG) else JpegImageFile
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Pillow warns of what it passes over
        picture = kind(io.BytesIO(data))
    if not picture.tile:  # where the pixels are
        raise ValueError("it ends before its pixels")
    return picture


def orientation(picture: Any) -> int:
    """The orientation, 1 to 8, that is noted in a JPEG or PNG before its pixels; 1 without a valid note.

    `picture` is an image of `pillow_image`, as in all functions here.
    """
    return _stated_orientation(exif(picture))


def late_orientation(data: bytes) -> int:
    """The orientation of a whole PNG with notes behind its pixels, where the first bytes do not show them; else 1."""
    names = [name for name, _ in png_chunks(data)]
    late = names[names.index(b"IDAT") :] if b"IDAT" in names else []
    if not {b"eXIf", b"tEXt", b"zTXt", b"iTXt"} & set(late):
        return 1
    return _stated_orientation(exif(pillow_image(data), is_whole=True))


def _stated_orientation(notes: Any) -> int:
    """The orientation, 1 to 8, that a camera's notes state; 1 without a valid one, and for damaged notes (None)."""
    value = None if notes is None else notes.get(TAG)
    if isinstance(value, int) and value in _TURNS:
        return value
    return 1


def exif(picture: Any, is_whole: bool = False) -> Any:
    """The camera's notes in a JPEG or PNG, a `PIL.Image.Exif` (tag → value); empty if it has none, None if they, or the
    pixels before them, are damaged.

    Without `is_whole` only those before the pixels count. Pillow finds the notes: in a segment or chunk of EXIF, in a
    PNG's text, and the orientation in XMP.
    """
    from PIL import Image

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Pillow warns of damaged notes, which are no fault of the picture
        try:
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


def png_chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """(name, content) of the chunks of a PNG in their order, as far as the data contain them; the last may be cut."""
    offset = len(PNG)
    # A chunk is the size of its content, its name, its content and a checksum; all but the content have 4 bytes.
    while offset + 8 <= len(data):
        size, name = struct.unpack_from(">I4s", data, offset)
        yield name, data[offset + 8 : offset + 8 + size]
        offset += 12 + size
