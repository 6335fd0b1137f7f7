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
from bench.material import Material
from bench.training import Samples, gain_of, round_after, store_texture, train
from bench.training.stored_network import store_network
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
from neubtf.renderer import load
from neubtf.training import Staged, StagedSettings, slice_of

TELLING = 0.1  # least contrast of the guidance, as a share of the best slice's
TRIED = 64  # slices to search for the best

log = logging.getLogger(__name__)


class NeuBTF(Codec):
    """NeuBTF, our recipe: an autoencoder makes the neural texture from a guidance image.

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
        gain, generator, settings = gain_of(btf, fit), fit.generator(), self.settings
        samples = Samples(btf, gain, fit)
        guiding_slice = displayed(slice_of(samples, guiding_pair(samples)))  # (1, 3, H, W)
        guidance = as_guidance(eight_bits(guiding_slice))  # rounded as in a file
        autoencoder = Autoencoder(settings.latents, generator, rectified=settings.recipe == "paper")
        encoder = Encoder.for_guidance(guidance, autoencoder)
        objective = Published if settings.recipe == "paper" else Staged
        fitting = objective(samples, settings, encoder, guidance, generator)
        train(fitting, fit, settings.steps)
        if isinstance(fitting, Published):
            guidance = fitting.best_guidance(fit)
        encoder_tensors = store_encoder(encoder, eight_bits(guidance))
        texture = texture_of(encoder_tensors, settings.latents, fit.device)
        batch = samples.draw(settings.batch, fit.generator())

        def answers(texture: Tensor) -> Tensor:
            """Log radiance (n, 3) of the renderer at random samples for a texture (H, W, D)."""
            return fitting.rendered(texture.flatten(0, 1), batch.texel, batch.pair)

        rounding = round_after(texture, settings.bits, answers, batch.target)
        return Parts(
            decoder=store_network(fitting.renderer, settings.weights),
            texture=store_texture("latents", texture, rounding),
            encoder=encoder_tensors if settings.keep_encoder else {},
            other={"gain": torch.tensor([gain])},
        )

    def decode(self, parts: Parts, device: torch.device) -> Material:
        """The material of a file's parts, on a device; the encoder, if there is one, is not needed."""
        return load(parts, self.settings).to(device)


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
