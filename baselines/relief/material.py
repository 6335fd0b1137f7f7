"""The material of a `relief` file: marches the view ray to the surface, fetches the latents there, and shades."""

import torch
from torch import Tensor

from baselines.pyramids import Pyramid
from baselines.relief.geometry import LIGHT_STEPS, SECANTS, VIEW_STEPS, Surface
from baselines.relief.network import Network
from bench.material import DecoderCost, Material, to_radiance

Queries = tuple[Tensor, Tensor, Tensor, Tensor]  # uv (n, 2) in [0, 1], wo and wi (n, 3), level of detail (n,)


def answer(
    network: Network,
    pyramid: Pyramid,
    relief: Surface | None,
    table: Tensor,
    queries: Queries,
    height: Tensor | None = None,
) -> Tensor:
    """Log radiance (n, 3) of queries, for the fit and the decoded material.

    In a fit that refines the relief, `height` (H, W) is its height.
    """
    uv, wo, wi, level = queries
    excess = None
    if relief is not None:
        with torch.no_grad():
            uv, z = relief.meet(uv, wo)
            if network.shadow:
                excess = relief.excess(uv, z, wi)
        if height is not None:
            uv = relief.follow(height, uv, wo)
    log_radiance: Tensor = network(pyramid.fetch(table, uv, level), level[:, None], wo, wi, excess)
    return log_radiance


class ReliefMaterial(Material):
    """Latents (H · W, D) of the finest level, a height or none, and the network."""

    def __init__(self, network: Network, size: tuple[int, int], latents: Tensor, relief: Surface | None, gain: float):
        taps = 0 if relief is None else VIEW_STEPS + 1 + 4 * SECANTS + (LIGHT_STEPS if network.shadow else 0)
        pyramid = Pyramid(size)
        table = pyramid.table(latents)
        heights = 0 if relief is None else relief.height.numel() + relief.padded.numel()
        super().__init__(
            size,
            DecoderCost(
                parameters=network.count,
                texture_channels=latents.shape[1] + (relief is not None),
                texture_floats=table.numel() + heights,
                flops_per_sample=network.flops + 2 * 8 * latents.shape[1] + 8 * taps,
                bytes_per_sample=8 * latents.shape[1] * latents.element_size() + 4 * taps,
            ),
        )
        # The relief is separate from the network: it holds places, which stay float32 even if the network is shorter.
        self.network, self.pyramid, self.relief, self.gain = network, pyramid, relief, gain
        self.table = table

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        queries = (uv, wo, wi, self.pyramid.level(footprint))
        return to_radiance(answer(self.network, self.pyramid, self.relief, self.table, queries), self.gain)
