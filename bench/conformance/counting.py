"""Counts what a decoded material really holds, to hold against what its codec declares."""

from bench.material import Material


def parameters(material: Material) -> int:
    """Trainable parameters of the decoder networks, counted by torchinfo; 0 where there is no network."""
    from torchinfo import summary

    return sum(summary(module, verbose=0).trainable_params for module in material.modules())
