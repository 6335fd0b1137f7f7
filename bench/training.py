"""Fitting by random steps: part of the public interface, see `bench.codecs.training`."""

from bench.codecs.optimiser import Optimiser, groups_of
from bench.codecs.start import RANDOM_SPREAD, Start, components, first_latents
from bench.codecs.training import (
    Batch,
    DivergedError,
    Loss,
    Objective,
    Samples,
    display_psnr,
    distance,
    gain_of,
    rate,
    train,
)

__all__ = [
    "RANDOM_SPREAD",
    "Batch",
    "DivergedError",
    "Loss",
    "Objective",
    "Optimiser",
    "Samples",
    "Start",
    "components",
    "display_psnr",
    "distance",
    "first_latents",
    "gain_of",
    "groups_of",
    "rate",
    "train",
]
