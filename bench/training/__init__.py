"""The parts of learned codecs: networks, latents, fits, stored textures.

Codecs import from here; what few of them need, such as the inputs of two directions or a singular value decomposition,
from the files that docs/adding-a-codec.md lists.
"""

from bench.training.decoder import Architecture, Decoder, load_network, store_network
from bench.training.fitting import Batch, Loss, Objective, Samples, distance, gain_of, train
from bench.training.initial_latents import RANDOM_SPREAD, Start, first_latents
from bench.training.optimiser import Optimiser, groups_of
from bench.training.quantise import WeightPrecision
from bench.training.stored_texture import Bits, Rounding, load_texture, round_after, store_texture
from bench.training.texture_codes import compress, expand
from bench.training.texture_fit import DirectedObjective, FitSettings, TextureObjective, fitted
from bench.training.texture_material import TextureMaterial

__all__ = [
    "RANDOM_SPREAD",
    "Architecture",
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
    "WeightPrecision",
    "compress",
    "distance",
    "expand",
    "first_latents",
    "fitted",
    "gain_of",
    "groups_of",
    "load_network",
    "load_texture",
    "round_after",
    "store_network",
    "store_texture",
    "train",
]
