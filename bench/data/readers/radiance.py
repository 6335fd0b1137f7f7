"""Radiance pictures (.hdr) as the floats that were there before its stated exposure and correction of colours.

After Ward, "Real Pixels", Graphics Gems II, and Radiance's manual of its picture format. A pixel is RGBE: mantissas of
red, green and blue, and a common exponent. `label` is the name of the file in errors.
"""

import struct
from typing import NamedTuple

import numpy as np

from bench.btf import Array
from bench.inputs.errors import InputError

# The pairs of axes that a Radiance picture may state, in either order: one of rows (Y) and one of columns (X).
_AXES = ({"-Y", "+X"}, {"-Y", "-X"}, {"+Y", "+X"}, {"+Y", "-X"})


class Header(NamedTuple):
    """The header of a Radiance picture."""

    start: int  # offset at which the pixels begin
    axes: tuple[str, str]  # with their signs, like -Y, +X; the second one changes faster
    counts: tuple[int, int]  # of pixels along the axes
    # The products of all factors that are stated, of EXPOSURE and of COLORCORR (R, G, B); 1 without any. The stored
    # values were multiplied by both.
    exposure: float
    correction: tuple[float, ...]
    primaries: tuple[float, ...] | None  # x and y of red, green, blue and white, if they are stated
    ignored: list[str]  # lines that state nothing

    @property
    def by_rows(self) -> bool:
        """Whether the picture is stored row by row, not by columns."""
        return self.axes[0] in ("-Y", "+Y")


def size(data: bytes, label: str) -> tuple[int, int] | None:
    """(H, W) of the picture, which may be stored by columns; None if the data end before the header does."""
    stated = header(data, label)
    if stated is None:
        return None
    return stated.counts if stated.by_rows else stated.counts[::-1]


def header(data: bytes, label: str) -> Header | None:
    """The header; None if the data end before it does. `ValueError` or `InputError` for what is not read.

    It is lines of text, an empty line, and the line of the size, like `-Y 256 +X 256`: each axis and its pixels.
    """
    first_line, _, _ = data.partition(b"\n")
    if first_line.endswith(b"\r"):
        fault = "its lines end in CR LF, so it was transferred as text, which also changes pixels"
        raise InputError(f"{label}: {fault}: get it again, transferred as binary data")
    end = data.find(b"\n\n")
    line_end = data.find(b"\n", end + 2)
    if end < 0 or line_end < 0:
        return None
    values = _values_by_key(data[:end].decode("latin-1"))
    _refuse_other_values(values, label)
    exposures = [float(value) for value in values.get("EXPOSURE", [])]
    ignored = ["EXPOSURE=0"] if 0 in exposures else []  # some writers put 0 where they know none
    exposure = float(np.prod([value for value in exposures if value != 0]))  # 1 without any
    corrections = [_numbers("COLORCORR", value, 3) for value in values.get("COLORCORR", [])]
    correction = np.prod(np.reshape(corrections, (-1, 3)), axis=0)  # 1, 1, 1 without any
    for key, factors in (("EXPOSURE", np.array([exposure])), ("COLORCORR", correction)):
        if not (np.isfinite(factors) & (factors > 0)).all():
            raise ValueError(f"{key} is {' '.join(f'{factor:g}' for factor in factors)}")
    primaries = [_numbers("PRIMARIES", value, 8) for value in values.get("PRIMARIES", [])]
    if any(other != primaries[0] for other in primaries):
        raise InputError(f"{label}: PRIMARIES stands twice, with different numbers: leave the line that is right")
    axes, counts = _axes_and_counts(data[end + 2 : line_end].decode("latin-1").split())
    return Header(
        start=line_end + 1,
        axes=axes,
        counts=counts,
        exposure=exposure,
        correction=tuple(correction.tolist()),
        primaries=primaries[0] if primaries else None,
        ignored=ignored,
    )


def _axes_and_counts(words: list[str]) -> tuple[tuple[str, str], tuple[int, int]]:
    """Both axes and their pixels, of the words of the line of the size; `ValueError` for any other line."""
    if len(words) != 4 or {words[0], words[2]} not in _AXES:
        raise ValueError(f"the size is {' '.join(words)[:40]!r}, not like -Y 256 +X 256")
    return (words[0], words[2]), (int(words[1]), int(words[3]))


def _values_by_key(text: str) -> dict[str, list[str]]:
    """What each key in the lines of a header states, line by line."""
    values: dict[str, list[str]] = {}
    for line in text.split("\n"):
        if line.startswith("#") or "=" not in line:
            continue  # a comment, or a command that made the picture
        key, _, value = line.partition("=")
        values.setdefault(key.strip(), []).append(value.strip())
    return values


def _refuse_other_values(values: dict[str, list[str]], label: str) -> None:
    """Raise an `InputError` unless the values of a header's keys say that the pixels are RGBE, and linear.

    `ValueError` for a gamma that is no number.
    """
    formats = values.get("FORMAT", [])
    if not formats:
        raise InputError(f"{label}: its header has no line FORMAT: if it is RGBE, add the line FORMAT=32-bit_rle_rgbe")
    if formats != ["32-bit_rle_rgbe"]:
        fault = f"FORMAT is {', '.join(formats)[:60]}, only 32-bit_rle_rgbe is read"
        raise InputError(f"{label}: {fault}: save it as RGBE or EXR")
    for value in values.get("GAMMA", []):  # a key of rgbe.c, which writes 1 for linear values
        if float(value) != 1:
            fault = f"GAMMA is {float(value):g}, so its values are not linear"
            raise InputError(f"{label}: {fault}: save it as linear .hdr or EXR")


def _numbers(key: str, value: str, count: int) -> tuple[float, ...]:
    """The `count` numbers of a line's value; `ValueError` with its key if there are fewer or more."""
    numbers = tuple(float(word) for word in value.split())
    if len(numbers) != count:
        raise ValueError(f"{key} {value[:60]!r} are not {count} numbers")
    return numbers


def read(data: bytes, label: str) -> Array:
    """The picture (H, W, 3) float32, upright for any axis order, divided by its exposure and correction of colours.

    `InputError` if its header states values that are not read, `ValueError` or `IndexError` if it is damaged.
    """
    stated = header(data, label)
    if stated is None:
        raise ValueError("the header ends early")
    rgbe = _pixels(data, stated.start, *stated.counts)
    exponents = rgbe[..., 3]
    # A mantissa m with exponent e is m · 2^(e − 136), as in rgbe.c and OpenCV, so black stays black; Ward's own reader
    # adds half a code to m. Of the 136, 128 make e signed, and 8 make m a fraction.
    # Beyond float32 it is infinite or no number, which a BTF refuses when it is read.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        scale = np.ldexp(np.float32(1 / stated.exposure), exponents.astype(np.int32) - 136)
        picture = rgbe[..., :3] * scale[..., None]
        picture /= np.asarray(stated.correction, np.float32)
    picture[exponents == 0] = 0  # black, whatever m is
    # Upright, rows go down (-Y) and columns to the right (+X).
    backward = [axis for axis, name in enumerate(stated.axes) if name in ("-X", "+Y")]
    picture = np.flip(picture, tuple(backward))
    if not stated.by_rows:
        picture = picture.swapaxes(0, 1)
    return np.ascontiguousarray(picture)


def _pixels(data: bytes, offset: int, lines: int, length: int) -> Array:
    """RGBE bytes (lines, length, 4) uint8 from `offset` on, which are stored plainly or run-length coded line by line.

    A line is a row, or a column of a picture that is stored by columns. `ValueError` or `IndexError` for damaged data.
    """
    # A coded line begins with two bytes 2, and its length in two more, the higher byte first. The format codes only
    # lines of 8 to 32,767 pixels.
    line_start = b"\2\2" + struct.pack(">H", length) if 8 <= length < 32768 else None
    if data[offset : offset + 4] != line_start:
        flat = np.frombuffer(data, np.uint8, lines * length * 4, offset).reshape(lines, length, 4)
        if (flat[..., :3] == 1).all(-1).any():  # the old coding marks a run by a pixel whose R, G and B are 1
            raise ValueError("the old run-length coding is not read")
        return flat
    planes = []  # of each line, all its R, then all G, B and exponents
    for _ in range(lines):
        if data[offset : offset + 4] != line_start:
            raise ValueError(f"there is no scan line at offset {offset}")
        line, offset = _line(data, offset + 4, 4 * length)
        planes.append(line)
    return np.frombuffer(b"".join(planes), np.uint8).reshape(lines, 4, length).swapaxes(1, 2)


def _line(data: bytes, offset: int, length: int) -> tuple[bytes, int]:
    """The `length` bytes of a line whose run-length code begins at `offset`, and the offset behind that code."""
    line = bytearray()
    while len(line) < length:
        count = data[offset]
        if count > 128:  # one byte, repeated `count` − 128 times
            line += data[offset + 1 : offset + 2] * (count - 128)
            offset += 2
        else:  # `count` different bytes
            line += data[offset + 1 : offset + 1 + count]
            offset += 1 + count
        if count == 0 or offset > len(data):  # a run of 0 bytes would go on for ever
            raise ValueError(f"a bad run at offset {offset}")
    if len(line) != length:
        raise ValueError(f"the scan line before offset {offset} is too long")
    return bytes(line), offset
