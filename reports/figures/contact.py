"""Contact sheets: a few slices, true and decoded, beside their FLIP maps.

A run stores a few slices of each job as the artefact `pictures`: `truth`, `decoded` and `flip` (slices, height, width,
3), all uint8, their `pairs` (indices of pairs of the BTF), `wo_deg` and `wi_deg` (θ and φ of view and light in
degrees). Its artefact `slices` has the scores of all pairs.
"""

import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.colors import Normalize

from bench.records import FLIP, Job, Run
from reports.artefacts import Arrays, arrays, of_same_pairs, of_shown
from reports.figures.canvas import Figure, Sheet, coloured, enlarged, factor_to, of_each_material, short
from reports.rows import MaterialRows

CELL = 128  # the least side of a picture in pixels; smaller slices are enlarged by a whole factor
# In pixels: between pictures, and the margins, which hold texts.
_GAP = 6
_LEFT = 150
_TOP = 76
_BOTTOM = 22
_MAP_GAP = 2  # pixels between a slice and its FLIP map
_SHADE_SIZE = (16, 34)  # height and width in pixels of the shade behind the mean of a FLIP map
_SHADE = np.full((*_SHADE_SIZE, 4), (0, 0, 0, 140), np.uint8)  # RGBA: black, about half transparent
_LETTER = 7  # pixels of a letter, by which a long line is cut
_RAMP = 12  # height in pixels of the scale of FLIP maps


@of_each_material
def contact_sheets(run: Run, material: MaterialRows) -> Figure | None:
    """A row a codec below the truth; for each slice that the run marked for the sheet two columns, slice and FLIP map.

    Of a run that marked none, all stored slices are shown. Codecs whose slices are of other pairs than the first's
    are named below. None if no codec has stored pictures.
    """
    with_pictures = [(row, _marked(stored)) for row, stored in of_shown(run, material, "pictures")]
    if not with_pictures:
        return None
    rows, others = of_same_pairs(with_pictures)
    _, first = rows[0]
    count, height, width = first["truth"].shape[:3]
    factor = factor_to(CELL, (height, width))
    cell_width = width * factor
    cell_height = height * factor
    pair_width = _pair_width(cell_width)
    title = f"{material.name}: slices as decoded, and FLIP maps"
    sheet = Sheet(_LEFT + count * pair_width, _TOP + (len(rows) + 1) * (cell_height + _GAP) + _BOTTOM)
    sheet.text(_GAP, 14, f"{title} ({material.split_in_words})", fontsize=10)
    # The first row: the truth of each slice, below two lines of its angles.
    for place in range(count):
        left = _LEFT + place * pair_width
        sheet.text(left, _TOP - 34, angles_in_words("view", first["wo_deg"][place]))
        sheet.text(left, _TOP - 18, angles_in_words("light", first["wi_deg"][place]))
        sheet.picture(left, _TOP, enlarged(first["truth"][place], factor))
    _label(sheet, "truth", _TOP + cell_height / 2)
    for number, (row, pictures) in enumerate(rows, 1):
        top = _TOP + number * (cell_height + _GAP)
        _label(sheet, row.label, top + cell_height / 2)
        flip = scores_by_pair(run, row.job, row.metric(FLIP))
        _draw_slices(sheet, pictures, flip, top, factor)
    flip_scale(sheet, _LEFT + cell_width + _MAP_GAP, _TOP + cell_height // 2, cell_width)
    if others:
        labels = [row.label for row in others]
        sheet.text(_GAP, sheet.height - _BOTTOM / 2, left_out_words(labels, sheet.width))
    return Figure(material.name, "contact", title, sheet.png(), sheet)


def _draw_slices(sheet: Sheet, pictures: Arrays, flip: dict[int, float], top: int, factor: int) -> None:
    """Draw a codec's slices and FLIP maps with their means, `flip` by pair, from `top` in pixels down; a texel is
    `factor` pixels a side."""
    _, height, width = pictures["decoded"].shape[:3]
    cell_width = width * factor
    for place, decoded in enumerate(pictures["decoded"]):
        left = _LEFT + place * _pair_width(cell_width)
        sheet.picture(left, top, enlarged(decoded, factor))
        if "flip" in pictures:  # FLIP maps are not made of very small slices
            sheet.picture(left + cell_width + _MAP_GAP, top, enlarged(pictures["flip"][place], factor))
        if "flip" in pictures and "pairs" in pictures:
            mean = flip.get(int(pictures["pairs"][place]))
            _draw_mean(sheet, mean, right=left + 2 * cell_width, bottom=top + height * factor)


def _pair_width(cell_width: int) -> int:
    """The pixels from one slice, past its FLIP map, to the next slice."""
    return 2 * (cell_width + _GAP)


def _marked(stored: Arrays) -> Arrays:
    """The arrays of a job's pictures, of the slices alone that the run marked for the sheet; all if it marked none."""
    if "sheet" not in stored:
        return stored
    return {name: array[stored["sheet"]] for name, array in stored.items()}


def _draw_mean(sheet: Sheet, mean: float | None, right: int, bottom: int) -> None:
    """Write the mean of a FLIP map on a shade in its corner at `right` and `bottom` in pixels; nothing for None."""
    if mean is not None:
        shade_height, shade_width = _SHADE_SIZE
        sheet.picture(right - shade_width, bottom - shade_height - 1, _SHADE)
        sheet.text(right - 4, bottom - 9, f"{mean:.3f}", color="white", fontsize=7.5, ha="right")


def left_out_words(labels: Sequence[str], width: int) -> str:
    """The line that names codecs whose pictures are not shown, cut to a width in pixels."""
    return short(f"Left out, with slices of other pairs: {', '.join(labels)}", width // _LETTER)


def angles_in_words(side: str, direction: np.ndarray) -> str:
    """A direction (θ, φ) in degrees, in words; `side` says whose it is, "view" or "light"."""
    theta, phi = direction
    return f"{side}: θ {theta:.0f}°, φ {phi:.0f}°"


def scores_by_pair(run: Run, job: Job, metric: str) -> dict[int, float]:
    """A job's stored score of each slice by a metric, by the pair's index in the BTF; empty if they are missing.

    Those of PSNR are mean squared errors.
    """
    stored = arrays(run.folder, job, "slices", ("pairs", metric))
    if not stored or not stored.keys() >= {"pairs", metric}:
        return {}
    return dict(zip(stored["pairs"].tolist(), stored[metric].tolist(), strict=True))


def _label(sheet: Sheet, text: str, middle: float) -> None:
    """Write the name of a row into the left margin, folded; `middle` is its height in pixels from the top."""
    lines = textwrap.wrap(text, width=18)
    if len(lines) > 4:  # a long name is cut, so that it stays beside its own pictures
        lines = [*lines[:4], "…"]
    sheet.text(_LEFT - 8, middle, "\n".join(lines), ha="right")


def flip_scale(sheet: Sheet, left: int, middle: int, width: int) -> None:
    """Draw the colours of a FLIP map from 0 to 1, at the place of the truth's missing FLIP map.

    `left`, `middle` and `width` are those of this place, in pixels; the colours hang from its middle, with their title
    above and the numbers below.
    """
    ramp = np.broadcast_to(np.linspace(0, 1, width), (_RAMP, width))
    sheet.picture(left, middle, coloured(ramp, "magma", Normalize(0, 1)))
    sheet.text(left + width / 2, middle - 12, "FLIP (lower is better)", ha="center", fontsize=7.5)
    sheet.text(left, middle + 20, "0", ha="left", fontsize=7.5)
    sheet.text(left + width, middle + 20, "1", ha="right", fontsize=7.5)
