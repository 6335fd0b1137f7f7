"""NeuralBTF (2026): a pyramid of latents, a look-up offset that depends on the view, and a wide network.

Three levels of the texture are fetched at one uv and concatenated. A second, small network moves this uv first; a
learned factor, the gate, scales its output and starts at 0. For what differs from the authors' code see
docs/recipes.md.

From half of the fit on, textures are looked up *rounded*, as the file stores them: see `bench.training.stored_texture`.
"""

import math
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import torch
from torch import Tensor, nn
from torch.nn import functional

from bench.btf import BTF
from bench.codec import Codec, Fit, Parts
from bench.inputs.errors import InputError
from bench.inputs.settings import BatchSize, Layers, Natural, Positive, Width
from bench.material import DecoderCost, Material, at_least_float32, sample_texture, to_radiance
from bench.metrics.display import LOG_SCALE
from bench.training import Batch, FitSettings, Optimiser, Samples, TextureObjective, first_latents, fitted
from bench.training.decoder import Architecture, Decoder
from bench.training.inputs import COUNTS, direction_inputs
from bench.training.stored_network import load_network
from bench.training.stored_texture import Bits, Rounding, load_texture, store_texture

Inputs = Literal["xyzh", "harmonics"]

HARMONICS = 9  # of one direction
FIRST_BOUND = 1e-4  # of the absolute value of the first random latents
LOSS_EPSILON = 0.01  # added to the square that the published loss divides by
PAPER = {"reduction": 16, "directions": "harmonics", "start": "random", "relative": True, "optimiser": "adam"}
PAPER |= {"rate": 1e-3, "latent_rate": 1e-2, "decay": False, "bits": 8, "steps": 20_000, "batch": 4_096}


class NeuralBTF(Codec):
    """NeuralBTF: a pyramid of latents, an offset behind a gate, and a wide network, as published of half a million.

    Code: https://github.com/mandyxmq/NeuralBTF-release

    @misc{neuralbtf2026,
      author = {{Authors of NeuralBTF}},
      title = {NeuralBTF},
      howpublished = {Code of its authors},
      year = {2026},
      url = {https://github.com/mandyxmq/NeuralBTF-release}
    }
    """

    name, version = "neuralbtf", 2
    sizes = ("channels", "width")
    recipes: ClassVar = {"paper": PAPER}

    @dataclass(frozen=True)
    class Settings(FitSettings):
        recipe: Literal["ours", "paper"] = "ours"  # "paper": its inputs, loss and rates, random latents
        steps: Natural = 1_000  # steps of the fit
        batch: BatchSize = 4_096  # samples a step
        optimiser: Optimiser = "muon"  # of the hidden matrices; 512 wide, as published, Adam takes half the seconds
        rate: Positive = 3e-3  # highest learning rate of both networks and the gate
        relative: bool = False  # as published: the network answers radiance, its loss is relative, `loss` is not used
        decay: bool = True  # rates rise at first and fall to 0; as published they stay
        levels: Layers = 3  # of the pyramid, each of half as many texels a side
        channels: Width = 8  # of each level, and of the offset's texture
        reduction: Natural = 4  # texels a side of a point of the offset's texture; 0: no offset
        directions: Inputs = "xyzh"  # inputs: harmonics of both as published, or all of both and of their half vector
        layers: Layers = 3  # hidden layers of the network
        width: Width = 512  # channels of each hidden layer, and of the offset's one
        bits: Bits = 0  # bits of a stored number of the textures on average; 0: chosen by the fit; 16, 32: floats

        @property
        def architecture(self) -> Architecture:
            """The network that reads the latents of all levels and the directions."""
            directions = 2 * HARMONICS if self.directions == "harmonics" else COUNTS[self.directions]
            return Architecture(self.levels * self.channels + directions, (self.width,) * self.layers)

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        """Fit the textures and the networks, and store each texture under its own name, that of `texture_factors`."""
        fitting = fitted(NeuralBTFObjective, self.settings, btf, fit)
        texture: dict[str, Tensor] = {}
        for name, values in fitting.textures.items():
            texture |= store_texture(name, values, fitting.roundings[name])
        return fitting.parts(texture)

    def decode(self, parts: Parts, device: torch.device) -> Material:
        """The material of a file's parts, on a device. `InputError` if textures have other sizes than their levels."""
        networks = load_network(Networks(self.settings), parts.decoder)
        textures = {name: load_texture(name, parts.texture) for name in texture_factors(self.settings)}
        size = (textures["level0"].shape[0], textures["level0"].shape[1])
        for name, (rows, cols) in texture_sizes(self.settings, size).items():
            if textures[name].shape != (rows, cols, self.settings.channels) or min(size) < 1:
                raise InputError(f"texture {name} of this file is not of {size[0]} × {size[1]} texels: encode it again")
        return NeuralBTFMaterial(networks, list(textures.values()), float(parts.other["gain"])).to(device)


def texture_factors(settings: NeuralBTF.Settings) -> dict[str, int]:
    """Of each texture, by its name, how many texels a side of the picture a point of it stands for.

    Names are "level0", the finest, "level1" and so on, and with an offset "offset".
    """
    factors = {f"level{level}": 1 << level for level in range(settings.levels)}
    if settings.reduction:
        factors["offset"] = settings.reduction
    return factors


def texture_sizes(settings: NeuralBTF.Settings, size: tuple[int, int]) -> dict[str, tuple[int, int]]:
    """The sizes (rows, columns) of the textures of a picture of `size` (H, W), by name: see `texture_factors`."""
    sizes = {}
    for name, factor in texture_factors(settings).items():
        # Sides are rounded up, so that every texel has its point.
        sizes[name] = (math.ceil(size[0] / factor), math.ceil(size[1] / factor))
    return sizes


def harmonics(w: Tensor) -> Tensor:
    """The real spherical harmonics (n, 9) of degrees 0 to 2 of vectors (n, 3), as polynomials of x, y, z."""
    x, y, z = w.unbind(1)
    # The factors make them orthonormal over the sphere.
    constant = math.sqrt(1 / 4 / math.pi)
    linear = math.sqrt(3 / 4 / math.pi)
    mixed = math.sqrt(15 / 4 / math.pi)
    zonal = math.sqrt(5 / 16 / math.pi)
    squares = math.sqrt(15 / 16 / math.pi)
    degree_0 = torch.full_like(x, constant)
    degree_1 = [-linear * y, linear * z, -linear * x]
    degree_2 = [mixed * x * y, -mixed * y * z, zonal * (3 * z * z - 1), -mixed * x * z, squares * (x * x - y * y)]
    return torch.stack([degree_0, *degree_1, *degree_2], 1)


def network_inputs(wo: Tensor, wi: Tensor, kind: Inputs) -> Tensor:
    """The network's inputs for two directions (n, 3): harmonics (n, 18), the light's first, or xyz (n, 9) of view,
    light and half vector."""
    if kind == "harmonics":
        # Of 2 ω − 1, as published: the authors' encoder expects numbers from 0 to 1, and is given ω itself.
        return torch.cat([harmonics(2 * wi - 1), harmonics(2 * wo - 1)], 1)
    return torch.cat(direction_inputs(wo, wi, kind), 1)


class Networks(nn.Module):
    """The network and, unless `reduction` is 0, the offset's network and its gate."""

    def __init__(self, settings: NeuralBTF.Settings, generator: torch.Generator | None = None):
        """Make the networks, with weights drawn from the generator; the gate starts at 0, so that nothing is moved at
        first."""
        super().__init__()
        self.settings = settings
        self.decoder = Decoder(settings.architecture, generator)
        self.offset: Decoder | None = None
        if settings.reduction:
            of_offset = Architecture(settings.channels + 3, (settings.width,), outputs=2)  # of its texture and the view
            self.offset = Decoder(of_offset, generator)
            self.gate = nn.Parameter(torch.zeros(1))

    def forward(self, textures: list[Tensor], uv: Tensor, wo: Tensor, directions: Tensor) -> Tensor:
        """The output (n, 3) at uv (n, 2), for views wo (n, 3) and inputs of `network_inputs`, (n, 9) or (n, 18).

        Textures (H, W, C) are in the order of `texture_factors`: the levels, then the offset's if there is one.
        """
        levels = textures
        if self.offset is not None:
            *levels, offset_texture = textures
            shift = self.offset(torch.cat([sample_texture(offset_texture, uv), wo], 1)).tanh()  # (n, 2), of uv
            uv = uv + (self.gate * shift).to(uv.dtype)
        latents = [sample_texture(level, uv) for level in levels]
        return self.decoder(torch.cat([*latents, directions], 1))

    def log_radiance(self, outputs: Tensor) -> Tensor:
        """The log radiance (n, 3) of outputs (n, 3).

        With the setting `relative`, as published, outputs are radiance × exposure; otherwise they are log radiance.
        """
        return (LOG_SCALE * outputs.clamp_min(0)).log1p() if self.settings.relative else outputs


class NeuralBTFObjective(TextureObjective):
    """The textures and the networks, all of them fitted."""

    def __init__(self, samples: Samples, settings: NeuralBTF.Settings, generator: torch.Generator):
        """Start the network at the mean of the data, and the textures as `first_textures` says. The networks' weights
        are the first numbers of the generator."""
        super().__init__(samples, settings)
        self.network: Networks = Networks(settings, generator)
        first_output = samples.mean(generator)  # log radiance
        if settings.relative:  # the network answers radiance × exposure
            first_output = first_output.expm1() / LOG_SCALE
        self.network.decoder.start_at(first_output)
        self.textures = nn.ParameterDict(first_textures(samples, settings, generator))
        roundings = {name: Rounding(settings.channels, settings.bits) for name in self.textures}
        self.roundings: Any = nn.ModuleDict(roundings)
        directions = network_inputs(samples.wo, samples.wi, settings.directions)
        self.directions = nn.Buffer(directions, persistent=False)  # the network's inputs of each pair

    def rate(self, step: int, steps: int, group: int) -> float:
        """The share of a group's highest rate at a step; without `decay` always all of it."""
        return super().rate(step, steps, group) if self.settings.decay else 1.0

    def outputs(self, batch: Batch) -> Tensor:
        """The network's output (n, 3) at the texels and pairs of a batch, from rounded textures: see `Networks`."""
        textures = [self.roundings[name](values) for name, values in self.textures.items()]
        uv = self.samples.centres(batch.texel)
        wo = self.samples.wo[batch.pair]
        return self.network(textures, uv, wo, self.directions.index_select(0, batch.pair))

    def predict(self, batch: Batch, progress: float) -> Tensor:
        return self.network.log_radiance(self.outputs(batch))

    def loss(self, generator: torch.Generator, progress: float) -> Tensor:
        """The loss of log radiance; or as published the relative one of radiance × exposure.

        That is the squared error over the square of the answer, which is held constant: it has no gradient.
        """
        if not self.settings.relative:
            return super().loss(generator, progress)
        batch = self.samples.draw(self.settings.batch, generator)
        ours = self.outputs(batch)
        target = batch.target.expm1() / LOG_SCALE
        scale = ours.detach().square() + LOSS_EPSILON
        return ((ours - target).square() / scale).mean()


def first_textures(samples: Samples, settings: NeuralBTF.Settings, generator: torch.Generator) -> dict[str, Tensor]:
    """The first textures (H, W, C) by name.

    They are the latents of `first_latents`: the first C at the finest level and in the offset's texture, the next C at
    the next level, and so on, averaged to its size. With `start=random`, as published, levels are nearly 0, and the
    offset's texture is 0.
    """
    sizes = texture_sizes(settings, samples.shape)
    channels = settings.channels
    textures: dict[str, Tensor] = {}
    if settings.start == "random":
        for name, size in sizes.items():
            spread = 0.0 if name == "offset" else FIRST_BOUND
            textures[name] = spread * (2 * torch.rand(*size, channels, generator=generator) - 1)
        return textures
    latents = first_latents(samples, settings.levels * channels, settings.start, generator)
    picture = latents.T.unflatten(1, samples.shape)  # (levels · C, H, W)
    channels_of_texture = {f"level{level}": part for level, part in enumerate(picture.split(channels))}
    channels_of_texture["offset"] = picture[:channels]
    for name, size in sizes.items():
        mean = functional.adaptive_avg_pool2d(channels_of_texture[name], size)
        textures[name] = mean.permute(1, 2, 0).contiguous()  # (H, W, C)
    return textures


class NeuralBTFMaterial(Material):
    """The levels (H, W, C), the finest first, then the offset's texture if there is one, and the networks."""

    def __init__(self, networks: Networks, textures: list[Tensor], gain: float):
        """Count the cost of an answer, and keep the parts."""
        size = (textures[0].shape[0], textures[0].shape[1])  # the finest level is as large as the picture
        network_flops = networks.decoder.architecture.flops
        if networks.offset is not None:
            network_flops += networks.offset.architecture.flops
        numbers_read = 4 * sum(texture.shape[2] for texture in textures)  # four texels of each texture
        cost = DecoderCost(
            parameters=sum(p.numel() for p in networks.parameters()),
            # Smaller textures have less than a number a texel.
            texture_channels=sum(texture.shape[2] for texture in textures if texture.shape[:2] == size),
            texture_floats=sum(texture.numel() for texture in textures),
            flops_per_sample=network_flops + 2 * numbers_read,  # each is multiplied and added
            bytes_per_sample=numbers_read * textures[0].element_size(),
        )
        super().__init__(size, cost)
        self.networks = networks
        self.gain = gain
        for number, texture in enumerate(textures):  # as attributes, which `Material.to` finds
            setattr(self, f"texture{number}", texture)
        self.texture_count = len(textures)

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        """Linear radiance (n, 3) of queries, each (n, …); see `Material`. The footprint is ignored: all levels are read
        at any distance."""
        textures = [getattr(self, f"texture{number}") for number in range(self.texture_count)]
        settings = self.networks.settings
        outputs = self.networks(textures, uv, wo, network_inputs(wo, wi, settings.directions))
        if settings.relative:  # outputs are radiance × exposure, and the gain is LOG_SCALE · exposure
            return outputs.to(at_least_float32(outputs.dtype)) * (LOG_SCALE / self.gain)
        return to_radiance(outputs, self.gain)
