"""The small network of every learned codec: part of the public interface, see `bench.codecs.decoder`."""

from bench.codecs.decoder import LEAK, Activation, Architecture, Decoder, Network, load_vector, to_vector

__all__ = ["LEAK", "Activation", "Architecture", "Decoder", "Network", "load_vector", "to_vector"]
