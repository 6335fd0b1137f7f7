"""NeuBTF: an autoencoder makes the neural texture from a guidance image; has our recipe and the paper's.

The autoencoder, with its weights as stored, makes the file's texture from one slice of the BTF. A file that holds the
autoencoder (`keep_encoder`) can be re-textured.
"""

import logging
import math
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from bench.btf import BTF
from bench.codec import Codec, Fit, Parts
from bench.inputs.errors import InputError
from bench.material import Material
from bench.training import Decoder, Rounding, Samples, gain_of, load_texture, store_texture, train
from bench.training.fitting import better_start
from bench.training.gridded import DirectedGriddedMaterial, GriddedNetwork
from bench.training.grids import OFFSET_CHANNELS, size_of
from bench.training.stored_network import load_network, store_network
from bench.training.stored_texture import choose_bits
from neubtf.autoencoder import (
    STRIDE,
    Autoencoder,
    Encoder,
    as_guidance,
    displayed,
    eight_bits,
    load_encoder,
    store_encoder,
)
from neubtf.published import PAPER, Published
from neubtf.renderer import load, on_grids
from neubtf.training import Guided, Staged, StagedSettings, slice_of

TELLING = 0.1  # least contrast of the guidance, as a share of the best slice's
TRIED = 64  # slices to search for the best

log = logging.getLogger(__name__)


class NeuBTF(Codec):
    """NeuBTF: an autoencoder makes the neural texture from a guidance image; by our recipe, or the paper's.

    @article{rodriguezpardo2023neubtf,
      author = {Rodriguez-Pardo, Carlos and Kazatzis, Konstantinos and Lopez-Moreno, Jorge and Garces, Elena},
      title = {{NeuBTF}: Neural Fields for {BTF} Encoding and Transfer},
      journal = {Computers and Graphics},
      volume = {114},
      pages = {239--246},
      year = {2023},
      doi = {10.1016/j.cag.2023.06.018}
    }
    """

    name, version = "neubtf", 6
    sizes = ("latents", "width")
    recipes: ClassVar = {"paper": PAPER}
    recipe_versions: ClassVar = {"paper": 7}

    @dataclass(frozen=True)
    class Settings(StagedSettings):
        """See `StagedSettings`."""

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        """Fit, then make the texture by the encoder with its weights as stored.

        So a file that keeps the encoder gives the same texture again.
        """
        settings = self.settings
        samples = Samples(btf, gain_of(btf, fit), fit)
        guiding_slice = displayed(slice_of(samples, guiding_pair(samples)))  # (1, 3, H, W)
        guidance = as_guidance(eight_bits(guiding_slice))  # rounded as in a file
        objective_class = Published if settings.recipe == "paper" else Staged

        def made(start: Fit) -> Guided:
            """The objective as it is before the first step."""
            generator = start.generator()
            autoencoder = Autoencoder(settings.channels, generator, rectified=settings.recipe == "paper")
            encoder = Encoder.for_guidance(guidance, autoencoder)
            return objective_class(samples, settings, encoder, guidance, generator)

        if settings.offset:
            fit = better_start(made, fit, settings.steps)
        fitting = made(fit)
        train(fitting, fit, settings.steps)
        if isinstance(fitting, Published):
            guidance = fitting.best_guidance(fit)
        encoder_tensors = store_encoder(fitting.encoder, eight_bits(guidance))
        texture = texture_of(encoder_tensors, settings.channels, fit.device)
        batch = samples.draw(settings.batch, fit.generator())

        grids = on_grids(texture, settings.latents)
        roundings = {name: Rounding(grid.shape[2], settings.bits).to(fit.device) for name, grid in grids.items()}

        def answers() -> Tensor:
            """Log radiance (n, 3) of the renderer at random samples, of the grids as they are rounded."""
            as_rounded = {name: roundings[name](grid) for name, grid in grids.items()}
            return fitting.rendered_from(as_rounded, batch.texel, batch.pair)

        choose_bits([*roundings.values()], answers, batch.target)
        stored_texture: dict[str, Tensor] = {}
        for name, grid in grids.items():
            stored_texture |= store_texture(name, grid, roundings[name])
        other = {"gain": torch.tensor([samples.gain])}
        if settings.offset:
            other["size"] = torch.tensor(samples.shape, dtype=torch.int32)
        return Parts(
            decoder=store_network(fitting.renderer, settings.weights),
            texture=stored_texture,
            encoder=encoder_tensors if settings.keep_encoder else {},
            other=other,
        )

    def decode(self, parts: Parts, device: torch.device) -> Material:
        """The material of a file's parts, on a device; the encoder, if there is one, is not needed."""
        settings = self.settings
        material = load_moving(parts, settings) if settings.offset else load(parts, settings)
        return material.to(device)


def load_moving(parts: Parts, settings: StagedSettings) -> DirectedGriddedMaterial:
    """The material of a file with an offset, whose texture may be of another size than that of the fit.

    A depth moves a look-up by as many texels as in the fit. `InputError` if the sizes of the grids contradict each
    other.
    """
    grids = {name: load_texture(name, parts.texture) for name in ("latents", "offset")}
    height, width, _ = grids["latents"].shape
    if grids["offset"].shape != (*size_of("offset", (height, width)), OFFSET_CHANNELS):
        raise InputError(f"grid offset of this file does not fit {height} × {width} texels: encode it again")
    fitted_height, fitted_width = parts.other["size"].tolist()
    network = GriddedNetwork(Decoder(settings.architecture), settings, (fitted_height, fitted_width))
    load_network(network, parts.decoder)
    assert network.offset is not None
    network.offset.periods.mul_(torch.tensor([fitted_width / width, fitted_height / height]))
    gain = float(parts.other["gain"])
    return DirectedGriddedMaterial(network, grids, settings.architecture.flops, gain, settings.directions)


@torch.no_grad()
def texture_of(encoder_tensors: dict[str, Tensor], channels: int, device: torch.device) -> Tensor:
    """The neural texture (H, W, D) that an encoder of `store_encoder` makes of its own guidance."""
    height, width, _ = encoder_tensors["guidance"].shape
    if height % STRIDE or width % STRIDE:
        log.info("the guidance of %d × %d texels is padded circularly to multiples of %d", height, width, STRIDE)
    encoder = load_encoder(encoder_tensors, channels).to(device)
    texture: Tensor = encoder(as_guidance(encoder_tensors["guidance"].to(device)))
    return texture[0].movedim(0, -1)


def guiding_pair(samples: Samples) -> int:
    """The pair whose slice is the guidance: the most frontal one with enough contrast.

    That is at least `TELLING` times the best contrast of at most `TRIED` slices. A texture made from a slice of less
    would be nearly constant.
    """
    tried_pairs = range(0, samples.pairs, math.ceil(samples.pairs / TRIED))  # spread over all
    least_contrast = TELLING * max(_contrast(samples, pair) for pair in tried_pairs)
    frontality = samples.wo[:, 2] + samples.wi[:, 2]
    most_frontal_first = frontality.argsort(descending=True, stable=True).tolist()
    return next(pair for pair in most_frontal_first if _contrast(samples, pair) >= least_contrast)


def _contrast(samples: Samples, pair: int) -> float:
    """The contrast of a displayed slice: the deviation over texels, mean over channels."""
    picture = displayed(slice_of(samples, pair))[0]  # (3, H, W)
    return picture.flatten(1).std(1, correction=0).mean().item()
