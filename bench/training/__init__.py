"""The parts of learned codecs: latents, fits, stored textures.

Codecs import them from here; networks, numbers as halves and what few codecs need, from the files that
docs/adding-a-codec.md lists.
"""

from bench.training.decoder import Decoder
from bench.training.fitting import Batch, Loss, Objective, Samples, distance, gain_of, train
from bench.training.initial_latents import RANDOM_SPREAD, Start, first_latents
from bench.training.optimiser import Optimiser, groups_of
from bench.training.stored_texture import Bits, Rounding, load_texture, round_after, store_texture
from bench.training.texture_codes import compress, expand
from bench.training.texture_fit import DirectedObjective, FitSettings, TextureObjective, fitted
from bench.training.texture_material import TextureMaterial

__all__ = [
    "RANDOM_SPREAD",
    "Batch",
    "Bits",
    "Decoder",
    "DirectedObjective",
    "FitSettings",
    "Loss",
    "Objective",
    "Optimiser",
    "Rounding",
    "Samples",
    "Start",
    "TextureMaterial",
    "TextureObjective",
    "compress",
    "distance",
    "expand",
    "first_latents",
    "fitted",
    "gain_of",
    "groups_of",
    "load_texture",
    "round_after",
    "store_texture",
    "train",
]
