"""The training of NeuBTF as its paper describes it: autoencoder and renderer end to end.

Each element of a batch has a random slice as its input and others as its targets, in a window and at a scale of their
own; only the input is given other colours, blurred and noisy. docs/neubtf.md has what the paper says and leaves open.
Besides, one thing is not as published: the paper's pixels are compared at the target's pair, ours each at a random pair
of its own, unless `texel_pairs` is 0. A step's elements are read, encoded and rendered at once, because a GPU takes as
long for one element as for all. On a GPU a long fit also compiles what a step encodes, renders and compares, into
graphs of kernels that start at once: a step would start 870 kernels otherwise, which takes longer than they run.

Style and spectrum see linear radiance in the display's range [0, 1], because the paper compresses only the pixel term,
and because one highlight would otherwise outweigh every Gram matrix and spectrum. Pictures (B, 3, H, W) are periodic.
"""

import importlib.util
import math
import os
import shutil
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from bench.codec import Fit
from bench.metrics.display import LOG_SCALE, decode_srgb
from bench.records import grouped
from bench.training import Batch, Samples, distance
from neubtf.augmentation import Crop, draw_scale, taps_of
from neubtf.autoencoder import Encoder, as_guidance, displayed, eight_bits
from neubtf.renderer import render
from neubtf.training import Guided, StagedSettings, by_texel, pictures, slice_of

CANDIDATES = 64  # slices at most, spread over all, of which the best is the guidance of the file
COMPARED = 16_384  # random samples by which they are compared
AT_ONCE = 16  # slices whose means are computed at once
DARKEST = 1e-4  # least mean of a slice, in a display's range; darker slices are shown as if they had it

PAPER = {"bits": 8, "directions": "xy", "loss": "l1", "keep_scale": 0.0, "init": "published", "optimiser": "adam"}
# Left open, and chosen:
PAPER |= {"steps": 5_000, "slices": 16, "targets": 1, "texel_pairs": 1, "crop": 64, "around": 0}
PAPER |= {"smallest": 0.75, "blur": 0.5, "noise": 0.02}
COMPILED_FROM = 2_000  # steps from which a fit on a GPU compiles: that takes 44 s, and saves some 28 ms a step
FILTERS = 24  # filters of each scale
KERNEL = 5  # texels a side at each scale
SCALES = 3  # full, half and quarter resolution
BANK_SEED = 0x57  # the bank is the same for every fit: it is part of the loss, not of the network


def linear_display(log_radiance: Tensor) -> Tensor:
    """Linear values of the display, radiance × exposure clipped to [0, 1], of log radiance, any shape."""
    return (log_radiance.expm1() / LOG_SCALE).clamp(0, 1)


class Style(nn.Module):
    """The distance of two pictures' textures: the squared difference of Gram matrices (Gatys et al. 2016), averaged.

    The features are those of Ustyuzhaninov et al., "What does it take to generate natural textures?", 2017: one layer
    of fixed random filters at several scales, rectified, so that no trained weights are needed.
    """

    def __init__(self) -> None:
        """Draw the bank of filters, orthogonal ones, from a seed of its own: it is the same in every fit."""
        super().__init__()
        generator = torch.Generator().manual_seed(BANK_SEED)
        bank = torch.empty(SCALES, FILTERS, 3 * KERNEL * KERNEL)
        for scale in bank:
            nn.init.orthogonal_(scale, generator=generator)
        self.bank = nn.Buffer(bank.reshape(SCALES, FILTERS, 3, KERNEL, KERNEL), persistent=False)

    def forward(self, ours: Tensor, theirs: Tensor, periodic: tuple[bool, bool] = (True, True)) -> Tensor:
        """The distance, a scalar, of pictures (B, 3, H, W) that are `periodic` along their rows and columns, or not.

        It is the mean over the scales at which the filters fit, 0 if there is none.
        """
        distances = list[Tensor]()
        for scale, filters in enumerate(self.bank):
            if scale > 0:
                ours = functional.avg_pool2d(ours, 2, ceil_mode=True)
                theirs = functional.avg_pool2d(theirs, 2, ceil_mode=True)
            rows_fit = periodic[0] or ours.shape[2] >= KERNEL
            cols_fit = periodic[1] or ours.shape[3] >= KERNEL
            if rows_fit and cols_fit:
                our_gram = _gram(ours, filters, periodic)
                their_gram = _gram(theirs, filters, periodic)
                distances.append(functional.mse_loss(our_gram, their_gram))
        if not distances:
            return torch.zeros((), device=ours.device)
        return torch.stack(distances).mean()


def _gram(pictures: Tensor, filters: Tensor, periodic: tuple[bool, bool]) -> Tensor:
    """The Gram matrices (B, F, F) of pictures (B, 3, H, W) under F filters.

    An entry is the mean over texels of the product of two filters' rectified responses. Along a side that does not
    repeat these are the inner texels, at which the filters fit.
    """
    half = KERNEL // 2
    for dim, wraps in zip((2, 3), periodic, strict=True):
        if wraps:
            size = pictures.shape[dim]
            places = torch.arange(-half, size + half, device=pictures.device) % size
            pictures = pictures.index_select(dim, places)
    responses = functional.conv2d(pictures, filters).relu().flatten(2)  # (B, F, texels)
    return responses @ responses.mT / responses.shape[2]


def focal_frequency(ours: Tensor, theirs: Tensor) -> Tensor:
    """Focal frequency loss (Jiang et al., "Focal frequency loss for image reconstruction and synthesis", 2021), α = 1.

    The mean, a scalar, of w · |F − F'|² over the orthonormal spectra F, F' of both pictures (B, 3, H, W), with
    w = |F − F'| over its maximum in each channel of each picture, held constant.
    """
    difference = torch.fft.fft2(ours - theirs, norm="ortho")
    squared = difference.real.square() + difference.imag.square()
    with torch.no_grad():
        magnitude = squared.sqrt()
        largest = magnitude.amax((2, 3), keepdim=True).clamp_min(torch.finfo(magnitude.dtype).tiny)
        weight = magnitude / largest
    return (weight * squared).mean()


class Elements(NamedTuple):
    """Elements of a batch, E of them, whose windows have one size (h, w); n of their texels are compared."""

    window: Crop  # the size and the surroundings of all
    picture: Tensor  # (E, 3, h, w) in sRGB, the inputs
    input_pairs: Tensor  # (E,)
    targets: Tensor  # (E, targets, n, 3), log radiance
    pairs: Tensor  # (E, targets), those of the target slices
    texels: Tensor  # (E, n, k) of the material, whose weighted means are the windows' texels
    weights: Tensor  # (E, n, k)


class Truth(NamedTuple):
    """What the texels of E elements show at some pairs.

    The shape is (E, targets, n, 3) for whole slices: all n texels of an element at one pair, then at the next. It is
    (E, n, texel_pairs, 3) for pairs that each texel has for itself.
    """

    wo: Tensor  # unit directions (…, 3), which broadcast to that shape
    wi: Tensor
    level: Tensor  # log radiance


class Comparison(NamedTuple):
    """Textures beside the truth: two losses, and the pictures from which the third is computed."""

    pixel: Tensor  # a scalar
    style: Tensor  # a scalar
    our_pictures: Tensor  # (E · targets, 3, h, w), linear values of the display in [0, 1]
    true_pictures: Tensor


class Published(Guided):
    """Autoencoder and renderer, compared on whole windows.

    An element's texture is rendered at `targets` pairs, whose slices give style and spectrum; the pixels' loss is at
    `texel_pairs` random pairs of each texel, or without any at those slices.
    """

    def __init__(
        self, samples: Samples, settings: StagedSettings, encoder: Encoder, guidance: Tensor, generator: torch.Generator
    ):
        """Measure what steps need of guidance and slices, once for all steps."""
        super().__init__(samples, settings, encoder, guidance, generator)
        self.style = Style()
        self.guidance_mean = float(decode_srgb(guidance.cpu().numpy()).mean())  # in linear light
        self.means = nn.Buffer(slice_means(samples), persistent=False)  # (pairs,)
        self.comparison = self._quickest(self._compared)  # what the steps call

    def _quickest(self, function: Callable[..., Comparison]) -> Callable[..., Comparison]:
        """A function of a step, compiled where that saves time and is possible: in a long fit, on a GPU, by Triton.

        It is then recorded as graphs of a GPU's kernels ("reduce-overhead"). Each size of window would be compiled
        anew. Windows have one size where every crop with its surroundings is smaller than the picture.
        """
        settings, device = self.settings, self.samples.device
        long_enough = settings.steps >= COMPILED_FROM
        with_surroundings = settings.crop + 2 * settings.around
        one_size = with_surroundings < settings.smallest * min(self.samples.shape)
        if long_enough and one_size and device.type == "cuda" and _triton_works():
            return torch.compile(function, dynamic=False, mode="reduce-overhead")
        return function

    @torch.no_grad()
    def best_guidance(self, fit: Fit) -> Tensor:
        """The slice (1, 3, H, W), of `CANDIDATES` and the guidance so far, whose texture answers random samples best.

        Every slice was an input. Some tell much more than the most frontal one, which hides the ribs of corduroy.
        """
        batch = self.samples.draw(COMPARED, fit.generator())
        step = math.ceil(self.samples.pairs / CANDIDATES)  # every so many pairs, rounded up
        best_picture, least_error = self.guidance.clone(), self._error(self.guidance, batch)
        for pair in fit.progress(range(0, self.samples.pairs, step), "guidance images"):
            level = self.exposed(slice_of(self.samples, pair), torch.tensor([pair], device=self.samples.device))
            picture = as_guidance(eight_bits(displayed(level))).to(self.guidance)
            error = self._error(picture, batch)
            if error < least_error:
                best_picture, least_error = picture, error
        return best_picture

    def _error(self, guidance: Tensor, batch: Batch) -> float:
        """The loss of the pixels of a batch, for the texture of a guidance image."""
        rendered = self.rendered(by_texel(self.encoder(guidance)), batch.texel, batch.pair)
        return float(distance(rendered, batch.target, self.settings.loss))

    def loss(self, generator: torch.Generator, progress: float) -> Tensor:
        """The loss of one step, a scalar: the weighted sum of `losses` of a random batch."""
        settings = self.settings
        pixel, style, frequency = self.losses(self.batch(generator), generator)
        return settings.pixel * pixel + settings.style * style + settings.frequency * frequency

    def batch(self, generator: torch.Generator) -> list[Elements]:
        """The elements of a step, drawn at random, in groups whose windows have one size."""
        settings, samples = self.settings, self.samples
        windows = []
        for _ in range(settings.slices):
            scale = draw_scale(settings.smallest, settings.keep_scale, generator)
            window = Crop.drawn(samples.shape, settings.crop, scale, samples.btf.periodic, generator, settings.around)
            windows.append(window)
        return [self.elements(alike, generator) for alike in grouped(windows, Crop.at_origin).values()]

    def elements(self, windows: list[Crop], generator: torch.Generator) -> Elements:
        """An element in each of some windows of one size; its pairs are drawn at random."""
        device = self.samples.device
        texels, weights = taps_of(windows, self.samples.shape, device)  # (E, h · w, k)
        pair_shape = (len(windows), 1 + self.settings.targets)  # of each element the input, then the targets
        pairs = torch.randint(self.samples.pairs, pair_shape, generator=generator).to(device, non_blocking=True)
        levels = self.averaged(texels[:, None], weights[:, None], pairs[:, :, None])  # (E, 1 + targets, h · w, 3)
        input_levels, target_levels = levels[:, 0], levels[:, 1:]
        input_pairs, target_pairs = pairs[:, 0], pairs[:, 1:]
        window = windows[0].at_origin()
        input_slices = pictures(input_levels.flatten(0, 1), window.size)  # (E, 3, h, w)
        picture = self.disturbance.disturbed(displayed(self.exposed(input_slices, input_pairs)), generator)
        inner = window.inner(device)
        return Elements(
            window=window,
            picture=picture,
            input_pairs=input_pairs,
            targets=target_levels[:, :, inner],
            pairs=target_pairs,
            texels=texels[:, inner],
            weights=weights[:, inner],
        )

    def exposed(self, levels: Tensor, pairs: Tensor) -> Tensor:
        """Log radiance (E, 3, h, w) of parts of slices, exposed so that each whole slice has the guidance's mean.

        The slices are those of pairs (E,). A photograph that becomes guidance later is treated in the same way: the
        mean of all of it is brought to the guidance's.
        """
        factor = self.guidance_mean / self.means[pairs]
        return (levels.expm1() * factor[:, None, None, None]).log1p()

    def losses(self, batch: list[Elements], generator: torch.Generator) -> Tensor:
        """The losses (3,) of pixels, style and spectrum, not weighted, as means over elements."""
        sums = [len(elements.input_pairs) * self._losses_of(elements, generator) for elements in batch]
        count = sum(len(elements.input_pairs) for elements in batch)
        return torch.stack(sums).sum(0) / count

    def _losses_of(self, elements: Elements, generator: torch.Generator) -> Tensor:
        """The losses (3,) of elements with windows of one size; their surroundings are left out."""
        window = elements.window
        inner = window.inner(self.samples.device)
        at_targets = self._at_targets(elements)
        at_texel_pairs = None
        if self.settings.texel_pairs:
            at_texel_pairs = self._at_texel_pairs(elements, generator)
        found = self.comparison(elements.picture, inner, at_targets, at_texel_pairs, window.inner_size, window.whole)
        frequency = focal_frequency(found.our_pictures, found.true_pictures)  # of complex numbers: not compiled
        return torch.stack([found.pixel, found.style, frequency])

    def _compared(
        self,
        guidance: Tensor,
        inner: Tensor,
        at_targets: Truth,
        at_texel_pairs: Truth | None,
        size: tuple[int, int],
        periodic: tuple[bool, bool],
    ) -> Comparison:
        """Encode guidance images (E, 3, h, w), and compare what the renderer makes of their textures with the truth.

        Style and spectrum compare whole pictures, at the pairs of the targets. The pixels are compared at pairs of
        their own, if there are any, and else at those of the targets. `inner` (n,) are the texels that are compared;
        they make a picture of `size`, which may be `periodic` along its rows and its columns.
        """
        textures = self.encoder(guidance)  # (E, D, h, w)
        latents = textures.flatten(2)[..., inner].movedim(1, -1)  # (E, n, D)
        rendered, true = self._rendered_at(latents[:, None], at_targets), at_targets.level
        our_pictures = linear_display(pictures(rendered.flatten(0, 2), size))
        true_pictures = linear_display(pictures(true.flatten(0, 2), size))
        style = self.style(our_pictures, true_pictures, periodic)
        if at_texel_pairs is not None:
            rendered, true = self._rendered_at(latents[:, :, None], at_texel_pairs), at_texel_pairs.level
        pixel = distance(rendered, true, self.settings.loss)
        return Comparison(pixel, style, our_pictures, true_pictures)

    def _rendered_at(self, latents: Tensor, truth: Truth) -> Tensor:
        """Log radiance at the pairs of a truth, in its shape (…, 3); latents (…, D) are broadcast to it."""
        shape = truth.level.shape[:-1]
        wo = truth.wo.expand(*shape, 3).flatten(0, -2)
        wi = truth.wi.expand(*shape, 3).flatten(0, -2)
        repeated = latents.expand(*shape, latents.shape[-1]).flatten(0, -2)
        return render(self.renderer, repeated, wo, wi, self.settings.directions).unflatten(0, shape)

    def _at_targets(self, elements: Elements) -> Truth:
        """The truth of the target slices."""
        pairs = elements.pairs[:, :, None]  # (E, targets, 1): one for all texels of a slice
        return Truth(self.samples.wo[pairs], self.samples.wi[pairs], elements.targets)

    def _at_texel_pairs(self, elements: Elements, generator: torch.Generator) -> Truth:
        """The truth at pairs drawn for each texel."""
        count, _, texels, _ = elements.targets.shape
        pairs = torch.randint(self.samples.pairs, (count, texels, self.settings.texel_pairs), generator=generator)
        pairs = pairs.to(self.samples.device, non_blocking=True)
        level = self.averaged(elements.texels[:, :, None], elements.weights[:, :, None], pairs)
        return Truth(self.samples.wo[pairs], self.samples.wi[pairs], level)


def _triton_works() -> bool:
    """Whether Triton is installed, and a C compiler, without which it starts no kernel."""
    compiler = os.environ.get("CC") or shutil.which("gcc") or shutil.which("clang")
    return importlib.util.find_spec("triton") is not None and compiler is not None


def slice_means(samples: Samples) -> Tensor:
    """The mean (pairs,) of each slice as it is displayed, in linear light, at least `DARKEST`."""
    means = []
    for pairs in torch.arange(samples.pairs).split(AT_ONCE):
        slices = linear_display(samples.slices(pairs))  # (texels, pairs, 3)
        means.append(slices.mean((0, 2)))
    return torch.cat(means).clamp_min(DARKEST)
