"""Contact sheets: a few slices, true and decoded, beside their FLIP maps."""

import textwrap
from collections.abc import Iterator
from typing import Any

import numpy as np

from bench.records import FLIP, Run
from reports.artefacts import Arrays, arrays
from reports.figures.canvas import DPI, Figure, new, png, style
from reports.rows import Material, Row, materials

CELL = 128  # the least side of a picture in pixels; smaller slices are enlarged by a whole factor
_GAP, _LEFT, _TOP, _BOTTOM = 6, 150, 76, 22


def contact_sheets(run: Run) -> Iterator[Figure]:
    """For each material: one row a codec below the truth, one pair of columns (slice, FLIP map) a shown slice."""
    for material in materials(run):
        stored = [(row, arrays(run.folder, row.job, "pictures")) for row in material.shown]
        rows = [(row, pictures) for row, pictures in stored if pictures]
        if rows:
            yield _sheet(material, rows, run)


def _sheet(material: Material, rows: list[tuple[Row, Arrays]], run: Run) -> Figure:
    first = rows[0][1]
    count, height, width = first["truth"].shape[:3]
    factor = max(1, -(-CELL // max(height, width)))
    cell = (width * factor, height * factor)
    pair = 2 * cell[0] + 2 * _GAP
    size = (_LEFT + count * pair, _TOP + (len(rows) + 1) * (cell[1] + _GAP) + _BOTTOM)
    title = f"{material.name}: slices as decoded, and FLIP maps"
    with style():
        drawing = new(size[0] / DPI, size[1] / DPI)
        sheet = _Sheet(drawing, size, cell)
        sheet.text(_GAP, 14, f"{title} ({material.split})", fontsize=10)
        for k in range(count):
            left = _LEFT + k * pair
            sheet.text(left, _TOP - 34, _angles("view", first["wo_deg"][k]))
            sheet.text(left, _TOP - 18, _angles("light", first["wi_deg"][k]))
            sheet.picture(left, 0, first["truth"][k])
        sheet.label(0, "truth")
        for number, (row, pictures) in enumerate(rows, 1):
            sheet.label(number, row.label)
            means = _flip_means(run, row, pictures)
            for k in range(count):
                left = _LEFT + k * pair
                sheet.picture(left, number, pictures["decoded"][k])
                if "flip" in pictures:
                    sheet.picture(left + cell[0] + 2, number, pictures["flip"][k], means[k])
        sheet.scale(_LEFT + cell[0] + 2)
        return Figure(material.name, "contact", title, png(drawing))


def _angles(side: str, degrees: np.ndarray) -> str:
    return f"{side}: θ {degrees[0]:.0f}°, φ {degrees[1]:.0f}°"


def _flip_means(run: Run, row: Row, pictures: Arrays) -> list[str]:
    """The FLIP of each shown slice, from the stored numbers."""
    scores, name = arrays(run.folder, row.job, "slices"), row.metric(FLIP)
    if not scores or not name or "pairs" not in pictures:
        return [""] * len(pictures["decoded"])
    by_pair = dict(zip(scores["pairs"].tolist(), scores[name].tolist(), strict=True))
    return [f"{by_pair[pair]:.3f}" for pair in pictures["pairs"].tolist()]


class _Sheet:
    """A figure addressed in pixels from its top left corner, so that pictures keep theirs."""

    def __init__(self, drawing: Any, size: tuple[int, int], cell: tuple[int, int]):
        self.drawing, self.size, self.cell = drawing, size, cell

    def text(self, x: float, y: float, text: str, **look: Any) -> None:
        look = {"fontsize": 8, "va": "center"} | look
        self.drawing.text(x / self.size[0], 1 - y / self.size[1], text, **look)

    def label(self, row: int, text: str) -> None:
        """The name of a row, folded into the margin."""
        lines = _fold(text, 18)
        self.text(_LEFT - 8, self._top(row) + self.cell[1] / 2, "\n".join(lines), ha="right")

    def picture(self, left: float, row: int, picture: np.ndarray, caption: str = "") -> None:
        top, (width, height) = self._top(row), self.cell
        box = (left / self.size[0], 1 - (top + height) / self.size[1], width / self.size[0], height / self.size[1])
        axes = self.drawing.add_axes(box)
        axes.imshow(picture, interpolation="nearest", aspect="auto")
        axes.set_axis_off()
        if caption:
            axes.text(0.97, 0.04, caption, transform=axes.transAxes, color="white", fontsize=7.5, ha="right",
                      bbox={"facecolor": "black", "alpha": 0.55, "pad": 1.5, "linewidth": 0})  # fmt: skip

    def scale(self, left: float) -> None:
        """Magma from 0 to 1, in the place where the truth has no FLIP map."""
        middle = self._top(0) + self.cell[1] / 2
        width, height = self.cell[0], 12
        box = (left / self.size[0], 1 - (middle + height) / self.size[1], width / self.size[0], height / self.size[1])
        axes = self.drawing.add_axes(box)
        axes.imshow(np.linspace(0, 1, 256)[None], cmap="magma", aspect="auto")
        axes.set_axis_off()
        self.text(left + width / 2, middle - 12, "FLIP (lower is better)", ha="center", fontsize=7.5)
        self.text(left, middle + height + 8, "0", ha="left", fontsize=7.5)
        self.text(left + width, middle + height + 8, "1", ha="right", fontsize=7.5)

    def _top(self, row: int) -> int:
        return _TOP + row * (self.cell[1] + _GAP)


def _fold(text: str, width: int) -> list[str]:
    lines = textwrap.wrap(text, width) or [""]
    return [*lines[:4], *(["…"] if len(lines) > 4 else [])]
