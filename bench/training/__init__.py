"""The parts of learned codecs: networks, inputs, latents, fits, stored precision. Codecs import only from here."""

from bench.training.decoder import LEAK, Activation, Architecture, Decoder, Network, load_vector, to_vector
from bench.training.fitting import (
    ROUNDING_SAMPLES,
    Batch,
    DivergedError,
    Loss,
    Objective,
    Samples,
    display_psnr,
    distance,
    gain_of,
    train,
)
from bench.training.frames import Frames
from bench.training.initial_latents import RANDOM_SPREAD, Start, components, first_latents
from bench.training.inputs import COUNTS, Directions, direction_inputs
from bench.training.optimiser import Optimiser, groups_of, rate
from bench.training.quantise import (
    HALF_PEAKS,
    WeightPrecision,
    half_scale,
    pack,
    pack_bits,
    unpack,
    unpack_bits,
)
from bench.training.reading import blocks
from bench.training.stored_texture import (
    Bits,
    Rounding,
    choose_bits,
    expand_texture,
    load_texture,
    round_after,
    store_alike,
    store_texture,
)
from bench.training.svd import Factors, strongest, truncated_svd
from bench.training.texture_codes import compress, expand
from bench.training.texture_fit import DirectedObjective, FitSettings, TextureObjective
from bench.training.texture_material import TextureMaterial

__all__ = [
    "COUNTS",
    "HALF_PEAKS",
    "LEAK",
    "RANDOM_SPREAD",
    "ROUNDING_SAMPLES",
    "Activation",
    "Architecture",
    "Batch",
    "Bits",
    "Decoder",
    "DirectedObjective",
    "Directions",
    "DivergedError",
    "Factors",
    "FitSettings",
    "Frames",
    "Loss",
    "Network",
    "Objective",
    "Optimiser",
    "Rounding",
    "Samples",
    "Start",
    "TextureMaterial",
    "TextureObjective",
    "WeightPrecision",
    "blocks",
    "choose_bits",
    "components",
    "compress",
    "direction_inputs",
    "display_psnr",
    "distance",
    "expand",
    "expand_texture",
    "first_latents",
    "gain_of",
    "groups_of",
    "half_scale",
    "load_texture",
    "load_vector",
    "pack",
    "pack_bits",
    "rate",
    "round_after",
    "store_alike",
    "store_texture",
    "strongest",
    "to_vector",
    "train",
    "truncated_svd",
    "unpack",
    "unpack_bits",
]
