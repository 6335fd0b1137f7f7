"""Fitting, by random steps and by principal components: part of the public interface; see `bench.codecs.training`."""

from bench.codecs.blocks import blocks
from bench.codecs.optimiser import Optimiser, groups_of
from bench.codecs.start import RANDOM_SPREAD, Start, components, first_latents
from bench.codecs.svd import Factors, strongest, truncated_svd
from bench.codecs.texture_fit import DirectedObjective, FitSettings, TextureObjective
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
    "DirectedObjective",
    "DivergedError",
    "Factors",
    "FitSettings",
    "Loss",
    "Objective",
    "Optimiser",
    "Samples",
    "Start",
    "TextureObjective",
    "blocks",
    "components",
    "display_psnr",
    "distance",
    "first_latents",
    "gain_of",
    "groups_of",
    "rate",
    "strongest",
    "train",
    "truncated_svd",
]
