"""Figures of a run, one kind a file. Each kind is a function from a run to `Figure`s, listed in `ALL`."""

from collections.abc import Callable, Iterator

from bench.records import Run
from reports.figures.abrdf import abrdf_maps
from reports.figures.angles import angle_curves
from reports.figures.canvas import Figure as Figure
from reports.figures.contact import contact_sheets
from reports.figures.fits import fit_curves
from reports.figures.footprints import footprint_plots
from reports.figures.latents import latent_channels
from reports.figures.polar import polar_maps
from reports.figures.scatter import rate_distortion, speed_accuracy
from reports.figures.significance import significance
from reports.figures.trade import trade_fronts

ALL: tuple[Callable[[Run], Iterator[Figure]], ...] = (
    significance,
    contact_sheets,
    rate_distortion,
    speed_accuracy,
    trade_fronts,
    fit_curves,
    footprint_plots,
    angle_curves,
    polar_maps,
    abrdf_maps,
    latent_channels,
)
# What the names of their files begin with.
KINDS = (
    "abrdf",
    "angles",
    "contact",
    "fits",
    "footprints",
    "latents",
    "polar",
    "rate",
    "significance",
    "speed",
    "trade",
)
