"""Rainer et al., "Unified neural encoding of BTFs" (Computer Graphics Forum 39(2), 2020).

One encoder and one decoder for all materials, trained once (`neubtf-bench pretrain rainer2020`) and kept in a file of
their own; the decoder has the published 38,269 parameters. A new material is a forward pass: its ABRDFs are resampled
to the canonical pairs that the shared file holds, so any set of directions will do, and encoded texel by texel. What
no text that could be read confirms is a setting or a constant here and in `baselines.rainer`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from baselines.rainer import (
    BLOCK,
    Activation,
    Autoencoder,
    Encoder,
    RainerMaterial,
    architecture,
    directions,
    encoded,
    statistics,
)
from bench.btf import BTF, Layout
from bench.codec import Codec, Fit, Parts, SharedNetwork
from bench.decoder import Decoder, load_vector, to_vector
from bench.directions import PairInterpolator, pack_layout, unpack_layout
from bench.errors import InputError
from bench.hemisphere import thin, ubo2003
from bench.material import Material
from bench.quantise import Precision, WeightPrecision, pack, unpack
from bench.shared import Shared
from bench.training import Batch, Loss, Samples, gain_of, train

CANONICAL = 25  # views, and lights, of the pairs that the encoder sees
TARGETS = 375  # pairs of each training material that the decoder is asked for: held out, between those encoded


class Rainer2020Network(SharedNetwork):
    """The encoder and the decoder of all materials."""

    name, version = "rainer2020", 1

    @dataclass(frozen=True)
    class Settings:
        steps: int = 100_000  # of the training
        texels: int = 64  # ABRDFs encoded in a step
        pairs: int = 32  # pairs decoded of each of them
        kept: int = 512  # ABRDFs of each material that are trained on
        rate: float = 3e-3  # highest learning rate
        loss: Loss = "both"  # on log radiance: absolute, squared, or their sum
        latents: int = 32  # channels that the encoder makes
        activation: Activation = "leaky-relu"  # of the decoder's hidden layers
        weights: WeightPrecision = "half"  # of the stored networks

        def __post_init__(self) -> None:
            if min(self.texels, self.pairs, self.kept, self.latents) < 1:
                raise InputError("the network of codec rainer2020 needs texels, pairs, kept and latents of at least 1")

    def train(self, btfs: Sequence[BTF], fit: Fit) -> Parts:
        canonical = canonical_pairs()
        pool = Pool(btfs, canonical, self.settings.kept, fit)
        fitting = Fitting(pool, self.settings, fit)
        train(fitting, fit, self.settings.steps)
        return Parts(
            decoder=pack("weights", to_vector(fitting.decoder), self.settings.weights),
            encoder=pack("weights", to_vector(fitting.encoder), self.settings.weights) | pack_layout(canonical),
        )

    def brief(self) -> "Rainer2020Network":
        return Rainer2020Network(**(vars(self.settings) | {"steps": 150, "texels": 16}))


class Rainer2020(Codec):
    """Rainer 2020: one encoder and one wide decoder for all materials, in a file of their own; encodes in seconds."""

    name, version = "rainer2020", 1
    network = Rainer2020Network

    @dataclass(frozen=True)
    class Settings:
        precision: Precision = "int8"  # of the stored latents, means and deviations

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        shared, gain = fit.shared(self.name), gain_of(btf, fit)
        encoder, canonical = encoder_of(shared)
        samples = Samples(btf, gain, fit)
        resampled = Resampler(btf.layout, canonical).to(fit.device)
        blocks = torch.arange(samples.texels, device=fit.device).split(BLOCK)
        rows = [
            _channels(encoder.to(fit.device), resampled(samples.abrdfs(block)))
            for block in fit.progress(blocks, "encoding")
        ]
        texture = torch.cat(rows).reshape(*btf.shape, -1)
        return Parts(
            texture=pack("latents", texture, self.settings.precision),
            other={"gain": torch.tensor([gain])},
            shared=shared,
        )

    def decode(self, parts: Parts, device: torch.device) -> Material:
        if parts.shared is None:
            raise ValueError("the file names no shared network")
        decoder = decoder_of(parts.shared)
        return RainerMaterial(decoder, unpack("latents", parts.texture), parts.other["gain"]).to(device)


def canonical_pairs() -> Layout:
    """The pairs that the encoder sees: a product of evenly thinned directions of UBO2003."""
    side = ubo2003()[thin(ubo2003(), CANONICAL)]
    return Layout.of(np.repeat(side, CANONICAL, 0), np.tile(side, (CANONICAL, 1)))


def encoder_of(shared: Shared) -> tuple[Encoder, Layout]:
    """The encoder of a shared file, and the pairs that it sees."""
    settings = Rainer2020Network(**shared.header.settings).settings
    canonical = unpack_layout(shared.parts.encoder)
    encoder = Encoder(len(canonical.view), settings.latents)
    load_vector(unpack("weights", shared.parts.encoder), encoder)
    return encoder, canonical


def decoder_of(shared: Shared) -> Decoder:
    """The decoder of a shared file."""
    settings = Rainer2020Network(**shared.header.settings).settings
    decoder = Decoder(architecture(settings.latents, settings.activation))
    load_vector(unpack("weights", shared.parts.decoder), decoder)
    return decoder


@torch.no_grad()
def _channels(encoder: Encoder, abrdfs: Tensor) -> Tensor:
    """Latents and statistics (n, D + 6) of log ABRDFs (n, canonical pairs, 3)."""
    found = statistics(abrdfs)
    return torch.cat([encoded(encoder, abrdfs, found), found.flatten(1)], 1)


class Resampler(torch.nn.Module):
    """Log ABRDFs (n, N, 3) of one layout → (n, C, 3) of another, interpolated as radiance."""

    def __init__(self, layout: Layout, wanted: Layout):
        super().__init__()
        wo, wi = wanted.views[wanted.view], wanted.lights[wanted.light]
        found = PairInterpolator(layout)(torch.from_numpy(wo), torch.from_numpy(wi))
        self.register_buffer("sample", found.sample)
        self.register_buffer("weight", found.weight)

    sample: Tensor
    weight: Tensor

    def forward(self, abrdfs: Tensor) -> Tensor:
        radiance = abrdfs.expm1()
        each = zip(self.sample.unbind(1), self.weight.unbind(1), strict=True)
        return sum(radiance[:, sample] * weight[:, None] for sample, weight in each).log1p()  # type: ignore[union-attr]


class Pool(Samples):
    """Some texels of many BTFs: log ABRDFs at the canonical pairs to encode, and at held-out pairs to answer for.

    Texel t is of BTF `material[t]`; pair p of that BTF has the coordinates `coordinates[material[t], p]`. A BTF with
    fewer held-out pairs than others has some twice.
    """

    def __init__(self, btfs: Sequence[BTF], canonical: Layout, most: int, fit: Fit):
        generator = fit.generator()
        seen, asked, coordinates, sizes = [], [], [], []
        for btf in fit.progress(btfs, "materials"):
            split = btf.split()
            train = btf.subset(split.train)
            gain = gain_of(train, fit)
            texel = torch.randperm(btf.shape[0] * btf.shape[1], generator=generator)[:most].to(fit.device)
            resampled = Resampler(train.layout, canonical).to(fit.device)
            samples = Samples(train, gain, fit)
            seen.append(torch.cat([resampled(samples.abrdfs(block)).half() for block in texel.split(BLOCK)]))
            between = btf.subset(
                _drawn(np.concatenate([np.empty(0, int), *split.heldout.values()]), split.train, generator)
            )
            asked.append(Samples(between, gain, fit).abrdfs(texel).half())
            coordinates.append(directions(*(torch.from_numpy(w).to(fit.device) for w in (between.wo, between.wi))))
            sizes.append(len(texel))
        self.device = fit.device
        self.seen, self.kept = torch.cat(seen), torch.cat(asked)
        self.texels, self.pairs = len(self.seen), TARGETS
        self.coordinates = torch.stack(coordinates)
        self.material = torch.arange(len(sizes), device=fit.device).repeat_interleave(
            torch.tensor(sizes, device=fit.device)
        )

    def abrdfs(self, texel: Tensor) -> Tensor:
        return self.seen[texel].float()


def _drawn(heldout: np.ndarray, train: np.ndarray, generator: torch.Generator) -> np.ndarray:
    """`TARGETS` of the held-out pairs, or of all where none are held out; in turn again where they are fewer."""
    pairs = heldout if len(heldout) else train
    order = torch.randperm(len(pairs), generator=generator).numpy()
    return pairs[np.resize(order, TARGETS)]


class Fitting(Autoencoder):
    """Encoder and decoder of all materials."""

    samples: Pool

    def __init__(self, pool: Pool, settings: Rainer2020Network.Settings, fit: Fit):
        generator = fit.generator()
        encoder = Encoder(pool.seen.shape[1], settings.latents, generator)
        decoder = Decoder(architecture(settings.latents, settings.activation), generator)
        step = (settings.texels, settings.pairs)
        super().__init__(pool, encoder, decoder, step, settings.rate, settings.loss, fit)

    def where(self, batch: Batch) -> Tensor:
        return self.samples.coordinates[self.samples.material[batch.texel], batch.pair]
