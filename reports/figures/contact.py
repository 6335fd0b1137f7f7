"""Contact sheets: a few slices, true and decoded, beside their FLIP maps; a strip of one slice by a few codecs."""

import math
import textwrap
from collections.abc import Sequence
from itertools import chain
from math import prod

import numpy as np
from matplotlib.colors import Normalize

from bench.compare.choosing.budgets import Budget, budgets
from bench.metrics import stats_of
from bench.records import FLIP, PSNR, Job, Run, by_kind
from reports.artefacts import Arrays, arrays, of_shown
from reports.figures.canvas import Figure, Sheet, coloured, enlarged, of_each_material, style
from reports.numbers import fixed
from reports.rows import MaterialRows, Row

CELL = 128  # the least side of a picture in pixels; smaller slices are enlarged by a whole factor
# In pixels: between pictures, and the margins.
_GAP = 6
_LEFT = 150
_TOP = 76
_BOTTOM = 22


@of_each_material
def contact_sheets(run: Run, material: MaterialRows) -> Figure | None:
    """A row a codec below the truth; for each slice that the run marked for the sheet two columns, slice and FLIP map.

    Of a run that marked none, all stored slices are shown.
    """
    rows = []
    for row, stored in of_shown(run, material, "pictures"):
        pictures = stored
        if "sheet" in stored:  # a mask of the slices that the sheet shows
            pictures = {name: array[stored["sheet"]] for name, array in stored.items()}
        rows.append((row, pictures))
    if not rows:
        return None
    _, first = rows[0]
    count, height, width = first["truth"].shape[:3]
    factor = max(1, math.ceil(CELL / max(height, width)))
    cell = (width * factor, height * factor)
    pair = 2 * cell[0] + 2 * _GAP  # the width of two columns
    title = f"{material.name}: slices as decoded, and FLIP maps"
    sheet = Sheet(_LEFT + count * pair, _TOP + (len(rows) + 1) * (cell[1] + _GAP) + _BOTTOM)
    sheet.text(_GAP, 14, f"{title} ({material.split_in_words})", fontsize=10)
    for k in range(count):
        left = _LEFT + k * pair
        sheet.text(left, _TOP - 34, _angles("view", first["wo_deg"][k]))
        sheet.text(left, _TOP - 18, _angles("light", first["wi_deg"][k]))
        sheet.picture(left, _TOP, enlarged(first["truth"][k], factor))
    _label(sheet, "truth", _TOP + cell[1] / 2)
    for number, (row, pictures) in enumerate(rows, 1):
        top = _TOP + number * (cell[1] + _GAP)
        _label(sheet, row.label, top + cell[1] / 2)
        means = _flip_means(run, row, pictures)
        for k in range(count):
            left = _LEFT + k * pair
            sheet.picture(left, top, enlarged(pictures["decoded"][k], factor))
            if "flip" in pictures:
                sheet.picture(left + cell[0] + 2, top, enlarged(pictures["flip"][k], factor))
                if means[k]:  # its mean on a shade in the lower right corner of the map
                    right = left + 2 * cell[0]
                    bottom = top + cell[1]
                    sheet.picture(right - 34, bottom - 17, _SHADE)
                    sheet.text(right - 4, bottom - 9, means[k], color="white", fontsize=7.5, ha="right")
    flip_scale(sheet, _LEFT + cell[0] + 2, _TOP + cell[1] // 2, cell[0])
    return Figure(material.name, "contact", title, sheet.png(), sheet)


def _angles(side: str, direction: np.ndarray) -> str:
    """A direction (θ, φ) in degrees, in words."""
    theta, phi = direction
    return f"{side}: θ {theta:.0f}°, φ {phi:.0f}°"


def strip(run: Run, budget: Budget) -> Figure | None:
    """One slice of a surface: the truth, and the answers of the three best codecs within a budget.

    The surface is the first with pictures of three codecs, in the order of the kinds of surfaces. Of its stored slices
    the one is shown at which the best codec has its median PSNR.
    """
    result = budgets(run)
    for material in chain.from_iterable(by_kind(result.surfaces).values()):
        picked = result.picks(budget, [material])
        jobs = [picked[line][material].of[0] for line in result.ranked(budget, [material])]
        best_three = _of_same_pairs(run, jobs)[:3]
        if len(best_three) < 3:
            continue
        best, _ = best_three[0]
        scores = arrays(run.folder, best, "slices", ("pairs", PSNR))
        if scores:
            with style():
                return _strip(material, best_three, scores)
    return None


def _of_same_pairs(run: Run, jobs: Sequence[Job]) -> list[tuple[Job, Arrays]]:
    """The jobs with pictures of the same pairs as the first job that has any, each with its pictures."""
    with_pictures: list[tuple[Job, Arrays]] = []
    first: Arrays | None = None
    for job in jobs:
        pictures = arrays(run.folder, job, "pictures")
        if not pictures:
            continue
        if first is None:
            first = pictures
        if np.array_equal(pictures["pairs"], first["pairs"]):
            with_pictures.append((job, pictures))
    return with_pictures


def _strip(material: str, best_three: Sequence[tuple[Job, Arrays]], scores: Arrays) -> Figure:
    """The truth and the decoded pictures of one slice side by side, at which the best codec has its median error.

    `best_three` are jobs with their pictures, the best first; `scores` are the errors of that one.
    """
    _, first = best_three[0]
    truth = first["truth"]
    pairs = first["pairs"]
    errors = dict(zip(scores["pairs"].tolist(), scores[PSNR].tolist(), strict=True))
    places_by_error = sorted(range(len(pairs)), key=lambda place: errors[pairs[place]])
    median = places_by_error[len(pairs) // 2]  # the place of the slice that is shown
    factor = math.ceil(2 * CELL / max(truth.shape[1:3]))
    words = [f"{material}, truth"]
    for job, _ in best_three:
        bits = round(8 * job["bytes"]["total"] / prod(job["shape"]))
        words.append(f"{job['codec']}: {fixed(stats_of(job, PSNR)['mean'], 2)} dB, {bits} bits a texel")
    height = factor * truth.shape[1]
    width = factor * truth.shape[2]
    sheet = Sheet(4 * (width + _GAP) - _GAP, height + _BOTTOM)
    slices = [truth, *(pictures["decoded"] for _, pictures in best_three)]  # each of all shown pairs
    for column, slices_of_column in enumerate(slices):
        sheet.picture(column * (width + _GAP), 0, enlarged(slices_of_column[median], factor))
        sheet.text(column * (width + _GAP), height + _BOTTOM / 2, words[column])
    return Figure(material, "strip", f"{material}: truth and decoded; PSNR: mean over test slices", sheet.png(), sheet)


def _flip_means(run: Run, row: Row, pictures: Arrays) -> list[str]:
    """The mean FLIP of each shown slice as text, from the stored scores; "" for each if they are missing."""
    name = row.metric(FLIP)
    scores = arrays(run.folder, row.job, "slices", ("pairs", name))
    if not scores or not name or "pairs" not in pictures:
        return [""] * len(pictures["decoded"])
    by_pair = dict(zip(scores["pairs"].tolist(), scores[name].tolist(), strict=True))
    return [f"{by_pair[pair]:.3f}" for pair in pictures["pairs"].tolist()]


def _label(sheet: Sheet, text: str, middle: float) -> None:
    """The name of a row, folded into the margin."""
    lines = textwrap.wrap(text, 18)
    if len(lines) > 4:
        lines = [*lines[:4], "…"]
    sheet.text(_LEFT - 8, middle, "\n".join(lines), ha="right")


def flip_scale(sheet: Sheet, left: int, middle: int, width: int) -> None:
    """The colours of a FLIP map from 0 to 1, at the place of the truth's missing FLIP map."""
    ramp = np.broadcast_to(np.linspace(0, 1, width), (12, width))
    sheet.picture(left, middle, coloured(ramp, "magma", Normalize(0, 1)))
    sheet.text(left + width / 2, middle - 12, "FLIP (lower is better)", ha="center", fontsize=7.5)
    sheet.text(left, middle + 20, "0", ha="left", fontsize=7.5)
    sheet.text(left + width, middle + 20, "1", ha="right", fontsize=7.5)


_SHADE = np.array([[[0, 0, 0, 140]]], np.uint8).repeat(16, 0).repeat(34, 1)  # (16, 34, 4), black, half transparent
