"""The parts of learned codecs: latents, fits, stored textures.

Codecs import them from here, and what few codecs need from the files that docs/adding-a-codec.md lists.
"""

from bench.training.decoder import Decoder
from bench.training.fitting import LogLoss, Loss, Objective, better_start, distance, phase_by_halves, train
from bench.training.initial_latents import RANDOM_SPREAD, Start, first_latents
from bench.training.optimiser import Optimiser, ParameterGroup, groups_of
from bench.training.replay import FromHost, on_host
from bench.training.samples import Batch, Samples, gain_of
from bench.training.stored_texture import (
    Bits,
    Rounding,
    load_table,
    load_texture,
    round_after,
    store_table,
    store_texture,
)
from bench.training.texture_codes import MOST_CODES, compress, expand
from bench.training.texture_fit import (
    DirectedObjective,
    FitSettings,
    NetworkSettings,
    TextureMaterial,
    TextureObjective,
    TextureSettings,
    fitted,
)
