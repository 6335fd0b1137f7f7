"""Figures of a run. Each kind is a function from a run to `Figure`s, listed in `ALL`.

A kind makes no figure where the run lacks what it shows.
"""

from collections.abc import Callable, Iterator
from functools import partial

from bench.records import Run
from reports.figures.canvas import Figure as Figure
from reports.figures.contact import contact_sheets
from reports.figures.errors import abrdf_maps, angle_curves, polar_maps
from reports.figures.fronts import fronts, plot_figures
from reports.figures.latents import latent_channels
from reports.figures.significance import critical_differences, significance

# By kind; the names of their files begin with it. The four kinds of `plot_figures` are plots that the page draws, too.
ALL: dict[str, Callable[[Run], Iterator[Figure]]] = {
    "significance": significance,
    "ranks": critical_differences,
    "fronts": fronts,
    "contact": contact_sheets,
    **{kind: partial(plot_figures, kind=kind) for kind in ("rate", "speed", "fits", "footprints")},
    "angles": angle_curves,
    "polar": polar_maps,
    "abrdf": abrdf_maps,
    "latents": latent_channels,
}
