"""Polar maps: where over the hemisphere of views and of lights a codec errs."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from bench.records import Run
from reports.artefacts import angular
from reports.columns import FLIP
from reports.figures.canvas import Figure, new, png, short, style
from reports.rows import Material, materials

_SIDES = {"view": "by view", "light": "by light"}


def polar_maps(run: Run) -> Iterator[Figure]:
    """For each material: mean FLIP over the cells of both hemispheres, a column a codec, one scale for all."""
    for material in materials(run):
        found = []
        for row in material.measured:
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
        drawing = new(1.75 * per_line + 1.4, 3.9 * blocks + 0.7, layout="constrained")
        panels = drawing.subplots(2 * blocks, per_line, subplot_kw={"projection": "polar"}, squeeze=False)
        for axes in panels.flat:
            axes.set_visible(False)
        for (side, i), value in values.items():
            axes = panels[2 * (i // per_line) + list(_SIDES).index(side)][i % per_line]
            mesh = _disc(axes, maps[i][1][side], value, top)
            axes.set_title((short(maps[i][0], 22) + "\n" if side == "view" else "") + _SIDES[side], fontsize=8)
        bar = drawing.colorbar(mesh, ax=panels, shrink=0.6, pad=0.02)
        bar.set_label("mean FLIP, all pairs (lower is better); blank: no pair")
        drawing.suptitle(f"{title}\n{material.split}; θ from 0° (centre) to 90° (rim), φ counter-clockwise", fontsize=9)
        return Figure(material.name, "polar", title, png(drawing))


def _values(stored: dict[str, Any]) -> np.ndarray:
    return np.array([[np.nan if x is None else x for x in row] for row in stored["value"]], float)


def _disc(axes: Any, stored: dict[str, Any], value: np.ndarray, top: float) -> Any:
    sectors = len(stored["phi_centres_deg"])
    phi = np.radians((np.arange(sectors + 1) - 0.5) * 360 / sectors)
    axes.set_visible(True)
    axes.grid(False)
    mesh = axes.pcolormesh(phi, stored["theta_edges_deg"], value, cmap="cividis", vmin=0, vmax=top, shading="flat")
    axes.set_xticks(np.radians([0, 90, 180, 270]), ["0°", "90°", "180°", "270°"], fontsize=6)
    axes.tick_params(pad=-3)
    axes.set_yticks([30, 60], [])
    axes.yaxis.grid(True, color="white", linewidth=0.5, alpha=0.6)
    axes.spines["polar"].set_linewidth(0.5)
    return mesh
