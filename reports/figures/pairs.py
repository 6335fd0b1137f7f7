"""A figure of chosen pairs for a paper: the truth and decoded slices with magnified insets, and FLIP maps below."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bench.inputs.errors import InputError
from bench.metrics.psnr import psnr
from bench.records import PSNR, Run
from reports.artefacts import Arrays, arrays, of_shown
from reports.figures.canvas import Figure, Sheet, enlarged, short, style
from reports.figures.contact import flip_scale
from reports.numbers import fixed
from reports.rows import MaterialRows, Row, materials

CELL = 256  # the least side of a picture in pixels; smaller slices are enlarged by a whole factor
GAP = 8  # pixels between pictures
TOP = 30  # pixels above them
LINE = 18  # pixels for a line of text
ZOOM = 3  # an inset shows its texels so many times as large as the picture does
LETTER = 9  # pixels of a letter of a heading
FRAME = np.array([230, 60, 20], np.uint8)  # colour of the frames around an inset and its place


class Inset(NamedTuple):
    """A square of texels that is magnified: its first row and column, and its side."""

    row: int
    col: int
    side: int


def pairs_figure(run: Run, name: str, pairs: Sequence[int], inset: Inset | None = None) -> Figure:
    """The slices of some pairs of a material by its first seed: the truth, then every codec, with their FLIP maps.

    `pairs` are indices of pairs of the BTF; without any, those of the contact sheet are shown. Without an inset, the
    square of a quarter of the shorter side is magnified in which the FLIP of all codecs together is largest.
    `InputError` if the material or a pair has no stored slices; it lists the pairs that have some.
    """
    by_name = {material.name: material for material in materials(run)}
    material = by_name.get(name)
    rows = []
    if material:
        for row, arrays_of_row in of_shown(run, material, "pictures"):
            if arrays_of_row.keys() >= {"truth", "decoded", "pairs", "wo_deg", "wi_deg"}:
                rows.append((row, arrays_of_row))
    if material is None or not rows:
        raise InputError(f"figure pairs: no slices of {name} are stored in {run.folder}")
    places = _places(rows[0][1], pairs)
    with style():
        sheet = _drawn(run, material, rows, places, inset)
    title = f"{material.name}: slices and FLIP maps of chosen pairs"
    return Figure(material.name, "pairs", title, sheet.png(), sheet)


def _places(stored: Arrays, pairs: Sequence[int]) -> list[int]:
    """The indices into the stored arrays of the slices of some pairs, or by default of those to show."""
    stored_pairs = stored["pairs"].tolist()
    if not pairs and "sheet" in stored:
        return np.flatnonzero(stored["sheet"]).tolist()
    if not pairs:
        return list(range(min(4, len(stored_pairs))))
    for pair in pairs:
        if pair not in stored_pairs:
            angles = zip(stored_pairs, stored["wo_deg"], stored["wi_deg"], strict=True)
            words = [f"{number} (view {wo[0]:.0f}°, light {wi[0]:.0f}°)" for number, wo, wi in angles]
            raise InputError(f"figure pairs: no slice of pair {pair} is stored; there are {', '.join(words)}")
    return [stored_pairs.index(pair) for pair in pairs]


def _drawn(
    run: Run, material: MaterialRows, rows: list[tuple[Row, Arrays]], places: list[int], inset: Inset | None
) -> Sheet:
    """The sheet: a line of pictures for each place in the stored arrays, above FLIP maps if all codecs have them."""
    _, first = rows[0]
    truth = first["truth"]
    height, width = truth.shape[1:3]
    factor = max(1, math.ceil(CELL / max(height, width)))
    cell = (height * factor, width * factor)
    with_flip = all("flip" in stored for _, stored in rows)
    block = LINE + cell[0] + GAP  # the height of all that is shown of one pair
    if with_flip:
        block += GAP // 2 + cell[0]
    columns = 1 + len(rows)
    sheet = Sheet(columns * (cell[1] + GAP) - GAP, TOP + len(places) * block)
    for column, label in enumerate(["truth", *(row.label for row, _ in rows)]):
        middle = column * (cell[1] + GAP) + cell[1] / 2
        sheet.text(middle, TOP / 2, short(label, cell[1] // LETTER), ha="center", fontsize=10)
    for number, place in enumerate(places):
        top = TOP + number * block
        wo, wi = first["wo_deg"][place], first["wi_deg"][place]
        sheet.text(0, top + LINE / 2, f"view θ {wo[0]:.0f}°, φ {wo[1]:.0f}°; light θ {wi[0]:.0f}°, φ {wi[1]:.0f}°")
        zoomed = inset or _worst(rows, place, (height, width))
        _check(zoomed, (height, width))
        pictures = [truth[place], *(stored["decoded"][place] for _, stored in rows)]
        for column, picture in enumerate(pictures):
            left = column * (cell[1] + GAP)
            sheet.picture(left, top + LINE, _with_inset(picture, zoomed, factor))
            if column:  # the first column is the truth
                row, stored = rows[column - 1]
                text = _decibels(run, row, int(stored["pairs"][place]))
                sheet.text(left + cell[1], top + LINE / 2, text, ha="right")
                if with_flip:
                    below = top + LINE + cell[0] + GAP // 2
                    sheet.picture(left, below, enlarged(stored["flip"][place], factor))
        if with_flip and number == 0:  # below the first truth, which has no FLIP map
            flip_scale(sheet, 0, top + LINE + cell[0] + cell[0] // 2, cell[1])
    return sheet


def _worst(rows: list[tuple[Row, Arrays]], place: int, size: tuple[int, int]) -> Inset:
    """The square of a quarter of the shorter side in which the FLIP maps of one slice are brightest together; without
    maps, the one in the centre. `size` is (height, width) in texels."""
    side = max(2, min(size) // 4)
    maps = [stored["flip"][place].astype(float).sum(2) for _, stored in rows if "flip" in stored]
    if not maps:
        return Inset((size[0] - side) // 2, (size[1] - side) // 2, side)
    # The sum over each such square, by its first row and column.
    windows = np.lib.stride_tricks.sliding_window_view(sum(maps), (side, side)).sum((2, 3))
    row, col = np.unravel_index(int(windows.argmax()), windows.shape)
    return Inset(int(row), int(col), side)


def _check(inset: Inset, size: tuple[int, int]) -> None:
    """Raise an `InputError` unless an inset lies within a picture."""
    row, col, side = inset
    if side < 2 or row < 0 or col < 0 or row + side > size[0] or col + side > size[1]:
        limits = f"a square of 2 or more texels within {size[0]} × {size[1]}"
        raise InputError(f"--inset {row},{col},{side}: it must be {limits}")


def _with_inset(picture: np.ndarray, inset: Inset, factor: int) -> np.ndarray:
    """A slice (H, W, 3) enlarged by `factor`, with a frame around the inset's place, and the magnified inset, also in a
    frame, in the corner that is farthest from that place."""
    large = enlarged(picture, factor)
    row, col, side = inset
    framed(large, row * factor, col * factor, side * factor)
    half = min(large.shape[:2]) // 2
    zoom = max(1, min(ZOOM * factor, half // side))  # at most half a side of the picture
    crop = enlarged(picture[row : row + side, col : col + side], zoom)
    in_upper_half = row + side / 2 < picture.shape[0] / 2
    in_left_half = col + side / 2 < picture.shape[1] / 2
    top = large.shape[0] - len(crop) if in_upper_half else 0
    left = large.shape[1] - crop.shape[1] if in_left_half else 0
    large[top : top + len(crop), left : left + crop.shape[1]] = crop
    framed(large, top, left, len(crop))
    return large


def framed(picture: np.ndarray, top: int, left: int, side: int) -> None:
    """Draw the frame of a square, two pixels wide, in place."""
    bottom, right = top + side, left + side
    picture[top : top + 2, left:right] = FRAME
    picture[bottom - 2 : bottom, left:right] = FRAME
    picture[top:bottom, left : left + 2] = FRAME
    picture[top:bottom, right - 2 : right] = FRAME


def _decibels(run: Run, row: Row, pair: int) -> str:
    """The display PSNR of one slice as text, from the stored errors; "exact" without error, "" if it is not known."""
    scores = arrays(run.folder, row.job, "slices", ("pairs", PSNR))
    if not scores:
        return ""
    errors = dict(zip(scores["pairs"].tolist(), scores[PSNR].tolist(), strict=True))
    error = errors.get(pair)
    if error is None:
        return ""
    if error == 0:
        return "exact"
    return f"{fixed(float(psnr(error)), 1)} dB"
