"""Common parts of a neural texture and a network: the settings of their fit, a step, the file, and the material.

The network turns latents and two directions into log radiance.
"""

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Any, ClassVar, TypeVar

import torch
from torch import Tensor, nn

from bench.btf import BTF
from bench.codec import Fit, Parts
from bench.inputs.settings import BatchSize, Natural, Positive
from bench.material import DecoderCost, Material, to_radiance
from bench.training.decoder import Decoder
from bench.training.fitting import Loss, Objective, better_start, phase_by_halves, train
from bench.training.initial_latents import Start
from bench.training.inputs import Directions, direction_inputs
from bench.training.optimiser import Optimiser, ParameterGroup, groups_of
from bench.training.samples import Samples, gain_of
from bench.training.stored_network import WeightPrecision, store_network


@dataclass(frozen=True)
class NetworkSettings:
    """The settings of every fit of a network, and of its part of a file."""

    steps: Natural = 2_500  # steps of the fit
    optimiser: Optimiser = "muon"  # of the network's hidden matrices; Adam takes all others
    hidden_rate: Positive = 2e-2  # highest learning rate of Muon
    rate: Positive = 1e-2  # highest learning rate of the network
    weights: WeightPrecision = "half"  # precision of the stored network; eight bits are rounded in the fit, too


@dataclass(frozen=True)
class TextureSettings(NetworkSettings):
    """Further settings of a fit of a neural texture with its network."""

    batch: BatchSize = 4_096  # samples a step
    start: Start = "mixed"  # of the neural texture: components of the log ABRDFs, random, or both


@dataclass(frozen=True)
class FitSettings(TextureSettings):
    """Further settings of a fit in which every latent is free."""

    patience: Natural = 0  # steps without a gain of 0.02 dB on its probe that end the fit; 0: never
    latent_rate: Positive = 1e-2  # highest learning rate of the neural texture
    loss: Loss = "both"  # error of log radiance: absolute, squared, or their sum; or later errors as displayed


class TextureObjective(Objective):
    """A texture and a network, `network`, both fitted. All parameters outside the network belong to the texture."""

    network: nn.Module
    texture_rate: ClassVar[str] = "latent_rate"  # the setting that is the texture's highest learning rate

    def phase(self, progress: float) -> Hashable | None:
        """The half of the fit. A codec whose steps depend otherwise on `progress`, or on the host, overrides this."""
        return phase_by_halves(progress)

    def stored_networks(self) -> list[nn.Module]:
        """The network: the file holds no other."""
        return [self.network]

    def groups(self) -> list[ParameterGroup]:
        """The network's groups, then one of the texture, at the rate that the setting `texture_rate` names."""
        settings = self.settings
        network = groups_of([self.network], settings.rate, settings.optimiser, settings.hidden_rate)
        of_network = {id(p) for p in self.network.parameters()}
        texture = [p for p in self.parameters() if id(p) not in of_network]
        return [*network, {"params": texture, "lr": getattr(settings, self.texture_rate)}]

    def parts(self, texture: dict[str, Tensor], **other: Tensor) -> Parts:
        """The tensors of a file: the network's weights, those of a texture, and the gain beside `other` ones."""
        weights = store_network(self.network, self.settings.weights)
        return Parts(decoder=weights, texture=texture, other={"gain": torch.tensor([self.samples.gain]), **other})


Fitted = TypeVar("Fitted", bound=Objective)


def fitted(objective: Callable[[Samples, Any, torch.Generator], Fitted], settings: Any, btf: BTF, fit: Fit) -> Fitted:
    """Fit an objective to a whole BTF, and return it; `objective` makes it of samples, `settings` and a generator."""
    samples = Samples(btf, gain_of(btf, fit), fit)

    def made(start: Fit) -> Fitted:
        """The objective as it is before the first step."""
        return objective(samples, settings, start.generator())

    if getattr(settings, "offset", 0):  # of a codec on several grids
        fit = better_start(made, fit, settings.steps)
    to_fit = made(fit)
    train(to_fit, fit, settings.steps, settings.patience)
    return to_fit


class DirectedObjective(TextureObjective):
    """A `TextureObjective` whose network is a `Decoder` of `settings.architecture`. Its inputs are a texel's numbers,
    then those of the two directions, of the kind `settings.directions`.

    The network starts at the mean of the data for any inputs; with `about` its last weights are random, so it starts
    near the mean. Its weights are the first numbers that are drawn from the generator.
    """

    def __init__(self, samples: Samples, settings: Any, generator: torch.Generator, about: bool = False):
        """Make the network, start it at the mean, and keep the inputs of all directions."""
        super().__init__(samples, settings)
        self.network: Decoder = Decoder(settings.architecture, generator)
        self.network.start_at(samples.mean(generator), everywhere=not about)
        inputs = torch.cat(direction_inputs(samples.wo, samples.wi, settings.directions), 1)
        self.directions = nn.Buffer(inputs, persistent=False)  # (pairs, inputs of both directions)

    def answers(self, numbers: Tensor, pair: Tensor) -> Tensor:
        """Log radiance (n, 3) of texels' numbers (n, D) at pairs (n,)."""
        return self.network(torch.cat([numbers, self.directions.index_select(0, pair)], 1))


class TextureMaterial(Material):
    """A texture (H, W, D) of latents, fetched bilinearly, and a network: latents, directions → log radiance (n, 3)."""

    def __init__(self, network: Decoder, texture: Tensor, gain: float, directions: Directions):
        """Count the cost of an answer, and keep the parts."""
        architecture = network.architecture
        cost = DecoderCost.of_texture(texture, architecture.parameters, architecture.flops)
        super().__init__((texture.shape[0], texture.shape[1]), cost)
        self.network = network
        self.texture = texture
        self.gain = gain
        self.directions = directions

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        """Linear radiance (n, 3) of queries; see `Material`. The footprint is ignored: there is one level of detail."""
        view, light = direction_inputs(wo, wi, self.directions)
        return to_radiance(self.network.at(self.texture, uv, view, light), self.gain)
