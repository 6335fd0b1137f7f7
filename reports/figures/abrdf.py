"""The error of each texel's ABRDF, as a picture of the texels."""

from collections.abc import Iterator

import numpy as np
from matplotlib.colors import LogNorm

from bench.records import Run
from reports.artefacts import arrays
from reports.figures.canvas import Figure, grid_of, log_ticks, new, png, short, style
from reports.rows import Material, materials


def abrdf_maps(run: Run) -> Iterator[Figure]:
    """For each material: the squared log1p error of each texel over all pairs, one logarithmic scale for all codecs."""
    for material in materials(run):
        stored = [(row.label, arrays(run.folder, row.job, "slices")) for row in material.shown]
        maps = [(label, scores["abrdf"]) for label, scores in stored if scores and "abrdf" in scores]
        if maps:
            yield _figure(material, maps)


def _figure(material: Material, maps: list[tuple[str, np.ndarray]]) -> Figure:
    title = f"{material.name}: error of each texel's ABRDF"
    rows, columns = grid_of(len(maps), 5)
    with style():
        drawing = new(1.9 * columns + 1.2, 2.2 * rows + 0.6, layout="constrained")
        panels = drawing.subplots(rows, columns, squeeze=False)
        for axes in panels.flat:
            axes.set_axis_off()
        for axes, (label, error) in zip(panels.flat, maps, strict=False):
            image = axes.imshow(error, cmap="cividis", norm=_scale(maps), interpolation="nearest")
            axes.set_title(short(label, 24), fontsize=8)
        bar = drawing.colorbar(image, ax=panels, shrink=0.8, pad=0.02)
        log_ticks(bar.ax.yaxis)
        bar.set_label("mean squared error of log1p, all pairs")
        drawing.suptitle(f"{title} ({material.split})", fontsize=9)
        return Figure(material.name, "abrdf", title, png(drawing))


def _scale(maps: list[tuple[str, np.ndarray]]) -> LogNorm:
    """From the smallest to the largest error of any codec, at most five decades; no error at all is off the scale."""
    positive = np.concatenate([error[error > 0] for _, error in maps])
    if not len(positive):
        return LogNorm(1e-6, 1)
    top = float(positive.max())
    return LogNorm(max(float(positive.min()), top * 1e-5), top * 1.0001, clip=True)
