"""A figure of chosen pairs for a paper: the truth and decoded slices with magnified insets, and FLIP maps below.

A pair is known by its index. A run stores the slices of a few pairs of each job as the artefact `pictures`: `truth`,
`decoded` and `flip` (slices, height, width, 3), uint8, `pairs`, the angles `wo_deg` and `wi_deg` (θ, φ), and the mask
`sheet` of those on the contact sheet. The *place* of a slice is its index in these arrays. An *inset* is a square of
texels that is shown again, magnified.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bench.inputs.errors import InputError
from bench.metrics.psnr import psnr
from bench.records import PSNR, Run
from reports.artefacts import Arrays, of_same_pairs, of_shown
from reports.figures.canvas import Figure, Sheet, enlarged, factor_to, short, style
from reports.figures.contact import angles_in_words, flip_scale, left_out_words, scores_by_pair
from reports.numbers import EXACT, fixed
from reports.rows import Row, materials

CELL = 256  # the least side of a picture in pixels; smaller slices are enlarged by a whole factor
GAP = 8  # pixels between pictures
TOP = 30  # pixels above them
LINE = 18  # pixels for a line of text
ZOOM = 3  # an inset shows its texels so many times as large as the picture does
LETTER = 9  # pixels of a letter of a heading, by which long headings are cut
BORDER = 2  # pixels of the line of a frame
FRAME = np.array([230, 60, 20], np.uint8)  # colour of the frames around an inset and its place


class Inset(NamedTuple):
    """A square of texels that is magnified: its first row and column, from the top left, and its side in texels."""

    row: int
    col: int
    side: int


def pairs_figure(run: Run, name: str, pairs: Sequence[int], inset: Inset | None = None) -> Figure:
    """The slices of some pairs of a material by its first seed: the truth, then every codec, with their FLIP maps.

    `name` is that of the material, `pairs` are indices of pairs of the BTF; without any, those of the contact sheet are
    shown. Without an inset, the square of a quarter of the shorter side is magnified in which the FLIP of all codecs
    together is largest, in each slice another. Codecs whose stored slices are of other pairs than the first codec's are
    named below.

    `InputError` if the material or a pair has no stored slices, of a pair with those that have some; and for an inset
    that does not lie within the picture.
    """
    needed = {"truth", "decoded", "pairs", "wo_deg", "wi_deg"}  # a row whose file lacks some cannot be drawn
    drawable = []
    for material in materials(run):
        if material.name == name:
            drawable = [(row, stored) for row, stored in of_shown(run, material, "pictures") if stored.keys() >= needed]
    if not drawable:
        remedy = "published records have numbers alone, so give the folder of a run"
        raise InputError(f"figure pairs: no slices of {name} are stored in {run.folder}: {remedy}")
    rows, others = of_same_pairs(drawable)
    left_out = [row.label for row in others]
    places = _places(rows[0][1], pairs)
    with style():
        sheet = _sheet(run, rows, left_out, places, inset)
    return Figure(name, "pairs", f"{name}: slices and FLIP maps of chosen pairs", sheet.png(), sheet)


def _places(stored: Arrays, pairs: Sequence[int]) -> list[int]:
    """The places in the stored arrays of the slices of some pairs; without any, of those on the contact sheet or, if
    the file does not say which, of the first four. `InputError` for a pair without a slice."""
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


def _sheet(
    run: Run, rows: list[tuple[Row, Arrays]], left_out: list[str], places: list[int], inset: Inset | None
) -> Sheet:
    """The sheet: a line of pictures for each place in the stored arrays, above FLIP maps if all codecs have them.

    `rows` are the codecs with their arrays, a column each after that of the truth; a line at the bottom names those
    `left_out`, if any. Without an inset one is found for each place. `InputError` if the inset does not lie within the
    picture.
    """
    _, first = rows[0]
    height, width = first["truth"].shape[1:3]
    factor = factor_to(CELL, (height, width))
    cell_height = height * factor
    cell_width = width * factor
    block = LINE + cell_height + GAP  # the height of all that is shown of one pair
    if _all_have_flip(rows):
        block += GAP // 2 + cell_height
    columns = 1 + len(rows)
    bottom = LINE if left_out else 0
    sheet = Sheet(columns * (cell_width + GAP) - GAP, TOP + len(places) * block + bottom)
    if left_out:
        sheet.text(0, sheet.height - LINE / 2, left_out_words(left_out, sheet.width))
    # The heading of each column.
    for column, label in enumerate(["truth", *(row.label for row, _ in rows)]):
        middle = column * (cell_width + GAP) + cell_width / 2
        sheet.text(middle, TOP / 2, short(label, cell_width // LETTER), ha="center", fontsize=10)
    errors = [scores_by_pair(run, row.job, PSNR) for row, _ in rows]
    for number, place in enumerate(places):
        zoomed = inset or _worst_square(rows, place, (height, width))
        if zoomed:
            _require_within(zoomed, (height, width))
        _draw_pair(sheet, rows, errors, place, TOP + number * block, zoomed, factor)
        if number == 0 and _all_have_flip(rows):  # below the first truth, which has no FLIP map
            flip_scale(sheet, left=0, middle=TOP + LINE + cell_height + cell_height // 2, width=cell_width)
    return sheet


def _draw_pair(
    sheet: Sheet,
    rows: list[tuple[Row, Arrays]],
    errors: list[dict[int, float]],
    place: int,
    top: int,
    inset: Inset | None,
    factor: int,
) -> None:
    """Draw all that is shown of one pair, from `top` in pixels down: a line of text, its pictures, their FLIP maps.

    `place` is that of the slice in the stored arrays of `rows`; `errors` has the mean squared errors of each row by
    pair. A texel is `factor` pixels a side.
    """
    _, first = rows[0]
    view = angles_in_words("view", first["wo_deg"][place])
    light = angles_in_words("light", first["wi_deg"][place])
    sheet.text(0, top + LINE / 2, f"{view}; {light}")
    truth = first["truth"][place]
    sheet.picture(0, top + LINE, _with_inset(truth, inset, factor))
    cell_height = truth.shape[0] * factor
    cell_width = truth.shape[1] * factor
    pair = int(first["pairs"][place])  # the same of all rows
    for column, (_, stored) in enumerate(rows, 1):  # after that of the truth
        left = column * (cell_width + GAP)
        sheet.picture(left, top + LINE, _with_inset(stored["decoded"][place], inset, factor))
        decibels = _decibels(errors[column - 1].get(pair))
        sheet.text(left + cell_width, top + LINE / 2, decibels, ha="right")
        if _all_have_flip(rows):
            below = top + LINE + cell_height + GAP // 2
            sheet.picture(left, below, enlarged(stored["flip"][place], factor))


def _all_have_flip(rows: list[tuple[Row, Arrays]]) -> bool:
    """Whether each codec has stored FLIP maps; without one of them none is shown."""
    return all("flip" in stored for _, stored in rows)


def _worst_square(rows: list[tuple[Row, Arrays]], place: int, size: tuple[int, int]) -> Inset | None:
    """The square of a quarter of the shorter side in which the FLIP maps of one slice are brightest together; without
    maps, the one in the centre. None of a picture that is a single texel wide or high.

    `place` is the slice's in the stored arrays; `size` is (height, width) in texels.
    """
    if min(size) < 2:
        return None
    side = max(2, min(size) // 4)
    # Of each codec (H, W): its map's colours added up, which grow brighter with the error.
    maps = [stored["flip"][place].astype(float).sum(2) for _, stored in rows if "flip" in stored]
    if not maps:
        return Inset((size[0] - side) // 2, (size[1] - side) // 2, side)
    # Every such square: (first rows, first columns, side, side).
    squares = np.lib.stride_tricks.sliding_window_view(sum(maps), (side, side))
    sums = squares.sum((2, 3))
    row, col = np.unravel_index(int(sums.argmax()), sums.shape)
    return Inset(int(row), int(col), side)


def _require_within(inset: Inset, size: tuple[int, int]) -> None:
    """Raise an `InputError` unless an inset lies within a picture of `size`, (height, width) in texels."""
    row, col, side = inset
    if side < 2 or row < 0 or col < 0 or row + side > size[0] or col + side > size[1]:
        limits = f"a square of 2 or more texels within {size[0]} × {size[1]}"
        raise InputError(f"--inset {row},{col},{side}: it must be {limits}")


def _with_inset(picture: np.ndarray, inset: Inset | None, factor: int) -> np.ndarray:
    """A slice (H, W, 3) enlarged by `factor`, with a frame around the inset's place, and the magnified inset, also in a
    frame, in the corner that is farthest from that place. Returns a picture (H · factor, W · factor, 3)."""
    large = enlarged(picture, factor)
    if inset is None:
        return large
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
    """Draw the frame of a square into a picture (H, W, 3), changing it. The frame lies within the square, whose upper
    left corner and `side` are in pixels."""
    bottom, right = top + side, left + side
    picture[top : top + BORDER, left:right] = FRAME
    picture[bottom - BORDER : bottom, left:right] = FRAME
    picture[top:bottom, left : left + BORDER] = FRAME
    picture[top:bottom, right - BORDER : right] = FRAME


def _decibels(error: float | None) -> str:
    """The display PSNR of a slice of this mean squared error as text; "exact" without error, "" if it is not known."""
    if error is None:
        return ""
    if error == 0:
        return EXACT
    return f"{fixed(float(psnr(error)), 1)} dB"
