"""NeuBTF's neural texture and renderer fitted to the data directly, without the autoencoder.

Decoder and file are the paper's. Without the guidance image no new textures can be made.
"""

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import torch
from torch import Tensor, nn

from bench.btf import BTF
from bench.codec import Codec, Fit, Parts
from bench.decoder import Decoder, direction_inputs
from bench.material import Material
from bench.settings import BatchSize, Natural, Positive
from bench.training import (
    Batch,
    Loss,
    Objective,
    Optimiser,
    Samples,
    Start,
    distance,
    first_latents,
    gain_of,
    groups_of,
    train,
)
from neubtf.renderer import RendererSettings, load, store


class NeuBTFDirect(Codec):
    """NeuBTF's texture and renderer, fitted without the autoencoder: faster to fit, cannot be re-textured."""

    name, version = "neubtf-direct", 2
    sizes = ("latents", "width")
    recipes: ClassVar = {"paper": {"directions": "xy", "start": "random", "optimiser": "adam", "steps": 10_000}}

    @dataclass(frozen=True)
    class Settings(RendererSettings):
        recipe: Literal["ours", "paper"] = "ours"  # "paper": its inputs, random latents, Adam alone
        steps: Natural = 2_500  # of the fit
        batch: BatchSize = 4_096  # samples a step
        patience: Natural = 0  # steps without a gain of 0.02 dB on its probe that end the fit; 0: takes all its steps
        start: Start = "components"  # of the neural texture: principal components of the log ABRDFs, or random
        optimiser: Optimiser = "muon"  # of the renderer's hidden matrices; all else is Adam's
        hidden_rate: Positive = 2e-2  # highest learning rate of Muon
        rate: Positive = 1e-2  # highest learning rate of the renderer
        latent_rate: Positive = 1e-2  # highest learning rate of the neural texture
        loss: Loss = "both"  # on log radiance: absolute, squared, or their sum

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        gain = gain_of(btf, fit)
        direct = Direct(Samples(btf, gain, fit), self.settings, fit.generator())
        train(direct, fit, self.settings.steps, self.settings.patience)
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
        self.texture = nn.Parameter(first_latents(samples, settings.latents, settings.start, generator))
        self.directions: Tensor
        seen = torch.cat(direction_inputs(samples.wo, samples.wi, settings.directions), 1)
        self.register_buffer("directions", seen, persistent=False)

    def groups(self) -> list[dict[str, Any]]:
        settings = self.settings
        renderer = groups_of([self.renderer], settings.rate, settings.optimiser, settings.hidden_rate)
        return [*renderer, {"params": [self.texture], "lr": settings.latent_rate}]

    def predict(self, batch: Batch, progress: float) -> Tensor:
        latents, seen = self.texture.index_select(0, batch.texel), self.directions.index_select(0, batch.pair)
        answer: Tensor = self.renderer(torch.cat([latents, seen], 1))
        return answer

    def loss(self, generator: torch.Generator, progress: float) -> Tensor:
        batch = self.samples.draw(self.settings.batch, generator)
        return distance(self.predict(batch, progress), batch.target, self.settings.loss)
