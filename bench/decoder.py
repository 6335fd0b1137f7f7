"""The small network of every learned codec: part of the public interface, see `bench.codecs.decoder`."""

from bench.codecs.decoder import LEAK, Activation, Architecture, Decoder, Network, load_vector, to_vector
from bench.codecs.frames import Frames
from bench.codecs.inputs import COUNTS, Directions, direction_inputs
from bench.codecs.texture_material import TextureMaterial

__all__ = [
    "COUNTS",
    "LEAK",
    "Activation",
    "Architecture",
    "Decoder",
    "Directions",
    "Frames",
    "Network",
    "TextureMaterial",
    "direction_inputs",
    "load_vector",
    "to_vector",
]
