"""Rainer et al., "Neural BTF compression and interpolation" (Computer Graphics Forum 38(2), 2019).

An encoder maps each texel's ABRDF to a few latents, a decoder maps latents and two directions to colour; both are
fitted together, one pair of networks per material. Only the decoder is stored; as published it has 35,725 parameters.
Details that no available text confirms are settings or constants here and in `baselines.rainer`, which also says what
statistics are. With `start=components`, the default, there is no encoder: latents are *free*, numbers that the fit
changes for themselves. Free latents may also lie on further grids, and be moved along the view; that is no part of the
paper.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, Literal

import torch
from torch import Tensor, nn

from baselines import rainer
from baselines.rainer import Directions
from bench.btf import BTF
from bench.codec import Codec, Fit, Parts
from bench.inputs.errors import InputError
from bench.inputs.settings import Natural, Positive, Width
from bench.material import Material, sample_texture, to_radiance
from bench.training import Batch, Samples, better_start, first_latents, gain_of, train
from bench.training.decoder import Architecture, Decoder
from bench.training.fitting import ROUNDING_SAMPLES
from bench.training.gridded import GriddedMaterial, GriddedNetwork, first_grids, gridded_parts, is_gridded, load_gridded
from bench.training.grids import GridSettings, total_channels
from bench.training.stored_network import load_network
from bench.training.stored_texture import Bits, Rounding, load_texture, round_after, store_texture


class Rainer2019(Codec):
    """Rainer 2019: latents, as published from an encoder of ABRDFs, and a wide decoder, fitted to each material.

    @article{rainer2019neural,
      author = {Rainer, Gilles and Jakob, Wenzel and Ghosh, Abhijeet and Weyrich, Tim},
      title = {Neural {BTF} Compression and Interpolation},
      journal = {Computer Graphics Forum},
      volume = {38},
      number = {2},
      pages = {235--244},
      year = {2019},
      doi = {10.1111/cgf.13633}
    }
    """

    name, version = "rainer2019", 3
    sizes = ("latents",)
    recipes: ClassVar = {
        "paper": {"bits": 8, "directions": "stereographic", "start": "encoder", "optimiser": "adam", "steps": 10_000}
    }

    @dataclass(frozen=True)
    class Settings(rainer.RainerSettings, GridSettings):
        steps: Natural = 2_500  # steps of the fit
        recipe: Literal["ours", "paper"] = "ours"  # "paper": its inputs, the encoder, only Adam
        start: Literal["components", "encoder"] = "components"  # latents: free from principal components, or encoded
        directions: Directions = "xyzh"  # inputs: each stereographic as published, or all of both and of their half
        patience: Natural = 0  # steps without a gain of 0.02 dB on its probe that end the fit; 0: never
        latents: Width = 8  # latents of a texel, free or made by the encoder
        width: Width = rainer.WIDTH  # of the decoder's hidden layers
        latent_rate: Positive = 1e-2  # highest learning rate of latents that no encoder makes
        activation: rainer.Activation = "leaky-relu"  # activation of the decoder's hidden layers
        bits: Bits = 0  # bits of a stored latent, mean or deviation on average; 0: chosen by the fit; 16, 32: floats

        def __post_init__(self) -> None:
            """`InputError` if the encoder's fit is asked for another loss than its own, or for grids."""
            if self.start == "encoder" and self.loss == "display":
                raise InputError("codec rainer2019: start=encoder has a loss of its own: leave out loss=display")
            if self.start == "encoder" and is_gridded(self):
                raise InputError(
                    "codec rainer2019: with start=encoder a texel's latents are made of its own ABRDF alone: leave out "
                    "half, quarter and offset, or take start=components"
                )

        @property
        def architecture(self) -> Architecture:
            """The decoder."""
            return rainer.architecture(total_channels(self), self.activation, self.directions, self.width)

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        """Fit encoder and decoder, or the decoder with free latents; returns the parts of the file."""
        samples = Samples(btf, gain_of(btf, fit), fit)
        if is_gridded(self.settings):
            make_objective = partial(GriddedLatents, samples, self.settings)  # takes the fit
            if self.settings.offset:
                fit = better_start(make_objective, fit, self.settings.steps)
            gridded = make_objective(fit)
            train(gridded, fit, self.settings.steps, self.settings.patience)
            return gridded.stored_parts()
        objective_class = EncodedLatents if self.settings.start == "encoder" else FreeLatents
        fitting = objective_class(samples, self.settings, fit)
        train(fitting, fit, self.settings.steps, self.settings.patience)
        texture, rounding = fitting.stored_texture(fit)
        return fitting.parts(store_texture("latents", texture.reshape(*btf.shape, -1), rounding))

    def decode(self, parts: Parts, device: torch.device) -> Material:
        """The material of a file's parts, on a device. `InputError` if several grids do not fit each other."""
        decoder = Decoder(self.settings.architecture)
        gain = float(parts.other["gain"])
        if is_gridded(self.settings):
            grids = load_gridded(parts, self.settings)
            network = load_network(GriddedNetwork(decoder, self.settings, grids["latents"].shape[:2]), parts.decoder)
            grids["statistics"] = load_texture("statistics", parts.texture)
            return GriddedRainerMaterial(network, grids, gain, self.settings.directions).to(device)
        load_network(decoder, parts.decoder)
        texture = load_texture("latents", parts.texture)
        return rainer.RainerMaterial(decoder, texture, gain, self.settings.directions).to(device)


class EncodedLatents(rainer.Autoencoder):
    """Encoder and decoder of one material, as published."""

    settings: Rainer2019.Settings

    def __init__(self, samples: Samples, settings: Rainer2019.Settings, fit: Fit):
        """Make both networks; the encoder's weights are the first numbers of the generator."""
        generator = fit.generator()
        encoder = rainer.Encoder(samples.pairs, settings.latents, generator)
        super().__init__(samples, encoder, Decoder(settings.architecture, generator), settings, fit)
        self.coordinates = rainer.direction_coordinates(samples.wo, samples.wi, settings.directions)

    def stored_texture(self, fit: Fit) -> tuple[Tensor, Rounding]:
        """The final texture (texels, D + 6) of the encoder, and its rounding, chosen now by its error at samples."""
        texels = torch.arange(self.samples.texels, device=fit.device)
        texture = torch.cat([self.encode(texels), self.statistics.flatten(1)], 1)
        batch = self.samples.draw(ROUNDING_SAMPLES, fit.generator())
        bits = self.settings.bits
        rounding = round_after(texture, bits, lambda values: self.answers(values, batch), batch.target)
        return texture, rounding


class FreeDecoder(rainer.RainerObjective):
    """A decoder without an encoder, fitted to random samples."""

    def __init__(self, samples: Samples, settings: Rainer2019.Settings, fit: Fit, generator: torch.Generator):
        """Make the decoder, with the next numbers of the generator as weights, and its inputs for each pair."""
        super().__init__(samples, Decoder(settings.architecture, generator), settings, fit)
        self.coordinates = rainer.direction_coordinates(samples.wo, samples.wi, settings.directions)

    def loss(self, generator: torch.Generator, progress: float) -> Tensor:
        """The loss at as many random samples as the encoder's fit decodes in a step."""
        batch = self.samples.draw(self.settings.texels * self.settings.pairs, generator)
        return self.distance(self.predict(batch, progress), batch.target, batch.pair, progress)


class FreeLatents(FreeDecoder):
    """The decoder and free latents, without an encoder. The file is as that of `EncodedLatents`: it holds none."""

    settings: Rainer2019.Settings

    def __init__(self, samples: Samples, settings: Rainer2019.Settings, fit: Fit):
        """Make the decoder, and start the latents at the texels' principal components: see `first_latents`."""
        generator = fit.generator()
        super().__init__(samples, settings, fit, generator)
        self.latents = nn.Parameter(first_latents(samples, settings.latents, "components", generator))  # (texels, D)
        self.rounding = Rounding(settings.latents + rainer.STATISTICS, settings.bits, sizes=[samples.shape])

    def texture(self) -> Tensor:
        """The texture (texels, D + 6) of latents and statistics, not rounded."""
        return torch.cat([self.latents, self.statistics.flatten(1)], 1)

    def stored_texture(self, fit: Fit) -> tuple[Tensor, Rounding]:
        """The final texture (texels, D + 6), and the rounding that it was fitted with; `fit`, which `EncodedLatents`
        needs, is ignored."""
        return self.texture(), self.rounding

    def predict(self, batch: Batch, progress: float) -> Tensor:
        """Log radiance (n, 3) of a batch, from half of the fit on of the texture as the file stores it."""
        return self.answers(self.rounding(self.texture()), batch)


class GriddedLatents(FreeDecoder):
    """The decoder and free latents on several grids, or moved along the view.

    Statistics are a texture of their own, at full resolution and not moved: they are those of a texel over all views.
    """

    def __init__(self, samples: Samples, settings: Rainer2019.Settings, fit: Fit):
        """Make the decoder and the offset's network, then start the grids at the texels' principal components."""
        generator = fit.generator()
        super().__init__(samples, settings, fit, generator)
        self.network: Any = GriddedNetwork(self.network, settings, samples.shape, generator)
        self.grids = first_grids(samples, settings, "components", generator)
        self.rounding = Rounding(rainer.STATISTICS, settings.bits)  # of the statistics

    def predict(self, batch: Batch, progress: float) -> Tensor:
        """Log radiance (n, 3) of a batch, from half of the fit on of textures as the file stores them."""
        latents = self.network.fetch_batch(self.grids.rounded(), self.samples, batch)
        statistics = self.rounding(self.statistics.flatten(1)).index_select(0, batch.texel)
        return rainer.log_radiance(self.network, torch.cat([latents, statistics], 1), self.coordinates_of(batch))

    def stored_parts(self) -> Parts:
        """The tensors of a file."""
        statistics = self.statistics.reshape(*self.samples.shape, rainer.STATISTICS)
        return gridded_parts(self, self.grids, **store_texture("statistics", statistics, self.rounding))


class GriddedRainerMaterial(GriddedMaterial):
    """Latents on several grids, a texture (H, W, 6) of means and deviations, and the decoder."""

    grid_statistics: Tensor

    def __init__(self, network: GriddedNetwork, grids: dict[str, Tensor], gain: float, directions: Directions):
        """Keep the parts. `InputError` if the statistics have another size than the picture."""
        expected = (*grids["latents"].shape[:2], rainer.STATISTICS)
        if grids["statistics"].shape != expected:
            raise InputError("the statistics of this file are not those of its texels: encode it again")
        super().__init__(network, grids, network.decoder.architecture.flops + rainer.STATISTICS_FLOPS, gain)
        self.directions = directions

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        """Linear radiance (n, 3) of queries, each (n, …); see `Material`. The footprint is ignored: there is one level
        of detail."""
        rows = torch.cat([self.latents(uv, wo), sample_texture(self.grid_statistics, uv)], 1)
        coordinates = rainer.direction_coordinates(wo, wi, self.directions)
        return to_radiance(rainer.log_radiance(self.network, rows, coordinates), self.gain)
