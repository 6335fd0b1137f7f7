"""NeuBTF's neural texture and renderer fitted to the data directly, without the autoencoder.

The decoder is the paper's, and the file as well; what is lost is the guidance image, and with it every new texture.
"""

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from bench.btf import BTF
from bench.codec import Codec, Fit, Parts
from bench.decoder import Decoder
from bench.material import Material
from bench.settings import Count, Natural, Positive
from bench.training import Batch, Loss, Objective, Samples, distance, gain_of, train
from neubtf.renderer import RendererSettings, load, render, store

LATENT_SPREAD = 0.1  # standard deviation of the first latents


class NeuBTFDirect(Codec):
    """NeuBTF's texture and renderer, fitted without the autoencoder: sooner done, cannot be re-textured."""

    name, version = "neubtf-direct", 1
    sizes = ("latents", "width")

    @dataclass(frozen=True)
    class Settings(RendererSettings):
        steps: Natural = 10_000  # of the fit
        batch: Count = 4_096  # samples a step
        rate: Positive = 1e-2  # highest learning rate of the renderer
        latent_rate: Positive = 1e-2  # highest learning rate of the neural texture
        loss: Loss = "both"  # on log radiance: absolute, squared, or their sum

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        gain = gain_of(btf, fit)
        direct = Direct(Samples(btf, gain, fit), self.settings, fit.generator())
        train(direct, fit, self.settings.steps)
        return store(direct.renderer, direct.texture.reshape(*btf.shape, -1), gain, self.settings)

    def decode(self, parts: Parts, device: torch.device) -> Material:
        return load(parts, self.settings).to(device)


class Direct(Objective):
    """The neural texture (H · W, D) and the renderer, both free."""

    def __init__(self, samples: Samples, settings: NeuBTFDirect.Settings, generator: torch.Generator):
        super().__init__(samples)
        self.settings = settings
        self.renderer = Decoder(settings.architecture, generator)
        self.renderer.start_at(samples.mean(generator))
        first = torch.randn(samples.texels, settings.latents, generator=generator)
        self.texture = nn.Parameter(LATENT_SPREAD * first)

    def groups(self) -> list[dict[str, Any]]:
        return [
            {"params": list(self.renderer.parameters()), "lr": self.settings.rate},
            {"params": [self.texture], "lr": self.settings.latent_rate},
        ]

    def predict(self, batch: Batch, progress: float) -> Tensor:
        latents = self.texture.index_select(0, batch.texel)
        return render(self.renderer, latents, self.samples.wo[batch.pair], self.samples.wi[batch.pair])

    def loss(self, generator: torch.Generator, progress: float) -> Tensor:
        batch = self.samples.draw(self.settings.batch, generator)
        return distance(self.predict(batch, progress), batch.target, self.settings.loss)
