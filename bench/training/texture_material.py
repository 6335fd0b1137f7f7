"""The material of a neural texture and one network, whose inputs are latents and two directions."""

from torch import Tensor

from bench.material import DecoderCost, Material, to_radiance
from bench.training.decoder import Decoder
from bench.training.inputs import Directions, direction_inputs


class TextureMaterial(Material):
    """A texture (H, W, D) of latents, fetched bilinearly, and a network: latents, directions → log radiance (n, 3).

    `gain` is that of the log radiance, see `to_radiance`. The footprint is ignored.
    """

    def __init__(self, network: Decoder, texture: Tensor, gain: float, directions: Directions):
        architecture = network.architecture
        cost = DecoderCost.of_texture(texture, architecture.parameters, architecture.flops)
        super().__init__((texture.shape[0], texture.shape[1]), cost)
        self.network, self.texture, self.gain, self.directions = network, texture, gain, directions

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        return to_radiance(self.network.at(self.texture, uv, *direction_inputs(wo, wi, self.directions)), self.gain)
