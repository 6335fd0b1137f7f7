"""Polar maps: where over the hemisphere of views and of lights a codec errs."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.patches import Circle

from bench.records import FLIP, Run
from reports.artefacts import angular
from reports.figures.canvas import Figure, new, png, short, style
from reports.rows import Material, materials

_SIDES = {"view": "by view", "light": "by light"}


def polar_maps(run: Run) -> Iterator[Figure]:
    """For each material: mean FLIP over the cells of both hemispheres, a column a codec, one scale for all."""
    for material in materials(run):
        found = []
        for row in material.shown:
            stored, name = angular(run.folder, row.job), row.metric(FLIP)
            if stored and name in stored["polar"]:
                found.append((row.label, stored["polar"][name]))
        if found:
            yield _figure(material, found)


def _figure(material: Material, maps: list[tuple[str, dict[str, Any]]]) -> Figure:
    title = f"{material.name}: FLIP over the hemispheres"
    values = {(side, i): _values(stored[side]) for side in _SIDES for i, (_, stored) in enumerate(maps)}
    top = max((np.nanmax(value) for value in values.values() if np.isfinite(value).any()), default=1.0)
    per_line = min(6, len(maps))
    blocks = -(-len(maps) // per_line)
    with style():
        drawing = new(1.65 * per_line + 1.4, 3.5 * blocks + 0.8, layout="constrained")
        panels = drawing.subplots(2 * blocks, per_line, squeeze=False)
        for axes in panels.flat:
            axes.set_axis_off()
        for (side, i), value in values.items():
            axes = panels[2 * (i // per_line) + list(_SIDES).index(side)][i % per_line]
            image = _disc(axes, maps[i][1][side], value, top)
            axes.set_title((short(maps[i][0], 24) + "\n" if side == "view" else "") + _SIDES[side], fontsize=8)
        bar = drawing.colorbar(image, ax=panels, shrink=0.6 / blocks**0.5, pad=0.02)
        bar.set_label("mean FLIP, all pairs\n(lower is better; blank: no pair)")
        frame = "θ 0° in the centre, rings at 30°, 60°, 90°; φ counter-clockwise from the right"
        drawing.suptitle(f"{title} ({material.split})\n{frame}", fontsize=9)
        return Figure(material.name, "polar", title, png(drawing))


def _values(stored: dict[str, Any]) -> np.ndarray:
    return np.array([[np.nan if x is None else x for x in row] for row in stored["value"]], float)


def _disc(axes: Any, stored: dict[str, Any], value: np.ndarray, top: float) -> Any:
    """The cells as a picture of the disc: sector 0 is centred on +x."""
    x, y = np.meshgrid(_AXIS_DEG, _AXIS_DEG)
    sectors = len(stored["phi_centres_deg"])
    sector = np.round(np.degrees(np.arctan2(y, x)) * sectors / 360).astype(int) % sectors
    ring = np.searchsorted(stored["theta_edges_deg"], np.hypot(x, y), side="right") - 1
    inside = ring < len(value)
    picture = np.where(inside, value[np.where(inside, ring, 0), sector], np.nan)
    for radius in (30, 60, 90):
        axes.add_patch(Circle((0, 0), radius, fill=False, linewidth=0.5, edgecolor="0.5"))
    extent = (-90, 90, -90, 90)
    axes.set(xlim=(-93, 93), ylim=(-93, 93))
    return axes.imshow(
        picture, cmap="cividis", vmin=0, vmax=top, origin="lower", extent=extent, interpolation="nearest"
    )


_AXIS_DEG = np.linspace(-90, 90, 240)
