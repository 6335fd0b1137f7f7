"""Zeltner et al., "Real-time neural appearance models" (ACM Trans. Graph. 43(3), 2024).

Eight latents a texel make two shading frames, into which both directions are turned; latents and turned directions
enter a network of two hidden layers. `edition` chooses between the article and the authors' code of 2026. BTFs have no
parameters of a layered material for the authors' encoder, so the texture is free, as in their second stage. See
docs/recipes.md for other open details. Further grids and an offset along the view are no part of the article.

A *frame* is a normal and a tangent of length 1, and the axis across both; a direction *turned* into it is given by its
x, y and z on these axes. From half of the fit on, latents are looked up *rounded*, as the file stores them.
"""

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import torch
from torch import Tensor, nn
from torch.nn import functional

from baselines.planes import half_and_difference
from bench.btf import BTF
from bench.codec import Codec, Fit, Parts
from bench.inputs.errors import InputError
from bench.inputs.settings import Layers, Range, Width
from bench.material import HIGHEST_LEVEL, Material, at_least_float32, to_radiance
from bench.training import Batch, FitSettings, Samples, TextureObjective, distance, fitted
from bench.training.decoder import Activation, Architecture, Decoder
from bench.training.gridded import GriddedMaterial, GriddedNetwork, first_grids, gridded_parts, load_gridded
from bench.training.grids import GridSettings, total_channels
from bench.training.inputs import Frames
from bench.training.stored_network import load_network
from bench.training.stored_texture import Bits

BRIGHTEST = 1e5  # gain · radiance that the sigmoid of the authors' code can answer
PAPER = {"edition": "code", "halfway": False, "layers": 2, "width": 16, "activation": "smelu", "bits": 8}
PAPER |= {"start": "random", "optimiser": "adam", "rate": 1e-3, "latent_rate": 1e-3, "loss": "l1", "steps": 10_000}


class Zeltner2024(Codec):
    """Zeltner 2024: eight latents, directions turned into two learned shading frames, a small network.

    Code: https://github.com/NVlabs/neuralappearance

    @article{zeltner2024realtime,
      author = {Zeltner, Tizian and Rousselle, Fabrice and Weidlich, Andrea and Clarberg, Petrik and Novák, Jan and
        Bitterli, Benedikt and Evans, Alex and Davidovič, Tomáš and Kallweit, Simon and Lefohn, Aaron},
      title = {Real-Time Neural Appearance Models},
      journal = {ACM Transactions on Graphics},
      volume = {43},
      number = {3},
      articleno = {33},
      year = {2024},
      doi = {10.1145/3659577}
    }
    """

    name, version = "zeltner2024", 2
    sizes = ("latents", "width")
    recipes: ClassVar = {"paper": PAPER}

    @dataclass(frozen=True)
    class Settings(FitSettings, GridSettings):
        recipe: Literal["ours", "paper"] = "ours"  # "paper": as in the authors' code of 2026, random latents, Adam
        edition: Literal["article", "code"] = "article"  # "code": its latents, inputs, output and space of the loss
        latents: Width = 8  # channels of the neural texture
        frames: Annotated[int, Range(0, 64)] = 2  # learned shading frames; 0: the network sees unturned directions
        halfway: bool = True  # also turn the half vector; `edition=code` always does
        layers: Layers = 2  # hidden layers of the network
        width: Width = 32  # channels of each hidden layer
        activation: Activation = "leaky-relu"  # activation of the hidden layers
        bits: Bits = 0  # bits of a stored latent on average; 0: chosen by the fit; 16, 32: floats

        def __post_init__(self) -> None:
            """`InputError` if `edition=code`, whose loss is not of log radiance, is asked for a loss as displayed."""
            if self.edition == "code" and self.loss == "display":
                raise InputError("codec zeltner2024: edition=code has a loss of its own: leave out loss=display")

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        """Fit texture, frames and network to the training pairs; returns the parts of the file."""
        fitting = fitted(Zeltner2024Objective, self.settings, btf, fit)
        return gridded_parts(fitting, fitting.grids)

    def decode(self, parts: Parts, device: torch.device) -> Material:
        """The material of a file's parts, on a device. `ValueError` if texture and network do not fit."""
        grids = load_gridded(parts, self.settings)
        network = GriddedNetwork(FramedNetwork(self.settings), self.settings, grids["latents"].shape[:2])
        gain = float(parts.other["gain"])
        return Zeltner2024Material(load_network(network, parts.decoder), grids, gain).to(device)


def sigmoid(outputs: Tensor) -> Tensor:
    """gain · radiance of the outputs x of a network with `edition=code`, any shape, at least in float32.

    It is s eˣ / (eˣ + s), s = `BRIGHTEST`: nearly eˣ where radiance is far below s, and never above it.
    """
    exponential = outputs.to(at_least_float32(outputs.dtype)).clamp(max=HIGHEST_LEVEL).exp()
    return exponential / (1 + exponential / BRIGHTEST)


class FramedNetwork(nn.Module):
    """Latents (n, D) and directions (n, 3) → outputs (n, 3): log radiance, or with `edition=code` what `sigmoid`
    takes."""

    def __init__(self, settings: Zeltner2024.Settings, generator: torch.Generator | None = None):
        """Make the frames, then the network, with weights drawn from the generator."""
        super().__init__()
        self.authors_code = settings.edition == "code"  # whether it is the authors' code, not the article
        if self.authors_code:
            self.direction_count = 4  # half vector, difference vector, wi and wo
            numbers_of_frame = 3 + 3 + 1 + 1  # of wi and wo only the cosine
        else:
            self.direction_count = 3 if settings.halfway else 2  # wo, wi, and the half vector
            numbers_of_frame = 3 * self.direction_count
        self.direction_input_count = numbers_of_frame * max(1, settings.frames)  # without frames the surface's own axes
        latents = total_channels(settings)
        inputs = latents + self.direction_input_count
        architecture = Architecture(inputs, (settings.width,) * settings.layers, activation=settings.activation)
        self.frames: Frames | None = None
        if settings.frames:  # the authors' frames have no bias; outputs are added to the surface's own axes
            self.frames = Frames(latents, settings.frames, generator)
        self.decoder = Decoder(architecture, generator)

    def forward(self, latents: Tensor, wo: Tensor, wi: Tensor) -> Tensor:
        """The network's outputs (n, 3) for latents (n, D) and directions (n, 3)."""
        if self.authors_code:
            half, difference = half_and_difference(wo, wi, "nearest")
            directions = torch.stack([half, difference, wi, wo], 1)  # (n, 4, 3)
        else:
            half = functional.normalize(wo + wi, dim=1)
            # (n, 3, 3), or without `halfway` (n, 2, 3).
            directions = torch.stack([wo, wi, half][: self.direction_count], 1)
        # x, y, z in each frame, (n, directions · 3 · frames), one direction after the other.
        turned = directions.flatten(1) if self.frames is None else self.frames.turned(latents, directions)
        if self.authors_code:
            # Half and difference vector whole, as x, y, z in each frame; of wi and wo only z, their cosines.
            whole, cosines = turned.unflatten(1, (4, -1)).split([2, 2], 1)  # (n, 2, 3 · frames) each
            turned = torch.cat([whole.flatten(1), cosines[:, :, 2::3].flatten(1)], 1)
        return self.decoder(torch.cat([latents, turned.to(latents.dtype)], 1))


class Zeltner2024Objective(TextureObjective):
    """The neural texture, on one grid or several, and the network, both of them fitted."""

    network: GriddedNetwork

    def __init__(self, samples: Samples, settings: Zeltner2024.Settings, generator: torch.Generator):
        """Start the network at the mean of the data; its weights, the frames' first, are the first numbers of the
        generator."""
        super().__init__(samples, settings)
        framed = FramedNetwork(settings, generator)
        self.authors_code = framed.authors_code
        first_output = samples.mean(generator)  # log radiance, log1p(x) with x = gain · radiance
        if self.authors_code:  # an output is about log x: see `sigmoid`; of 0 it would be infinite
            first_output = first_output.expm1().clamp_min(1e-4).log()
        framed.decoder.start_at(first_output)
        self.network = GriddedNetwork(framed, settings, samples.shape, generator)
        bound = functional.softsign if self.authors_code else None  # the code's latents lie between −1 and 1
        self.grids = first_grids(samples, settings, settings.start, generator, bound=bound)

    def outputs(self, batch: Batch) -> Tensor:
        """The network's outputs (n, 3) at the texels and pairs of a batch; see `FramedNetwork`."""
        latents = self.network.fetch_batch(self.grids.rounded(), self.samples, batch)
        return self.network(latents, self.samples.wo[batch.pair], self.samples.wi[batch.pair])

    def predict(self, batch: Batch, progress: float) -> Tensor:
        """Log radiance (n, 3) of a batch."""
        outputs = self.outputs(batch)
        return sigmoid(outputs).log1p() if self.authors_code else outputs

    def loss(self, generator: torch.Generator, progress: float) -> Tensor:
        """The loss of log radiance; in the authors' code the distance of 3 (∛x − 1), x = gain · radiance.

        The distance is of the setting `loss`; the − 1 cancels in it. ∛x is computed from log x, which also has a
        gradient where x is nearly 0.
        """
        if not self.authors_code:
            return super().loss(generator, progress)
        batch = self.samples.draw(self.settings.batch, generator)
        outputs = self.outputs(batch)
        # log x = output − log(1 + eᵒᵘᵗᵖᵘᵗ / s), from `sigmoid`; a third of it is the logarithm of the cube root.
        log_of_root = (outputs - functional.softplus(outputs - math.log(BRIGHTEST))) / 3
        ours = 3 * log_of_root.exp()
        target = 3 * batch.target.expm1() ** (1 / 3)  # the data's x
        return distance(ours, target, self.settings.loss)


class Zeltner2024Material(GriddedMaterial):
    """Latents, fetched bilinearly from a texture (H, W, D) or from several grids, frames and network."""

    def __init__(self, network: GriddedNetwork, grids: dict[str, Tensor], gain: float):
        """Count the cost of an answer, and keep the parts. `ValueError` if texture and network do not fit."""
        framed: FramedNetwork = network.decoder
        architecture, frames = framed.decoder.architecture, framed.frames
        channels = sum(grid.shape[2] for name, grid in grids.items() if name != "offset")
        if channels != architecture.inputs - framed.direction_input_count:
            raise ValueError(f"a texture of {channels} channels for a network of {architecture.inputs} inputs")
        frame_flops = frames.flops(framed.direction_count) if frames else 0
        super().__init__(network, grids, architecture.flops + frame_flops, gain)
        self.authors_code = framed.authors_code

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        """Linear radiance (n, 3) of queries, each (n, …); see `Material`. The footprint is ignored: there is one level
        of detail."""
        outputs = self.network(self.latents(uv, wo), wo, wi)
        return sigmoid(outputs) / self.gain if self.authors_code else to_radiance(outputs, self.gain)
