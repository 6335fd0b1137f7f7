"""The material of a `relief` file: marches the view ray to the surface, fetches the latents there, and shades.

The network is NeuBTF's renderer, three hidden layers with layer norm and sine, with more inputs: ω_o, ω_i and the half
vector h in xyz; the same in two shading frames (Zeltner et al., "Real-time neural appearance models", ACM Trans. Graph.
43(3), 2024); and how far the relief rises into the ray to the light.
"""

from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from baselines.pyramids import Pyramid, Queries
from baselines.relief.geometry import LIGHT_STEPS, SECANTS, VIEW_STEPS, Surface
from bench.material import DecoderCost, Material, to_radiance
from bench.training.decoder import Architecture, Decoder
from bench.training.frames import Frames

FRAMES = 2
DEEPEST = 3.0  # level of detail of footprints of 8 texels, which the network sees as 1
SHADOW = 0.5  # texels: about half of the penumbra that a texel's width makes


class Network(nn.Module):
    """Latents (n, D) and directions (n, 3) → log radiance (n, 3); with `relief` it also sees the light's horizon."""

    def __init__(self, settings: Any, relief: bool, generator: torch.Generator | None = None):
        super().__init__()
        self.shadow: bool = relief and settings.shadow
        inputs = settings.latents + 1 + 9 * (1 + FRAMES * settings.frames) + self.shadow
        widths = (settings.width,) * settings.layers
        outputs = 6 if self.shadow else 3
        architecture = Architecture(inputs, widths, outputs, "sine", settings.omega, norm=True, residual=True)
        self.decoder = Decoder(architecture, generator)
        self.frames = Frames(settings.latents, FRAMES, generator) if settings.frames else None

    @property
    def flops(self) -> int:
        """Operations of one sample, a fused multiply-add counted as two."""
        return self.decoder.architecture.flops + (self.frames.flops(3) if self.frames is not None else 0)

    def start_at(self, level: Tensor) -> None:
        """Set the network to answer one log radiance (3,) for any inputs, with the mask open."""
        rest = self.decoder.architecture.outputs - 3
        self.decoder.start_at(functional.pad(level.cpu(), (0, rest), value=2.0))

    def forward(self, latents: Tensor, level: Tensor, wo: Tensor, wi: Tensor, excess: Tensor | None) -> Tensor:
        """Log radiance (n, 3); `level` (n, 1) is that of detail, `excess` (n, 1) in texels, if there is a relief."""
        directions = torch.stack([wo, wi, functional.normalize(wo + wi, dim=1)], 1)
        inputs = [latents, level.to(latents.dtype) / DEEPEST, directions.flatten(1).to(latents.dtype)]
        if self.frames is not None:
            inputs.append(self.frames.turned(latents, directions).to(latents.dtype))
        if excess is not None:
            inputs.append((excess * SHADOW).tanh().to(latents.dtype))
        out = self.decoder(torch.cat(inputs, 1)).to(wo.dtype)
        if excess is None:
            return out
        # log1p(mask · radiance): a mask removes light, but a log radiance would rarely go below 0.
        radiance = out[:, :3].clamp(max=60).expm1()
        return (radiance * out[:, 3:].sigmoid()).clamp_min(-0.5).log1p()


def answer(
    network: Network,
    pyramid: Pyramid,
    relief: Surface | None,
    table: Tensor,
    queries: Queries,
    height: Tensor | None = None,
) -> Tensor:
    """Log radiance (n, 3) of queries; `height` (H, W) is that of the relief, in a fit that refines it."""
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
        cost = DecoderCost(
            parameters=sum(p.numel() for p in network.parameters()),
            texture_channels=latents.shape[1] + (relief is not None),
            texture_floats=table.numel() + heights,
            flops_per_sample=network.flops + 2 * 8 * latents.shape[1] + 8 * taps,
            bytes_per_sample=8 * latents.shape[1] * latents.element_size() + 4 * taps,
        )
        super().__init__(size, cost)
        # The relief is separate from the network: it holds places, which stay float32 even if the network is shorter.
        self.network, self.pyramid, self.relief, self.table, self.gain = network, pyramid, relief, table, gain

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        queries = (uv, wo, wi, self.pyramid.level(footprint))
        return to_radiance(answer(self.network, self.pyramid, self.relief, self.table, queries), self.gain)
