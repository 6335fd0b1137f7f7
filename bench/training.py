"""Fitting by random steps: part of the public interface, see `bench.codecs.training`."""

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
    "Batch",
    "DivergedError",
    "Loss",
    "Objective",
    "Samples",
    "display_psnr",
    "distance",
    "gain_of",
    "rate",
    "train",
]
