"""Computes the demand of a scene: the texels that it shows, with their footprints, directions and weights.

A codec fitted to a demand spends its bytes on what the scene's pictures show.
"""

from typing import TYPE_CHECKING

from bench.inputs.errors import InputError

if TYPE_CHECKING:
    from bench.codec import Codec

UNIFORM = 0.1  # share of the samples of a fit to a scene, or of the weights of its pairs, that is spread uniformly


def require_demand(codec: "Codec", demand: object) -> None:
    """Raise `InputError` if a codec shall be fitted to a scene, but no demand is given."""
    if codec.scene and not demand:
        fault = "scene = true needs the demand of a scene"
        raise InputError(f"codec {codec.name}: {fault}: give it to `run` or `encode` with --scene")
