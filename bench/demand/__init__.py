"""Computes the demand of a scene: which texels it shows, at what size, from which directions, with which weight."""

from typing import TYPE_CHECKING

from bench.errors import InputError

if TYPE_CHECKING:
    from bench.codec import Codec

UNIFORM = 0.1  # share of the samples of a fit to a scene, or of the weights of its pairs, that is spread uniformly


def require_demand(codec: "Codec", demand: object) -> None:
    """Raise an `InputError` where a codec is to be fitted to a scene, and there is no demand of one."""
    if codec.scene and not demand:
        raise InputError(
            f"codec {codec.name}: scene = true needs the demand of a scene: give `run` or `encode` one with --demand"
        )
