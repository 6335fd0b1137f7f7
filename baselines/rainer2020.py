"""Rainer et al., "Unified neural encoding of BTFs" (Computer Graphics Forum 39(2), 2020).

One encoder and one decoder for all materials, trained once (`neubtf-bench pretrain rainer2020`) and kept in a file of
their own; the decoder has the published 38,269 parameters. A new material's ABRDFs are resampled to the canonical pairs
of that file and encoded. Details that no text confirms are settings or constants here and in `baselines.rainer`, which
also says what statistics are.

The *canonical pairs* are C pairs of view and light that the encoder always sees, whatever pairs a material has. In the
training, texels of materials in `fit.unseen` are kept out: the fit's *curve*, of PSNR over steps, is measured on them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from baselines import rainer
from bench.btf import BTF, Layout
from bench.codec import Codec, Fit, Parts, SharedNetwork, TrainedNetwork
from bench.directions.hemisphere import thin, ubo2003
from bench.directions.interpolation import PairInterpolator, pack_layout, unpack_layout
from bench.inputs.settings import Count, Natural, Width
from bench.material import Material
from bench.training import Batch, Bits, Optimiser, Samples, gain_of, load_texture, round_after, store_texture, train
from bench.training.decoder import Decoder
from bench.training.fitting import ROUNDING_SAMPLES, LogLoss
from bench.training.stored_network import load_network, store_network

CANONICAL = 25  # views, and lights, of the pairs that the encoder sees
CHECKED_PAIRS = 128  # pairs of a material at which the decoder's answers are compared with the data during encoding
FIREFLY = 2.0  # × the brightest sample of an ABRDF: larger answers of the decoder are wrong
TARGET_PAIRS = 375  # pairs of each training material that the decoder must answer


class Rainer2020Network(SharedNetwork):
    """The encoder and the decoder of all materials."""

    name, version = "rainer2020", 1
    shipped = Path(__file__).parent / "networks/rainer2020.nbtf"

    @dataclass(frozen=True)
    class Settings(rainer.RainerSettings):
        steps: Natural = 40_000  # steps of the training
        loss: LogLoss = "both"  # error of log radiance: absolute, squared, or their sum
        optimiser: Optimiser = "adam"  # of all; with "muon" the decoder's hidden matrices are stepped by Muon
        kept: Count = 512  # training ABRDFs of each material
        latents: Width = 32  # channels that the encoder makes
        activation: rainer.Activation = "leaky-relu"  # activation of the decoder's hidden layers

    def train(self, btfs: Sequence[BTF], fit: Fit) -> Parts:
        """Fit encoder and decoder to texels of all materials; returns the parts of the shared file.

        The encoder is stored with the pairs that it sees.
        """
        canonical = canonical_pairs()
        pool = Pool(btfs, canonical, self.settings.kept, fit)
        fitting = Rainer2020Objective(pool, self.settings, fit)
        train(fitting, fit, self.settings.steps)
        return Parts(
            decoder=store_network(fitting.network, self.settings.weights),
            encoder=store_network(fitting.encoder, self.settings.weights) | pack_layout(canonical),
        )


class Rainer2020(Codec):
    """Rainer 2020: one encoder and one wide decoder for all materials, in a file of their own; encodes in seconds.

    @article{rainer2020unified,
      author = {Rainer, Gilles and Ghosh, Abhijeet and Jakob, Wenzel and Weyrich, Tim},
      title = {Unified Neural Encoding of {BTFs}},
      journal = {Computer Graphics Forum},
      volume = {39},
      number = {2},
      pages = {167--178},
      year = {2020},
      doi = {10.1111/cgf.13921}
    }
    """

    name, version = "rainer2020", 2
    network = Rainer2020Network

    @dataclass(frozen=True)
    class Settings:
        bits: Bits = 0  # bits of a stored latent, mean or deviation on average; 0: chosen by the fit; 16, 32: floats

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        """Encode every texel by the shared encoder; nothing is fitted but the rounding, the bits of each channel."""
        network = fit.shared(self.name)
        gain = gain_of(btf, fit)
        samples = Samples(btf, gain, fit)
        coder = Coder(network, samples).to(fit.device)
        blocks = torch.arange(samples.texels, device=fit.device).split(rainer.BLOCK)
        texture = torch.cat([coder(samples.abrdfs(block)) for block in fit.progress(blocks, "encoding")])
        batch = samples.draw(ROUNDING_SAMPLES, fit.generator())
        coordinates = rainer.direction_coordinates(samples.wo, samples.wi)[batch.pair]

        def answers(values: Tensor) -> Tensor:
            """Log radiance (n, 3) at the samples of `batch`, of values (H · W, D + 6) of the texture."""
            rows = values.index_select(0, batch.texel)
            return rainer.log_radiance(coder.decoder, rows, coordinates)

        rounding = round_after(texture, self.settings.bits, answers, batch.target)
        return Parts(
            texture=store_texture("latents", texture.reshape(*btf.shape, -1), rounding),
            other={"gain": torch.tensor([gain])},
            network=network,
        )

    def decode(self, parts: Parts, device: torch.device) -> Material:
        """The material of a file's parts and of the shared network, on a device. `ValueError` if the file names no
        network."""
        if parts.network is None:
            raise ValueError("it names no shared network")
        texture = load_texture("latents", parts.texture)
        gain = float(parts.other["gain"])
        return rainer.RainerMaterial(decoder_of(parts.network), texture, gain).to(device)


def canonical_pairs() -> Layout:
    """The pairs that the encoder sees: each of `CANONICAL` directions as the view with each as the light.

    The directions are evenly thinned ones of UBO2003.
    """
    measured = ubo2003()
    directions = measured[thin(measured, CANONICAL)]  # (CANONICAL, 3)
    wo = np.repeat(directions, CANONICAL, 0)
    wi = np.tile(directions, (CANONICAL, 1))
    return Layout.of(wo, wi)


def decoder_of(network: TrainedNetwork) -> Decoder:
    """The decoder of a trained network."""
    settings = Rainer2020Network(**network.settings).settings
    architecture = rainer.architecture(settings.latents, settings.activation)
    return load_network(Decoder(architecture), network.parts.decoder)


class Coder(torch.nn.Module):
    """Log ABRDFs (n, N, 3) of one material → its texture's channels (n, D + 6): latents, means, deviations.

    Where the decoder's answers at the material's own pairs are worse than the mean over these, the mean is stored, with
    a deviation of 0: the network may not know such a material.
    """

    def __init__(self, network: TrainedNetwork, samples: Samples):
        """Load both networks, and prepare the change of a material's pairs to those that the encoder was trained on."""
        super().__init__()
        encoder_tensors = network.parts.encoder
        settings = Rainer2020Network(**network.settings).settings
        canonical = unpack_layout(encoder_tensors)
        self.encoder = load_network(rainer.Encoder(len(canonical.view), settings.latents), encoder_tensors)
        self.decoder = decoder_of(network)
        self.resampler = Resampler(samples.btf.layout, canonical)
        # P pairs of the material, evenly spread over all, and their coordinates for the decoder.
        count = min(samples.pairs, CHECKED_PAIRS)
        self.checked_pairs = nn.Buffer(torch.linspace(0, samples.pairs - 1, count).round().long())  # (P,)
        coordinates = rainer.direction_coordinates(samples.wo, samples.wi).cpu()
        self.coordinates = nn.Buffer(coordinates[self.checked_pairs])  # (P, 4)

    @torch.no_grad()
    def forward(self, abrdfs: Tensor) -> Tensor:
        """Channels (n, D + 6) of log ABRDFs (n, N, 3): latents, then mean and deviation of each colour channel.

        In each colour channel, mean and deviation are those of the canonical pairs if the decoder's answers with them
        are nearer to the ABRDF than its mean, and not far too bright; else the mean of the material's own pairs, and 0.
        """
        canonical = self.resampler(abrdfs)  # (n, C, 3)
        stats = rainer.statistics(canonical)  # (n, 2, 3): mean and deviation
        latents = rainer.encoded_latents(self.encoder, canonical, stats)
        count = len(self.coordinates)
        coordinates = self.coordinates.repeat(len(latents), 1)  # (n · P, 4)
        rows = torch.cat([latents, stats.flatten(1)], 1).repeat_interleave(count, 0)  # (n · P, D + 6)
        answers = rainer.log_radiance(self.decoder, rows, coordinates).unflatten(0, (-1, count))  # (n, P, 3)
        truth = abrdfs[:, self.checked_pairs]  # (n, P, 3)
        mean = abrdfs.mean(1, keepdim=True)  # (n, 1, 3), of the material's own pairs
        error = (answers - truth).square().mean(1)  # (n, 3), by channel
        mean_error = (mean - truth).square().mean(1)
        usable = error <= mean_error
        # One answer that is far too bright would shine for every texel around it.
        usable &= answers.amax(1).expm1() <= FIREFLY * abrdfs.amax(1).expm1()
        mean_alone = torch.cat([mean, torch.zeros_like(mean)], 1)  # (n, 2, 3): the mean, and a deviation of 0
        stored_stats = stats.where(usable[:, None], mean_alone)
        return torch.cat([latents, stored_stats.flatten(1)], 1)


class Resampler(torch.nn.Module):
    """Log ABRDFs (n, N, 3) of one layout → (n, C, 3) of another, interpolated as radiance."""

    def __init__(self, layout: Layout, target: Layout):
        """Find the pairs of the layout around each pair of the target."""
        super().__init__()
        wo, wi = target.views[target.view], target.lights[target.light]
        around = PairInterpolator(layout)(torch.from_numpy(wo), torch.from_numpy(wi))
        # (C, k): the k pairs of the layout around each pair of the target, and their weights.
        self.sample, self.weight = nn.Buffer(around.sample), nn.Buffer(around.weight)

    def forward(self, abrdfs: Tensor) -> Tensor:
        """Log ABRDFs (n, N, 3) at the target's C pairs: (n, C, 3). Their radiance, times the gain, is mixed."""
        radiance = abrdfs.expm1()  # times the gain
        total = torch.zeros((), device=abrdfs.device)
        # One of the k pairs after the other, because all at once would take k times the memory.
        for sample, weight in zip(self.sample.unbind(1), self.weight.unbind(1), strict=True):
            total = total + radiance[:, sample] * weight[:, None]
        return total.log1p()


class Pool(Samples):
    """Some texels of many BTFs: log ABRDFs at the canonical pairs to encode, and at `TARGET_PAIRS` pairs to answer for.

    Those of `fit.unseen` come last, from texel `trained_texels` on, for the curve. Pair p of texel t has the decoder's
    inputs `coordinates[material[t], p]`.
    """

    def __init__(self, btfs: Sequence[BTF], canonical: Layout, most_texels: int, fit: Fit):
        """Read at most `most_texels` random texels of each BTF, and of each of `fit.unseen`."""
        # `Samples.__init__` would read one BTF. This holds parts of several, in the same attributes.
        generator = fit.generator()
        device = fit.device
        materials = [
            _training_texels(btf, canonical, most_texels, generator, fit)
            for btf in fit.progress([*btfs, *fit.unseen], "materials")
        ]
        inputs, targets, coordinates = zip(*materials, strict=True)  # of each the tensors of all materials
        self.device = device
        self.inputs = torch.cat(inputs)  # (texels, C, 3)
        self.table = torch.cat(targets)  # (texels, TARGET_PAIRS, 3)
        self.texels = len(self.inputs)
        self.pairs = TARGET_PAIRS
        self.coordinates = torch.stack(coordinates)  # (materials, TARGET_PAIRS, 4)
        counts = torch.tensor([len(abrdfs) for abrdfs in inputs], device=device)  # texels of each material
        self.trained_texels = int(counts[: len(btfs)].sum())
        self.material = torch.arange(len(materials), device=device).repeat_interleave(counts)  # (texels,)

    def abrdfs(self, texel: Tensor) -> Tensor:
        """The log ABRDFs (n, C, 3) of some texels (n,) at the canonical pairs, not at those that `at` answers for."""
        return self.inputs[texel].float()


def _training_texels(
    btf: BTF, canonical: Layout, most_texels: int, generator: torch.Generator, fit: Fit
) -> tuple[Tensor, Tensor, Tensor]:
    """Of at most `most_texels` random texels of a BTF what the encoder sees, and what the decoder should answer.

    Returns log ABRDFs at the canonical pairs, (n, C, 3), and at the target pairs, (n, TARGET_PAIRS, 3), both in halves,
    and the decoder's inputs (TARGET_PAIRS, 4) for the target pairs.
    """
    texel = torch.randperm(btf.shape[0] * btf.shape[1], generator=generator)[:most_texels].to(fit.device)
    input_pairs = btf.subset(btf.split().train)  # as when the material itself is encoded
    target_pairs = btf.subset(_target_pairs(btf, generator))
    gain = gain_of(input_pairs, fit)
    resampler = Resampler(input_pairs.layout, canonical).to(fit.device)
    input_samples = Samples(input_pairs, gain, fit)
    inputs = [resampler(input_samples.abrdfs(block)).half() for block in texel.split(rainer.BLOCK)]
    target_samples = Samples(target_pairs, gain, fit)
    targets = target_samples.abrdfs(texel).half()
    return torch.cat(inputs), targets, rainer.direction_coordinates(target_samples.wo, target_samples.wi)


def _target_pairs(btf: BTF, generator: torch.Generator) -> np.ndarray:
    """The indices of `TARGET_PAIRS` random pairs, repeated in turns if there are fewer.

    They are held-out ones if the BTF declares some, training pairs if it declares that there are none, else any. The
    encoder sees training pairs alone. So a decoder that answers held-out ones learns to interpolate between them.
    """
    if btf.heldout is None:
        pairs = np.arange(len(btf))
    elif btf.heldout.any():
        pairs = np.flatnonzero(btf.heldout)
    else:
        pairs = btf.split().train
    order = torch.randperm(len(pairs), generator=generator).numpy()
    return pairs[np.resize(order, TARGET_PAIRS)]  # `resize` cuts the random order, or repeats it


class Rainer2020Objective(rainer.Autoencoder):
    """Encoder and decoder of all materials, fitted to the texels of a `Pool`."""

    samples: Pool

    def __init__(self, pool: Pool, settings: Rainer2020Network.Settings, fit: Fit):
        """Make both networks; the encoder's weights are the first numbers of the generator."""
        generator = fit.generator()
        encoder = rainer.Encoder(pool.inputs.shape[1], settings.latents, generator)
        decoder = Decoder(rainer.architecture(settings.latents, settings.activation), generator)
        super().__init__(pool, encoder, decoder, settings, fit)

    def stored_networks(self) -> list[torch.nn.Module]:
        return [self.network, self.encoder]

    def coordinates_of(self, batch: Batch) -> Tensor:
        """The decoder's inputs (n, 4) for the pairs of a batch, which differ from material to material."""
        return self.samples.coordinates[self.samples.material[batch.texel], batch.pair]
