"""The network: latents, directions, learned frames and the light's visibility → log radiance.

It is NeuBTF's renderer, three hidden layers with layer norm and sine, with more inputs: ω_o, ω_i and the half vector h
in xyz; the same in two shading frames, whose normal and tangent are linear in the latents (Zeltner et al., "Real-time
neural appearance models", ACM Trans. Graph. 43(3), 2024); and how far the relief rises into the ray to the light.
"""

from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

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
    def count(self) -> int:
        """Trainable numbers: of the decoder, and 12 (D + 1) of the frames."""
        return sum(p.numel() for p in self.parameters())

    @property
    def flops(self) -> int:
        """Operations of one sample, a fused multiply-add counted as two."""
        return self.decoder.architecture.flops + (self.frames.flops(3) if self.frames is not None else 0)

    def start_at(self, level: Tensor) -> None:
        """Set the network to answer one log radiance (3,) for any inputs, with the mask open."""
        outputs = torch.zeros(self.decoder.architecture.outputs)
        outputs[:3] = level.cpu()
        outputs[3:] = 2.0
        self.decoder.start_at(outputs)

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
