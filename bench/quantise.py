"""Stored precision of textures and weights: part of the public interface, see `bench.codecs.quantise`."""

from bench.codecs.quantise import (
    HALF_PEAKS,
    Precision,
    WeightPrecision,
    half_scale,
    pack,
    pack_bits,
    unpack,
    unpack_bits,
)

__all__ = ["HALF_PEAKS", "Precision", "WeightPrecision", "half_scale", "pack", "pack_bits", "unpack", "unpack_bits"]
