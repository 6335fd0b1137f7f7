"""The error of each texel's ABRDF, as a picture of the texels."""

import numpy as np
from matplotlib.colors import LogNorm

from bench.records import Run
from reports.artefacts import of_shown
from reports.figures.canvas import Figure, Sheet, coloured, enlarged, grid_of, log_ticks, of_each_material, short
from reports.rows import MaterialRows


@of_each_material
def abrdf_maps(run: Run, material: MaterialRows) -> Figure | None:
    """The squared log1p error of each texel over all pairs, one logarithmic scale for all codecs."""
    maps = [(row.label, scores["abrdf"]) for row, scores in of_shown(run, material, "slices", ("abrdf",))]
    if not maps:
        return None
    title = f"{material.name}: error of each texel's ABRDF"
    rows, columns = grid_of(len(maps), 5)
    height, width = (max(error.shape[axis] for _, error in maps) for axis in (0, 1))
    factor = max(1, -(-CELL // max(height, width)))
    cell, scale = (width * factor + 14, height * factor + 26), _scale(maps)
    sheet = Sheet(2 * _EDGE + max(columns, 3) * cell[0] + _BAR, _TOP + rows * cell[1])
    sheet.text(_EDGE, 16, f"{title} ({material.split})", fontsize=9)
    for number, (label, error) in enumerate(maps):
        left, top = _EDGE + number % columns * cell[0], _TOP + number // columns * cell[1]
        sheet.text(left, top - 10, short(label, 24))
        sheet.picture(left, top, enlarged(coloured(error, "cividis", scale), factor))
    bar = sheet.scale(sheet.width - _BAR, _TOP, (14, min(rows * cell[1] - 40, 300)), "cividis", norm=scale)
    log_ticks(bar.ax.yaxis)
    bar.set_label("mean squared error of log1p, all pairs", fontsize=8)
    return Figure(material.name, "abrdf", title, sheet.png(), sheet)


_EDGE, _BAR, _TOP = 14, 100, 54
CELL = 176  # the least side of a map in pixels


def _scale(maps: list[tuple[str, np.ndarray]]) -> LogNorm:
    """From the smallest to the largest error of any codec, at most five decades; no error is off the scale."""
    positive = np.concatenate([error[error > 0] for _, error in maps])
    if not len(positive):
        return LogNorm(1e-6, 1)
    top = float(positive.max())
    return LogNorm(max(float(positive.min()), top * 1e-5), top * 1.0001, clip=True)
