"""Principal components of matrices too large for memory: part of the public interface, see `bench.codecs.svd`."""

from bench.codecs.svd import Factors, truncated_svd

__all__ = ["Factors", "truncated_svd"]
