"""Summarises a demand in numbers, and draws it as one PNG.

The *importance* of a query is its share of the light that a white diffuser in the material's place would send to the
camera.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from bench.btf import Array
from bench.demand.demand import Demand
from bench.directions.hemisphere import to_degrees
from bench.files.atomic import replacing
from bench.files.plots import default_settings
from bench.metrics.display import exposure_of, to_display

COVERAGE = 64  # most cells along each side of the map of visible texture
POINTS_A_CELL = 8  # visible points for each cell: evenly spread, they leave one of 3,000 cells empty
PERCENTILES = (1, 50, 99)
ALBEDO = 0.5  # of the white diffuser that frames are shown with


@dataclass(frozen=True)
class Summary:
    """A demand in a few numbers; percentiles are weighted by the queries' contribution to the pictures."""

    queries: int
    frames: tuple[int, int, int]
    theta_o_deg: tuple[float, ...]  # at `PERCENTILES`
    theta_i_deg: tuple[float, ...]
    footprint: tuple[float, ...]  # in longer sides of the texture
    finest: float  # the smallest footprint of all
    coverage: float  # visible share of a square texture

    def text(self) -> str:
        """The summary as lines of text."""
        low, middle, high = PERCENTILES
        count, height, width = self.frames

        def in_words(values: tuple[float, ...], unit: str) -> str:
            """The values at the percentiles, in words."""
            return " · ".join(f"{value:.3g}{unit}" for value in values)

        texels = f"{max(1, round(1 / self.finest)):,} texels along its longer side"
        lines = [
            f"{self.queries:,} queries of {count} frame{'s' if count > 1 else ''} of {width} × {height}",
            f"percentiles {low} · {middle} · {high}, weighted by what a white diffuser would send to the camera:",
            f"  view from the normal:   {in_words(self.theta_o_deg, '°')}",
            f"  light from the normal:  {in_words(self.theta_i_deg, '°')}",
            f"  footprint:              {in_words(self.footprint, '')} of the texture's longer side",
            f"finest footprint: {self.finest:.3g}: a texture of more than {texels} shows nothing more",
            f"seen of a square texture: {self.coverage:.0%}",
        ]
        return "\n".join(lines)


def summarise(demand: Demand) -> Summary:
    """The numbers of a demand."""
    share = demand.importance
    theta_o, _ = to_degrees(demand.wo)
    theta_i, _ = to_degrees(demand.wi)
    view, light = _percentiles(theta_o, share), _percentiles(theta_i, share)
    footprint = _percentiles(demand.footprint, share)
    seen = float((_coverage(demand) > 0).mean())
    return Summary(len(demand), demand.frames, view, light, footprint, float(demand.footprint.min()), seen)


def _percentiles(values: Array, share: Array) -> tuple[float, ...]:
    """The `PERCENTILES` of values (n,) that are weighted by shares (n,) with sum 1."""
    order = np.argsort(values)
    running = np.cumsum(share[order])
    # The first value with which the running share reaches each percentile; rounding may keep the sum below it.
    places = np.minimum(np.searchsorted(running, np.array(PERCENTILES) / 100), len(values) - 1)
    return tuple(float(value) for value in values[order][places])


def _coverage(demand: Demand) -> Array:
    """The share of the demand in each cell of a square texture, row 0 on top; a query counts in the cell that holds its
    centre. There are `COVERAGE` cells a side, or fewer if the sample is too small to fill them."""
    uv = demand.uv((1, 1))  # of any square texture
    col, row = uv[:, 0], 1 - uv[:, 1]
    # A pixel is a visible point, with a query for each light. Few points would leave cells empty that the scene shows.
    points = len(np.unique(demand.pixel))
    side = min(COVERAGE, max(1, math.isqrt(points // POINTS_A_CELL)))
    return np.histogram2d(row, col, side, [[0, 1], [0, 1]], weights=demand.importance)[0]


@default_settings()
def draw(demand: Demand, path: Path) -> None:
    """A PNG: a frame on a white diffuser, the views and lights, the visible part of the texture, and footprints."""
    figure = Figure(figsize=(14, 7), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplot_mosaic([["frame", "frame", "wo", "wi"], ["frame", "frame", "uv", "footprint"]])
    diffuse = demand.wi[:, 2:] * ALBEDO / np.pi  # (n, 1): a diffuser's f_r is albedo / π, times the cosine
    picture = demand.pictures(np.repeat(diffuse, 3, 1))[0]
    grid["frame"].imshow(to_display(picture, exposure_of(picture[None])))
    grid["frame"].set_title(f"{demand.name}: the first frame, on a white diffuser")
    grid["frame"].axis("off")
    for name, title in (("wo", "views"), ("wi", "lights")):
        _draw_directions(grid[name], getattr(demand, name), demand.importance, title)
    grid["uv"].imshow(_coverage(demand), extent=(0, 1, 0, 1), cmap="magma")
    grid["uv"].set(title="seen of a square texture", xlabel="u", ylabel="v")
    sizes = grid["footprint"]
    sizes.hist(np.log2(demand.footprint), bins=40, weights=demand.importance, color="tab:blue")
    sizes.set(title="footprints", xlabel="log2 of the texture's longer side", ylabel="share of the demand")
    with replacing(path) as partial:
        figure.savefig(partial, format="png", dpi=80)


def _draw_directions(axes, directions: Array, share: Array, title: str) -> None:  # type: ignore[no-untyped-def]
    """Draw the density of directions (n, 3) with shares (n,), in the plane of θ (radius, degrees) and φ.

    Each cell is divided by its solid angle.
    """
    theta, phi = to_degrees(directions)
    x = theta * np.cos(np.radians(phi))
    y = theta * np.sin(np.radians(phi))
    edges = np.linspace(-90, 90, 46)  # of cells of 4°
    density = np.histogram2d(y, x, [edges, edges], weights=share)[0]
    middle = (edges[1:] + edges[:-1]) / 2
    radius = np.hypot(*np.meshgrid(middle, middle))
    # All cells have one area in the plane, where a ring at θ is θ long; on the sphere it is sin θ long. Below 2°, which
    # is half a cell, the ratio hardly changes, but at 0 it is no number.
    density /= np.sin(np.radians(np.clip(radius, 2, 90))) / np.clip(radius, 2, None)
    density[radius > 90] = np.nan  # below the horizon: not drawn
    axes.imshow(np.sqrt(density), extent=(-90, 90, -90, 90), origin="lower", cmap="magma")
    for ring in (30, 60, 90):
        axes.add_patch(Circle((0, 0), ring, fill=False, color="grey", linewidth=0.5))
        axes.text(0, ring, f"{ring}°", color="grey", fontsize=7, ha="center")
    axes.set_title(f"{title} (root of density)")
    axes.axis("off")
