"""OpenEXR as linear RGB: a single flat part with channels R G B, X Y Z or Y, in half or float.

An EXR is a header of attributes (name, type, content), a table of places, and chunks: groups of scan lines (rows), each
compressed alone. The header is parsed here, so that sizes are known without the pixels; the OpenEXR library decodes the
pixels. `label` is the name of the file in errors.
"""

import struct
from pathlib import Path

import numpy as np

from bench.btf import Array
from bench.inputs.errors import InputError, refuse_pipe

# The scan lines of a chunk, by the number of the compression, which the attribute `compression` holds.
_LINES_OF_A_CHUNK = (1, 1, 1, 16, 32, 16, 32, 32, 32, 256)

# From CIE XYZ (D65) to linear Rec. 709, for column vectors, by the primaries and the white of sRGB (IEC 61966-2-1).
XYZ_TO_REC709 = np.array(
    [[3.2404542, -1.5371385, -0.4985314], [-0.9692660, 1.8760108, 0.0415560], [0.0556434, -0.2040259, 1.0572252]]
)


def size(data: bytes, label: str) -> tuple[int, int] | None:
    """(H, W) from the header of an EXR, from its first bytes; None if they end before the header does.

    Raises `InputError` for a form that `read` does not read.
    """
    attributes, _ = attributes_of(data, label)
    if attributes is None:
        return None
    missing = [name for name in ("channels", "dataWindow", "displayWindow") if name not in attributes]
    if missing:
        raise InputError(f"{label}: this EXR lacks {', '.join(missing)}: save it again")
    # The data window is what the file holds, the display window what is shown. Each is first column and row, last
    # column and row (both are part of the picture).
    window = struct.unpack("<4i", attributes["dataWindow"])
    if window != struct.unpack("<4i", attributes["displayWindow"]):
        raise InputError(f"{label}: its data window differs from its display window: save it uncropped")
    if "tiles" in attributes:
        # Before it reads any of them, the library reserves memory by their size: 1.5 GB where a file of 16² pixels
        # names tiles of 2²⁴.
        tile_width, tile_height = struct.unpack_from("<II", attributes["tiles"])
        if max(tile_width, tile_height) > 4096:
            raise InputError(f"{label}: this EXR has tiles above 4096 pixels: save it in scan lines")
    channels_to_read(attributes, label)  # raises for channels that `read` does not read
    left, top, right, bottom = window
    return bottom - top + 1, right - left + 1


def attributes_of(data: bytes, label: str) -> tuple[dict[str, bytes] | None, int]:
    """The header of a single-part EXR: its attributes, name → content, and the offset at which the header ends.

    None and 0 if the data end before the header does. `InputError` for an EXR of another kind.
    """
    (version,) = struct.unpack_from("<I", data, 4)  # after four bytes of the signature
    # The low byte is the version; the bits of 0x1800 say deep and multi-part.
    if version & 0xFF != 2 or version & 0x1800:
        kind = "deep or multi-part" if version & 0xFF == 2 else f"of version {version & 0xFF}, not 2"
        fault = f"this EXR is {kind} (version field {version:#x})"
        raise InputError(f"{label}: {fault}: save it as a single flat part")
    attributes: dict[str, bytes] = {}
    offset = 8
    # An attribute is its name, its type (each ends with a zero byte), its size (4 bytes) and that many bytes.
    while offset < len(data):
        if data[offset] == 0:  # an empty name ends the header
            return attributes, offset + 1
        # Names and types have 255 bytes at most.
        name_end = data.find(b"\0", offset, offset + 256)
        type_end = data.find(b"\0", name_end + 1, name_end + 257)
        content_start = type_end + 1 + 4
        if min(name_end, type_end) < 0 or content_start > len(data):
            return None, 0
        (content_size,) = struct.unpack_from("<i", data, type_end + 1)
        content_end = content_start + content_size
        if content_size < 0 or content_end > len(data):  # a negative size would go back without end
            return None, 0
        name = data[offset:name_end].decode("latin-1")
        attributes[name] = data[content_start:content_end]
        offset = content_end
    return None, 0


def channels_to_read(attributes: dict[str, bytes], label: str) -> tuple[str, ...]:
    """The names of the channels to read: R G B, else X Y Z, else Y alone (grey). `InputError` for other channels.

    Further channels, such as alpha or depth, are left out. `attributes` must have `channels`, which `size` checks.
    """
    channels = {}  # name → pixel type (0 uint, 1 half, 2 float), sampling along x, sampling along y
    data = attributes["channels"]
    offset = 0
    # A channel is its name, which a zero byte ends, and 16 bytes: the type, 4 that do not matter, the samplings.
    while offset < len(data) and data[offset]:
        name_end = data.index(b"\0", offset)
        name = data[offset:name_end].decode("latin-1")
        channels[name] = struct.unpack_from("<i4xii", data, name_end + 1)
        offset = name_end + 1 + 16
    choices: list[tuple[str, ...]] = [("R", "G", "B"), ("X", "Y", "Z")]
    if not {"RY", "BY"} & set(channels):  # with these, Y is the luminance of a coloured picture
        choices.append(("Y",))
    choice = next((names for names in choices if set(names) <= set(channels)), None)
    if choice is None:
        missing = ", ".join(name for name in "RGB" if name not in channels)
        held = ", ".join(sorted(channels)) or "none"
        raise InputError(f"{label}: no channel {missing} (it holds {held}): save it with channels R, G, B")
    for name in choice:
        # (type, sampling along x, along y): half or float, with a sample for every pixel.
        if channels[name] not in ((1, 1, 1), (2, 1, 1)):
            raise InputError(f"{label}: channel {name} is not full-size half or float: save it as half or float RGB")
    return choice


def _refuse_truncated(data: bytes, end: int, attributes: dict[str, bytes], label: str) -> None:
    """Raise an `InputError` if a chunk of scan lines does not lie within the file, whose bytes are `data`.

    The library would fail, too, but in words of its own. The header ends at `end`. There the table begins: the place of
    each chunk in the file, 8 bytes each.
    """
    _, top, _, bottom = struct.unpack("<4i", attributes["dataWindow"])
    compression = attributes.get("compression", b"\0")[0]
    if compression >= len(_LINES_OF_A_CHUNK):
        return  # newer than this list; the library checks it
    lines = bottom - top + 1
    count = -(-lines // _LINES_OF_A_CHUNK[compression])  # rounded up: the last chunk may have fewer lines
    table = data[end : end + 8 * count]
    places = np.frombuffer(table, "<u8", len(table) // 8)
    is_whole = len(places) == count and all(_holds_chunk(data, place, end) for place in places.tolist())
    if not is_whole:
        raise InputError(f"{label}: its pixels end early ({len(data):,} bytes): the picture is truncated; get it again")


def _holds_chunk(data: bytes, place: int, end: int) -> bool:
    """Whether the chunk at `place` lies within the file, behind the header, which ends at `end`."""
    if not end <= place <= len(data) - 8:  # a place before the end of the header was never filled in
        return False
    # A chunk is its line and its size (4 bytes each), and that many bytes.
    (chunk_size,) = struct.unpack_from("<i", data, place + 4)
    return bool(place + 8 + chunk_size <= len(data))


def read(path: Path, label: str, rgb_is_xyz: bool) -> Array:
    """The picture (H, W, 3) float32 of an EXR, in the colour space that it states; grey is repeated.

    X, Y, Z, and R, G, B with `rgb_is_xyz`, are taken as CIE XYZ (D65), and become linear Rec. 709. `InputError` for a
    truncated file, or for channels that are not read.
    """
    import OpenEXR

    refuse_pipe(path)
    data = path.read_bytes()
    attributes, end = attributes_of(data, label)
    if attributes is None:
        raise InputError(f"{label}: the header ends early: the picture is truncated; get it again")
    names = channels_to_read(attributes, label)
    if "tiles" not in attributes:  # the chunks of tiles are numbered in another way; the library checks them
        _refuse_truncated(data, end, attributes, label)
    channels = OpenEXR.File(str(path), separate_channels=True).channels()
    picture = np.stack([np.asarray(channels[name].pixels, np.float32) for name in names], -1)
    if names == ("Y",):
        return np.repeat(picture, 3, 2)
    if names == ("X", "Y", "Z") or rgb_is_xyz:  # colours outside the gamut stay negative
        with np.errstate(over="ignore", invalid="ignore"):
            return np.asarray(picture @ XYZ_TO_REC709.T, np.float32)
    return picture
