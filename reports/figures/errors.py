"""Maps of a codec's error, of each texel's ABRDF and over the hemispheres of views and of lights; quality by angle.

A run stores the numbers as artefacts of each job: `slices` has the mean squared error of each pair's slice (by the name
of PSNR), `wo_deg` and `wi_deg` (pairs, 2) with θ and φ of view and light in degrees, the mask `heldout` of pairs that
no fit saw, and `abrdf` (height, width), the error of each texel over all pairs. `angular` has mean scores over cells of
both hemispheres.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.colors import LogNorm, Normalize

from bench.metrics.psnr import psnr
from bench.records import FLIP, PSNR, Run
from reports.artefacts import Arrays, angular, of_shown
from reports.figures.canvas import (
    Figure,
    Sheet,
    coloured,
    enlarged,
    factor_to,
    grid_of,
    legend,
    log_ticks,
    of_each_material,
    plots,
    png,
    short,
)
from reports.rows import MaterialRows, Row
from reports.styles import Styles

_EDGE = 14  # pixels of the margin
_BAR = 100  # pixels of the room of a colour bar
_BAR_WIDTH = 14  # pixels of its colours
_ABRDF_TOP = 54  # pixels of the head of the figure
_ABRDF_CELL = 176  # the least side of a map in pixels
# Of polar maps, in which a block is a codec's two discs:
_POLAR_TOP = 76  # pixels of the head of the figure
_DISC = 140  # side of a disc in pixels
_DISC_DEG = np.linspace(-92, 92, _DISC)  # θ of the pixels across it: a little beyond the horizon, for its ring
_BLOCK_WIDTH = _DISC + 24  # pixels from one block to the next beside it
_BLOCK_HEIGHT = 2 * _DISC + 80  # pixels from one line of blocks to the next: two discs and their texts
_SIDES = {"view": "by view", "light": "by light"}  # hemispheres: their names in `angular`, and in words
_RING_DEG = 15.0
EDGES_DEG = np.arange(0.0, 91.0, _RING_DEG)  # of rings of θ
_READ = {PSNR, "heldout", "wo_deg", "wi_deg"}  # what `angle_curves` reads of `slices`


@of_each_material
def abrdf_maps(run: Run, material: MaterialRows) -> Figure | None:
    """A map a codec of the mean squared error of log1p at each texel over all pairs, on one logarithmic scale.

    None if no codec has stored one.
    """
    maps = [(row.label, scores["abrdf"]) for row, scores in of_shown(run, material, "slices", ("abrdf",))]
    if not maps:
        return None
    title = f"{material.name}: error of each texel's ABRDF"
    rows, columns = grid_of(len(maps), columns=5)
    height = max(error.shape[0] for _, error in maps)
    width = max(error.shape[1] for _, error in maps)
    factor = factor_to(_ABRDF_CELL, (height, width))
    cell = (width * factor + 14, height * factor + 26)  # with a gap, and a line of text above
    scale = _logarithmic_scale([error for _, error in maps])
    # At least three columns wide: the title and the split stand on one line.
    sheet = Sheet(2 * _EDGE + max(columns, 3) * cell[0] + _BAR, _ABRDF_TOP + rows * cell[1])
    sheet.text(_EDGE, 16, f"{title} ({material.split_in_words})", fontsize=9)
    for number, (label, error) in enumerate(maps):
        line, place = divmod(number, columns)
        left = _EDGE + place * cell[0]
        above = _ABRDF_TOP + line * cell[1]
        sheet.text(left, above - 10, short(label, 24))
        sheet.picture(left, above, enlarged(coloured(error, "cividis", scale), factor))
    bar_height = min(rows * cell[1] - 40, 300)
    bar = sheet.scale(sheet.width - _BAR, _ABRDF_TOP, (_BAR_WIDTH, bar_height), "cividis", norm=scale)
    log_ticks(bar.ax.yaxis)
    bar.set_label("mean squared error of log1p, all pairs", fontsize=8)
    return Figure(material.name, "abrdf", title, sheet.png(), sheet)


def _logarithmic_scale(maps: Sequence[np.ndarray]) -> LogNorm:
    """The scale from the smallest to the largest error above 0 on any map, at most five decades; none is off it."""
    positive = np.concatenate([error[error > 0] for error in maps])
    if not len(positive):
        return LogNorm(1e-6, 1)  # of any range: without an error no map has a colour
    top = float(positive.max())
    return LogNorm(max(float(positive.min()), top * 1e-5), top * 1.0001, clip=True)


@of_each_material
def polar_maps(run: Run, material: MaterialRows) -> Figure | None:
    """Mean FLIP over the cells of both hemispheres, a column a codec, one scale for all. None if no codec has a map."""
    maps = []  # the label of a codec, and its polar maps: by side, the edges and the values of cells
    for row in material.shown:
        stored = angular(run.folder, row.job)
        name = row.metric(FLIP)
        if stored and name in stored["polar"]:
            maps.append((row.label, stored["polar"][name]))
    if not maps:
        return None
    title = f"{material.name}: FLIP over the hemispheres"
    scale = _scale_from_zero([polar for _, polar in maps])
    # In a block the hemisphere of views is above that of lights.
    lines, per_line = grid_of(len(maps), columns=6)
    # At least four blocks wide: the title and the split stand on one line.
    sheet = Sheet(2 * _EDGE + max(per_line, 4) * _BLOCK_WIDTH + _BAR, _POLAR_TOP + lines * _BLOCK_HEIGHT)
    sheet.text(_EDGE, 14, f"{title} ({material.split_in_words})", fontsize=9)
    sheet.text(_EDGE, 32, "θ 0° in the centre, rings at 30°, 60°, 90°; φ counter-clockwise from the right")
    for number, (label, polar) in enumerate(maps):
        line, place = divmod(number, per_line)
        left = _EDGE + place * _BLOCK_WIDTH
        above = _POLAR_TOP + line * _BLOCK_HEIGHT
        sheet.text(left, above - 20, short(label, 24))
        for side, words in _SIDES.items():
            sheet.text(left, above - 6, words, color="0.35")
            sheet.picture(left, above + 4, _disc(polar[side], scale))
            above += _BLOCK_HEIGHT // 2 - 10  # lights stand below views
    bar = sheet.scale(sheet.width - _BAR, _POLAR_TOP, (_BAR_WIDTH, 260), "cividis", norm=scale)
    bar.set_label("mean FLIP, all pairs\n(lower is better; blank: no pair)", fontsize=8)
    return Figure(material.name, "polar", title, sheet.png(), sheet)


def _scale_from_zero(maps: Sequence[dict[str, Any]]) -> Normalize:
    """The scale from 0 to the largest value of any cell; to 1 where no codec has an error."""
    top = 0.0
    for polar in maps:
        for side in _SIDES:
            value = np.array(polar[side]["value"], float)  # by cell
            top = np.max(value, where=np.isfinite(value), initial=top)
    return Normalize(0, top or 1)


def _disc(stored: dict[str, Any], scale: Normalize) -> np.ndarray:
    """The cells of a hemisphere as a picture of its disc, (H, W, 4), with rings; θ grows outwards, φ from the right.

    `stored` has the edges of the rings of θ and the centres of the sectors of φ, in degrees, and the cells. Sector 0 is
    centred on the right, and φ = 90° is on top. NaN, and what lies outside the hemisphere, are transparent.
    """
    value = np.array(stored["value"], float)  # (rings of θ, sectors of φ), NaN without a pair
    x, y = np.meshgrid(_DISC_DEG, -_DISC_DEG)  # of each pixel, in degrees of θ from the centre; y grows upwards
    sectors = len(stored["phi_centres_deg"])
    sector = np.round(np.degrees(np.arctan2(y, x)) * sectors / 360).astype(int) % sectors
    radius = np.hypot(x, y)
    ring = np.searchsorted(stored["theta_edges_deg"], radius, side="right") - 1
    inside = ring < len(value)
    value_of_pixel = value[np.where(inside, ring, 0), sector]  # ring 0 stands in for none, and is masked below
    picture = coloured(np.where(inside, value_of_pixel, np.nan), "cividis", scale)
    pixel = _DISC_DEG[1] - _DISC_DEG[0]  # in degrees
    for edge in (30, 60, 90):  # grey rings, for the eye; 90° is the horizon
        picture[abs(radius - edge) < pixel] = (128, 128, 128, 255)
    return picture


@of_each_material
def angle_curves(run: Run, material: MaterialRows) -> Figure | None:
    """Display PSNR over rings of 15° in θ_o and in θ_i, of the pairs that decide: that of a ring's mean squared error.

    None if no codec has stored the errors of its slices.
    """
    curves = of_shown(run, material, "slices", _READ)
    if not curves:
        return None
    styles = Styles(run.jobs)
    title = f"{material.name}: quality by angle"
    height = max(4.0, 1.6 + 0.2 * len(curves))  # inches; the legend has a line for each codec
    drawing, panels = plots(10, height, count=2)
    for axes, side, name in zip(panels, ("wo_deg", "wi_deg"), ("view, θₒ", "light, θᵢ"), strict=True):
        handles = []
        for row, scores in curves:
            centres, decibels = _rings(row, scores, side)
            handles += axes.plot(centres, decibels, **styles.of_codec(row.label), markersize=5, linewidth=1.2)
        axes.set(xlabel=f"{name} in degrees", xlim=(0, 90), xticks=EDGES_DEG)
    panels[0].set_ylabel(f"display PSNR, dB ({material.deciding_in_words}; higher is better)")
    panels[0].set_title(f"{title}\n{material.split_in_words}", loc="left")
    # A codec without any error has no point, but stands in the legend.
    names = [f"{row.label} (no error)" if row.psnr is None else row.label for row, _ in curves]
    legend(panels[1], handles, names)
    return Figure(material.name, "angles", title, png(drawing), drawing)


def _rings(row: Row, scores: Arrays, side: str) -> tuple[np.ndarray, np.ndarray]:
    """Centres in degrees of the rings of θ that hold a pair, and PSNR in dB of the mean squared error there, both (n,).

    `scores` are the arrays `_READ` of the row's job; `side` is "wo_deg" or "wi_deg". A ring without any error has no
    point, because its PSNR is infinite.
    """
    heldout = scores["heldout"]  # a mask of pairs
    chosen = heldout if row.deciding_group == "heldout" else np.ones(len(heldout), bool)
    error = scores[PSNR][chosen]
    theta = scores[side][chosen, 0]
    edges_below = np.searchsorted(EDGES_DEG, theta + 1e-4, side="right")  # θ just below an edge by rounding lies on it
    ring = np.clip(edges_below - 1, 0, len(EDGES_DEG) - 2)  # 90° lies in the last ring
    centres = []
    means = []
    for number in np.unique(ring):
        mean = error[ring == number].mean()
        if mean > 0:
            centres.append(EDGES_DEG[number] + _RING_DEG / 2)
            means.append(mean)
    return np.array(centres), psnr(np.array(means))
